"""Named ways of training."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from esd.common import InputError
from esd.descriptors.recipe import (
    Descriptor,
    Recipe,
    gradient_recipe,
    part_recipe,
    single_recipe,
)
from esd.learning.acnn import AnisotropicPatches
from esd.learning.gcnn import GeodesicPatches
from esd.learning.patches import Patches


@dataclass(frozen=True, slots=True)
class Training:
    """Everything that a training depends on, but the data and the seed.

    Parameters
    ----------
    recipe
        The descriptors.
    hidden
        Neurons of the hidden layers.
    outputs
        Dimension of the embedding.
    standardise
        Whether descriptors are standardised over the training shapes.
    limit
        Largest absolute value of a standardised descriptor; others are cut off there.
    dropout
        Share of the descriptors of each point that are set to zero, their mean, in each step, so
        that the embedding does not depend on a few.
    loss
        `contrastive`, the paper's, or `infonce`, of embeddings of unit length; or `osd`, for
        a linear map in closed form, see `esd.learning.osd`.
    margin, soft_label
        Of the contrastive loss: C, in squared units of the embedding, and the largest label of a
        pair that does not correspond.
    temperature
        Of InfoNCE.
    batch
        Pairs in a step. All of them correspond for InfoNCE, else half.
    learning_rate
        Of Adam, at the first step.
    schedule
        `exponential`: times `decay` after each step; `cosine`: falling to a twentieth.
    decay
        Factor on the learning rate after each step, if exponential.
    steps
        Number of steps; for `osd`, of batches of pairs that it is computed from.
    remeshings
        Copies of each training shape with other triangles, from coarse to dense, that are trained
        on as well, so that the embedding does not depend on triangles.
    points
        Points of each template that are trained on; None for all.
    patches, convolutions
        Which layers, from 0, are convolutions, and over which patches.
    blocks
        Of a network that diffuses features over the surface, see `esd.learning.part_training`;
        none for layers.
    validate_every
        Steps between two validations, and between two checkpoints.
    """

    recipe: Recipe
    hidden: tuple[int, ...]
    outputs: int = 15
    standardise: bool = True
    limit: float | None = None
    dropout: float = 0.0
    loss: Literal["contrastive", "infonce", "osd"] = "contrastive"
    margin: float = 5.0
    soft_label: float = 0.2
    temperature: float = 0.07
    batch: int = 512
    learning_rate: float = 0.015
    schedule: Literal["exponential", "cosine"] = "exponential"
    decay: float = 0.9999
    steps: int = 20_000
    remeshings: int = 0
    points: int | None = None
    patches: Patches | None = None
    convolutions: tuple[int, ...] = ()
    blocks: int = 0
    validate_every: int = 500


# every seventh scale of HKS; energies of WKS that other triangles of a surface change little
_COLUMNS = {"hks": range(0, 100, 7), "wks": range(0, 85, 6)}
_TIMES = {"chirality": (1e-3, 2e-3, 4e-3, 1.6e-2, 6e-2), "alignment": (1e-3, 4e-3, 1.6e-2)}


def _oriented_recipe() -> Recipe:
    """HKS and WKS, and the products of the gradients of their components of similar scale."""
    products = [
        gradient_recipe(kind, of, columns=columns, reach=3, times=times)
        for kind, times in _TIMES.items()
        for of, columns in _COLUMNS.items()
    ]
    return Recipe((Descriptor("hks", 100, log=True), Descriptor("wks", 100, log=True), *products))


def _osd(kind: str) -> Training:
    return Training(single_recipe(kind), hidden=(), outputs=16, loss="osd", steps=400)


PRESETS = {
    "oriented": Training(
        _oriented_recipe(),
        hidden=(256, 128),
        outputs=32,
        limit=8.0,
        dropout=0.35,
        loss="infonce",
        learning_rate=2e-3,
        schedule="cosine",
        steps=3000,
        remeshings=2,
        points=2500,
    ),
    "surface": Training(
        _oriented_recipe(),
        hidden=(256, 64),
        outputs=32,
        limit=8.0,
        loss="infonce",
        batch=1024,
        learning_rate=2e-3,
        schedule="cosine",
        steps=500,
        remeshings=2,
        blocks=3,
        validate_every=100,
    ),
    "partial": Training(
        part_recipe(),
        hidden=(256, 128),
        outputs=64,
        limit=8.0,
        loss="infonce",
        batch=1024,
        learning_rate=2e-3,
        schedule="cosine",
        steps=5358,  # as many as the bundled model was trained for
        blocks=4,
        validate_every=100,
    ),
    "paper-hks": Training(single_recipe("hks"), hidden=(78, 32)),
    "paper-wks": Training(single_recipe("wks"), hidden=(78, 32)),
    "paper-gps": Training(single_recipe("gps"), hidden=(20, 18)),
    "osd": _osd("hks"),
    "osd-geometry": _osd("geometry"),
    "gcnn": Training(
        single_recipe("hks"),
        hidden=(16,),
        outputs=16,
        patches=GeodesicPatches(),
        convolutions=(1,),
        learning_rate=3e-3,
        schedule="cosine",
        steps=3000,
        validate_every=100,
    ),
    "acnn": Training(
        single_recipe("hks"),
        hidden=(16, 16),
        outputs=16,
        patches=AnisotropicPatches(),
        convolutions=(1, 2),
        learning_rate=1e-3,
        schedule="cosine",
        steps=1500,
        validate_every=100,
    ),
}
"""`oriented`, which tells left from right; `surface`, which takes the same descriptors and sees
those of the surface around each point as well; `partial`, which does on parts of shapes as well;
the networks of the paper (sections 3.4 and 3.5); and what it compares them with, of HKS as there:
optimal spectral descriptors, also of the geometry vector, as their authors have them, and
convolutional networks.

`gcnn` has its authors' layers, fully connected and geodesic. `acnn` has theirs up to the second of
three anisotropic ones, with 16 channels in place of 64 to 256, to be trained without a GPU. The
paper leaves the numbers of steps, and of these networks the loss, open.
"""


def preset(name: str) -> Training:
    """The training of a name.

    Raises
    ------
    InputError
        If there is none.
    """
    if name not in PRESETS:
        raise InputError(f"There is no preset '{name}'; expected one of {', '.join(PRESETS)}.")
    return PRESETS[name]
