"""The terms of an objective besides relative poses: one file for each kind of measurement."""
