"""Collections of shapes with known correspondences."""
