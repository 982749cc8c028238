"""Files of meshes, and of what lies on them."""
