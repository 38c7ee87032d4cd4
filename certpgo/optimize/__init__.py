"""Initializations and descents, and what they report: solutions, traces, stopwatches."""
