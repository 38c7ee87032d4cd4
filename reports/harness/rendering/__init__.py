"""Records as text: cells compared with published numbers, tables, pages and the report."""
