"""The paper's embedding as a scikit-learn transformer."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from sklearn.base import BaseEstimator, ClassNamePrefixFeaturesOutMixin, TransformerMixin
from sklearn.utils import check_random_state
from sklearn.utils.multiclass import check_classification_targets
from sklearn.utils.validation import check_is_fitted, validate_data

from esd.common import FloatArray, IntArray
from esd.learning.losses import contrastive_loss
from esd.learning.network import linear_layers, seeded_network
from esd.learning.optimise import descend


class SpectralEmbedding(
    ClassNamePrefixFeaturesOutMixin,  # type: ignore[misc]
    TransformerMixin,  # type: ignore[misc]
    BaseEstimator,  # type: ignore[misc]
):
    """Embedding of descriptors in which Euclidean distance tells whether points correspond.

    A row is a vertex, of any shape; rows with one label in `y` are one point, such as the tip of
    the nose, on several shapes. The network and its loss are those of the paper (sections 3.4 and
    3.5). `esd.learning.train` trains on whole shapes; this takes any rows of numbers, in pipelines
    and searches.

    Parameters
    ----------
    n_components
        Dimension of the embedding.
    hidden
        Neurons of the hidden layers.
    margin
        C of the contrastive loss, in squared units of the embedding.
    soft_label
        Largest label of a pair that does not correspond.
    batch
        Pairs in a step, half of them corresponding.
    learning_rate, decay
        Of Adam at the first step, and the factor on it after each step.
    steps
        Number of steps.
    random_state
        Of the first weights and the pairs.

    Attributes
    ----------
    mean_, deviation_ : (n_features_in_,)
        By which rows are standardised.
    weights_ : list of (weight (outputs, inputs), bias (outputs,))
        Of the layers, with ReLU between them.
    """

    def __init__(
        self,
        n_components: int = 15,
        *,
        hidden: tuple[int, ...] = (78, 32),
        margin: float = 5.0,
        soft_label: float = 0.2,
        batch: int = 512,
        learning_rate: float = 0.015,
        decay: float = 0.9999,
        steps: int = 2000,
        random_state: Any = None,
    ) -> None:
        self.n_components = n_components
        self.hidden = hidden
        self.margin = margin
        self.soft_label = soft_label
        self.batch = batch
        self.learning_rate = learning_rate
        self.decay = decay
        self.steps = steps
        self.random_state = random_state

    def fit(self, X: Any, y: Any) -> SpectralEmbedding:
        """Learn from rows (n, d) and the point that each is, (n,).

        Raises
        ------
        ValueError
            If there are fewer than two points.
        """
        X, y = validate_data(self, X, y, dtype=np.float64)
        check_classification_targets(y)
        points, label = np.unique(y, return_inverse=True)
        if len(points) < 2:
            raise ValueError(f"`y` must name two points or more; got {len(points)} class.")
        generator = check_random_state(self.random_state)
        self.mean_ = X.mean(axis=0)
        deviation = X.std(axis=0)
        self.deviation_ = np.where(deviation > 0, deviation, 1.0)
        rows = torch.from_numpy(self._standardised(X).astype(np.float32))
        widths = [X.shape[1], *self.hidden, self.n_components]
        network = seeded_network(widths, int(generator.randint(2**31 - 1)))
        optimiser = torch.optim.Adam(network.parameters(), lr=self.learning_rate)
        for step in range(self.steps):
            source, target, truth = _pairs(label, self.batch, self.soft_label, generator)
            squared = ((network(rows[source]) - network(rows[target])) ** 2).sum(dim=1)
            loss = contrastive_loss(squared, torch.from_numpy(truth), margin=self.margin).sum()
            descend(optimiser, loss, rate=self.learning_rate * self.decay**step)
        self.weights_ = [
            (layer.weight.detach().numpy(), layer.bias.detach().numpy())
            for layer in linear_layers(network)
        ]
        return self

    def transform(self, X: Any) -> FloatArray:
        """The embedding (n, n_components) of rows (n, d)."""
        check_is_fitted(self)
        X = validate_data(self, X, dtype=np.float64, reset=False)
        result = self._standardised(X)
        for i, (weight, bias) in enumerate(self.weights_):
            result = (np.maximum(result, 0) if i else result) @ weight.T + bias
        return result

    def __sklearn_tags__(self) -> Any:
        tags = super().__sklearn_tags__()
        tags.target_tags.required = True
        return tags

    @property
    def _n_features_out(self) -> int:
        return self.n_components

    def _standardised(self, values: FloatArray) -> FloatArray:
        return np.asarray((values - self.mean_) / self.deviation_)


def _pairs(
    label: IntArray, count: int, soft_label: float, generator: np.random.RandomState
) -> tuple[IntArray, IntArray, npt.NDArray[np.float32]]:
    """Rows of pairs, the first half of one point each and the others of two, and their labels."""
    order = np.argsort(label, kind="stable")
    size = np.bincount(label)
    first = np.cumsum(size) - size
    source = generator.randint(len(label), size=count)
    half = count // 2
    target = np.empty(count, dtype=np.int64)
    same = label[source[:half]]
    target[:half] = order[first[same] + generator.randint(0, size[same])]
    # any row but those of the same point, which follow each other in `order`
    other = label[source[half:]]
    step = generator.randint(0, len(label) - size[other])
    target[half:] = order[(first[other] + size[other] + step) % len(label)]
    truth = np.concatenate([np.ones(half), generator.uniform(0, soft_label, count - half)])
    return source, target, truth.astype(np.float32)
