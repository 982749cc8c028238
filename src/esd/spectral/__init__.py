"""Laplace-Beltrami operators and their spectra."""
