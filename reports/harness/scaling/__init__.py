"""How time and memory grow with the graph, and what many restarts find."""
