"""What is wrong with meshes, and its repair."""
