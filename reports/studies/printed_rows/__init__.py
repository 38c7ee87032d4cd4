"""Rows of the papers that no run here reproduces: what was tried, and how near it comes."""
