"""Maps between shapes."""
