"""Descriptors by others, which the embeddings of the paper are compared with."""
