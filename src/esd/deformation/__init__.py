"""Meshes deformed onto surfaces, as rigidly as possible."""
