"""File formats, one a module, found by scanning this folder."""
