"""HTML pages about a certified estimate, with plots and a 3D view."""
