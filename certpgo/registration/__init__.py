"""Frames and scans: registered pairwise, averaged, certified, fused."""
