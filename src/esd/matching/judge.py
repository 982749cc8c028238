"""Which of several candidate maps is best, by evidence that sees a wrong limb."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from scipy.spatial import KDTree

from esd.common import FloatArray
from esd.matching.candidates import Candidate, PairDescriptors, Rows, Sampled
from esd.nearest import nearest

_FUNCTIONS = 25  # eigenfunctions of the functional map that is looked at
_POINTS = 300  # between which distances are compared
_LOST = 0.3  # in √area, at which distances are cut off
_MOSTLY = 0.5  # share of lost ways beyond which a map is beyond what was seen
_FAR = 0.08  # in √area, beyond which a way there and back is lost
# evidence of surfaces that an affine motion brings onto each other, and the accuracy of such maps
_SAME = {"residual": 0.012, "uncovered": 0.01, "embeddings": 0.9}  # no more
_SAME_NORMALS = 0.9  # no less
_SAME_ACCURACY = 0.97


@dataclass(frozen=True, slots=True)
class Evidence:
    """What a map does to the source's surface, averaged over triangles drawn by area.

    Lengths are in units of √area of the shape that they are on.

    Parameters
    ----------
    round_trip
        Mean distance by which going to the target and back misses.
    lost
        Share of the triangles for which that is beyond 0.08.
    stretch
        Mean absolute logarithm of how much longer edges become.
    torn
        Share of the triangles with an edge that becomes more than four times as long.
    dirichlet
        Root mean square of how much longer edges become, each at most five times.
    orientation
        Share of the triangles that keep their orientation, less the share reversed.
    uncovered
        Share of the target farther than 0.06 from the image of any triangle.
    gap
        Mean distance of the target from the image.
    residual
        Root mean square distance of the map from the affine motion nearest to it.
    normals
        Mean cosine between the normals at both ends after that motion.
    descriptors, embeddings
        Mean squared distances of matched rows: of the pair's descriptors, of the model's embedding.
    commutator
        How far the functional map is from commuting with the Laplacians, relative to the largest
        eigenvalue looked at.
    nonorthogonality
        Root mean square of CᵀC − I, per column.
    distances
        Mean relative difference of biharmonic distances between points and their images.
    """

    round_trip: float
    lost: float
    stretch: float
    torn: float
    dirichlet: float
    orientation: float
    uncovered: float
    gap: float
    residual: float
    normals: float
    descriptors: float
    embeddings: float
    commutator: float
    nonorthogonality: float
    distances: float

    def vector(self) -> FloatArray:
        """The evidence on the scales on which it is weighed: logarithms of all but cosines."""
        values = [getattr(self, field.name) for field in fields(self)]
        return np.array(
            [
                value if offset is None else np.log(value + offset)
                for value, offset in zip(values, _OFFSETS, strict=True)
            ]
        )


_OFFSETS = (
    *(0.01, 0.02, 0.1, 0.01, 0.3),
    None,
    *(0.02, 0.01, 0.02),
    None,
    *(0.2, 0.05, 0.02, 0.05, 0.03),
)


# weights of `Evidence.vector`, of the cost and of the logit of the accuracy: benchmarks/judge.py
_COST = (
    *(0.707, -0.265, 5.023, 0.033, 1.609, 0.348, 0.37, 0.843, 0.536, -3.448),
    *(0.918, 4.432, 3.115, -0.294, -0.493),
)
_ACCURACY = (
    *(-0.996, 0.004, 1.653, -1.254, 2.284, 1.319, -1.389, 1.372, 0.959, 0.669),
    *(-1.198, -1.469, -1.52, -0.083, 0.933),
)
_ACCURACY_CONSTANT = -5.431


def evidence(
    source: Sampled, target: Sampled, candidate: Candidate, descriptors: PairDescriptors
) -> Evidence:
    """The evidence for a candidate, see `Evidence`.

    Parameters
    ----------
    descriptors
        The `pair_descriptors` of the two shapes.

    References
    ----------
    Ren et al. 2020, *MapTree*, for judging maps by orthogonality, orientation and smoothness;
    Lipman, Rustamov, Funkhouser 2010, *Biharmonic distance*.
    """
    corners, triangles = source.corners, source.triangles
    image = nearest(candidate.forward[0][corners], candidate.forward[1])[0]
    again = nearest(candidate.backward[1][image], candidate.backward[0])[0]
    here, there = source.points[corners], target.points[image]
    miss = np.linalg.norm(here - source.points[again], axis=1)[triangles].mean(axis=1)

    length, longer = (
        np.linalg.norm(points[triangles] - np.roll(points[triangles], 1, axis=1), axis=2)
        for points in (here, there)
    )
    spacing = 1 / np.sqrt(len(target.points))
    a, b, c = (there[triangles[:, corner]] for corner in range(3))
    turn = np.cross(b - a, c - a)
    side = np.einsum("ij,ij->i", turn, target.normals[image][triangles].sum(axis=1))
    side = np.sign(side[np.linalg.norm(turn, axis=1) > 1e-3 * spacing**2])
    away, _ = KDTree(there).query(target.points[target.corners])

    rows = np.hstack([here, np.ones((len(here), 1))])
    motion = np.linalg.lstsq(rows, there, rcond=None)[0]  # (4, 3)
    linear = motion[:3].T + 1e-9 * np.eye(3)
    cofactor = np.linalg.inv(linear) * np.sign(np.linalg.det(linear))
    moved = source.normals[corners] @ cofactor
    moved /= np.maximum(np.linalg.norm(moved, axis=1, keepdims=True), np.finfo(float).tiny)

    return Evidence(
        round_trip=float(np.minimum(miss, _LOST).mean()),
        lost=float((miss > _FAR).mean()),
        stretch=float(np.abs(np.log((longer + 0.5 * spacing) / (length + 0.5 * spacing))).mean()),
        torn=float((longer > 4 * length + 3 * spacing).any(axis=1).mean()),
        dirichlet=float(np.sqrt(np.minimum((longer / (length + 0.3 * spacing)) ** 2, 25).mean())),
        orientation=float(side.mean()) if len(side) else 0.0,
        uncovered=float((away > 0.06).mean()),
        gap=float(np.minimum(away, _LOST).mean()),
        residual=float(np.sqrt(((rows @ motion - there) ** 2).sum(axis=1).mean())),
        normals=float(np.einsum("ij,ij->i", moved, target.normals[image]).mean()),
        descriptors=_mean_square(descriptors.at(corners, image)),
        embeddings=_mean_square(
            (source.features.embedded[corners], target.features.embedded[image])
        ),
        **_spectral(source, target, candidate),
    )


def _mean_square(rows: Rows) -> float:
    return float(np.nanmean(((rows[0] - rows[1]) ** 2).sum(axis=1)))


def _spectral(source: Sampled, target: Sampled, candidate: Candidate) -> dict[str, float]:
    """The evidence that the functional map of the samples gives."""
    image = nearest(candidate.forward[0][source.posed.sample], candidate.forward[1])[0]
    whole = target.features.spectrum.with_area(1.0)
    size = min(_FUNCTIONS, len(source.spectrum.eigenvalues), len(whole.eigenvalues))
    spectra = source.spectrum.truncated(size), whole.truncated(size)
    here, there = spectra[0].eigenvectors, spectra[1].eigenvectors[image]
    functional = here.T @ there / len(here)
    values = [spectrum.eigenvalues for spectrum in spectra]
    apart = (values[0][:, None] - values[1]) / np.sqrt(values[0][-1] * values[1][-1])
    product = functional.T @ functional - np.eye(size)

    few = np.random.default_rng(0).choice(len(here), min(_POINTS, len(here)), replace=False)
    lengths = []
    for rows, spectrum in zip((here, there), spectra, strict=True):
        scale = np.zeros(size)
        scale[spectrum.zero_modes :] = 1 / spectrum.eigenvalues[spectrum.zero_modes :]
        points = (rows * scale)[few]
        squares = (points**2).sum(axis=1)
        squared = squares[:, None] + squares - 2 * points @ points.T
        lengths.append(np.sqrt(np.maximum(squared, 0.0)))
    ratio = (lengths[0] * lengths[1]).sum() / max((lengths[1] ** 2).sum(), np.finfo(float).tiny)
    return {
        "commutator": float(np.sqrt((apart**2 * functional**2).sum() / size)),
        "nonorthogonality": float(np.sqrt((product**2).mean() * size)),
        "distances": float(np.abs(lengths[0] - ratio * lengths[1]).mean() / lengths[0].mean()),
    }


def cost(found: Evidence) -> float:
    """The linear score by which candidates are compared; the least is best.

    Differences of costs are log-odds that one candidate has the smaller error, fitted to pairs of
    candidates for the same two shapes: people, animals, heads and skulls.
    """
    return float(found.vector() @ np.array(_COST))


def accuracy(found: Evidence) -> float:
    """Expected share of matches within 5 % of the size of the truth, by a logistic regression.

    Fitted to candidates for pairs of people, animals, heads, skulls, cut and noisy people, and
    pairs of different classes, of which nothing is right. Where most ways there and back are lost,
    which none of these had, it is no more than the share of the others. Where an affine motion
    nearly is the map, it is at least 0.97, as of skulls and heads: embeddings by a model that does
    not know the class then say little.
    """
    logit = float(found.vector() @ np.array(_ACCURACY)) + _ACCURACY_CONSTANT
    expected = float(1 / (1 + np.exp(-logit)))
    close = all(getattr(found, name) < most for name, most in _SAME.items())
    if close and found.normals > _SAME_NORMALS:
        expected = max(expected, _SAME_ACCURACY)
    return min(expected, 1 - found.lost) if found.lost > _MOSTLY else expected
