"""The costs of other programs, edge by edge, and their minorants."""
