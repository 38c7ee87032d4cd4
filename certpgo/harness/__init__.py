"""Tables: what to run (specification), what came out (records), and how it is shown (rendering)."""
