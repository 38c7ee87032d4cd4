"""What can be said of a graph or an estimate beyond its verdict."""
