"""Embeddings of descriptors, learned from corresponding points."""
