"""Templates fitted to scans, and the statistics of the shapes that result."""
