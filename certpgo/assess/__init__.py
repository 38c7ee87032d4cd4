"""Metrics, bounds and comparisons of graphs, estimates and methods, and their wording."""
