"""Figures of how good a map is."""
