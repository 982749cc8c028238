"""Remeshing: other triangles of the same surface."""
