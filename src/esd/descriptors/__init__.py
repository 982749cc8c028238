"""Spectral descriptors."""
