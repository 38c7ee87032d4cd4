"""Certified regions, attacked and measured."""
