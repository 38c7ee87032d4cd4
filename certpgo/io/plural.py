"""Counts in words, from the room of graphs."""

from certpgo.graph.wording import counted as counted
