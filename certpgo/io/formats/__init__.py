"""File formats, one per module, found by scanning this folder."""
