"""The experiments that there are."""

from __future__ import annotations

EXPERIMENTS = {
    "table1": "correct matches of descriptors and their embeddings",
    "table2": "the embedding beside other learned descriptors",
    "dimension": "the intrinsic dimension of descriptors",
    "architecture": "numbers of hidden layers and of neurons",
    "concatenation": "descriptors side by side in one embedding",
    "scale": "shapes at other sizes",
    "noise": "noise in position and connectivity, and missing parts",
    "transfer": "trained on one data set, tested on another",
}
"""What each is about. Its module here has its name, and a `run` and `figures`."""
