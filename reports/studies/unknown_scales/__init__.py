"""Factors of depths and scales of sub-maps, recovered from hidden ones."""
