"""The experiments of the paper, on any collection."""
