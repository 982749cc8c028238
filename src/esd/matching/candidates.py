"""Several ways from two shapes to a map, each refined coarsely, of which a judge takes the best."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy import linalg

from esd.common import BoolArray, FloatArray, IntArray
from esd.matching.extrinsic import Posed, posed
from esd.matching.features import Features
from esd.matching.functional_map import functional_map, spectral_rows
from esd.matching.refine import zoomout
from esd.mesh.geometry import face_areas, surface_area, unit, vertex_normals
from esd.mesh.mesh import Mesh
from esd.nearest import nearest
from esd.parallel import side_by_side
from esd.spectral.spectrum import Spectrum

Values = npt.NDArray[np.float32]
"""Descriptors of vertices, (n, w)."""

Rows = tuple[FloatArray, FloatArray]
"""Rows of the source's and of the target's vertices, (n, d) and (m, d)."""

CANDIDATES = {
    "embedding": "nearest embeddings of the model",
    "descriptors": "nearest descriptors of the pair itself, without a model",
    "extrinsic": "affine alignment and smooth deformation, for shapes of one pose",
    "extrinsic+embedding": "extrinsic, refined with the embeddings",
    "extrinsic+descriptors": "extrinsic, refined with the descriptors",
    "registered": "the others, the source deformed onto the target along them",
    "part": "embeddings of a model of parts, where a shape has large holes or is cut",
}
"""Names of the candidates, and what each is."""

LANDMARK_CANDIDATES = {
    "landmarks+embedding": "distances to the landmarks, beside embeddings of the model",
    "landmarks+descriptors": "distances to the landmarks, beside descriptors of the pair",
    "landmarks+extrinsic": "alignment by the landmarks and smooth deformation",
    "registered": CANDIDATES["registered"],
}
"""Names of the candidates where landmarks are given, and what each is."""

_FROM_NOTHING = (8, 14, 20, 30, 45, 60)  # eigenfunctions: few first, so that limbs are sorted out
FROM_POSE = (20, 30, 45, 60)
"""Eigenfunctions of the refinement of a map that is about right."""

_COMPONENTS = 48  # of the descriptors of a pair
_LIMIT = 3.0  # deviations at which descriptors are cut off
_WEIGHT = 0.8  # of embeddings beside eigenfunctions in the rows of a candidate
_NORMALS = 0.05  # of unit normals beside positions, in nearest points of deformed shapes
_TRIANGLES = 600  # at whose corners maps are judged


@dataclass(frozen=True, slots=True, eq=False)
class Sampled:
    """A shape, and the samples that its candidates are computed and judged on.

    Parameters
    ----------
    features
        Of a mesh.
    posed
        Its vertices, normalised, with a sample drawn by area.
    spectrum
        Of unit area, at the sample.
    corners : (q,)
        Vertices at which maps are judged.
    triangles : (t, 3)
        Faces drawn by area, as indices into `corners`.
    points, normals : (n, 3)
        Positions in units of √area, and unit normals, of all vertices.
    """

    features: Features
    posed: Posed
    spectrum: Spectrum
    corners: IntArray
    triangles: IntArray
    points: FloatArray
    normals: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """A map, and a map back, between all vertices, as nearest rows.

    Parameters
    ----------
    name
        One of `CANDIDATES`.
    forward, backward
        Rows by which the map, and the map back, go to the nearest.
    embeddings
        What the refinement of the map goes by; None for maps that are not refined.
    """

    name: str
    forward: Rows
    backward: Rows
    embeddings: Rows | None

    @property
    def is_extrinsic(self) -> bool:
        """Whether the map is by alignment, not refined yet."""
        return self.name.endswith("extrinsic")


@dataclass(frozen=True, slots=True, eq=False)
class PairDescriptors:
    """Descriptors of a pair, standardised over both shapes, in their principal components.

    Computed for the vertices that are asked for: judging a map takes a tenth of them. Rows have a
    mean square of about nine at the most; NaN at vertices without a face.

    Parameters
    ----------
    source, target : (n, w) and (m, w)
        Descriptors of all vertices.
    mean, deviation : (w,)
        Of both shapes' samples.
    centre : (w,)
        Of what is standardised.
    axes : (w, c)
        Principal components.
    """

    source: Values
    target: Values
    mean: Values
    deviation: Values
    centre: Values
    axes: Values

    def at(self, here: IntArray, there: IntArray) -> Rows:
        """Rows of some vertices of the source, and of some of the target."""
        return self._rows(self.source[here]), self._rows(self.target[there])

    def rows(self) -> Rows:
        """Rows of all vertices of both shapes."""
        return self._rows(self.source), self._rows(self.target)

    def reversed(self) -> PairDescriptors:
        """Those of the target and the source."""
        return replace(self, source=self.target, target=self.source)

    def _rows(self, values: Values) -> Values:
        rows = _standard(values, self.mean, self.deviation)
        rows -= self.centre
        return np.asarray(rows @ self.axes, dtype=np.float32)


def sampled(features: Features, *, seed: int = 0) -> Sampled:
    """The samples of a mesh; what fills its holes is not drawn."""
    mesh = features.shape
    assert isinstance(mesh, Mesh)  # point clouds have no candidates
    filling: BoolArray = np.zeros(len(mesh.vertices), dtype=bool)
    if features.copy is None:
        filling = features.is_filling()
    pose = posed(Mesh(features.positions, mesh.faces), filling=filling, seed=seed)
    spectrum = features.spectrum.with_area(1.0)
    count = len(pose.sample)
    area = np.where(filling[mesh.faces].any(axis=1), 0.0, face_areas(mesh))
    chosen = np.random.default_rng(seed).choice(
        len(area),
        min(_TRIANGLES, int(np.count_nonzero(area))),
        replace=False,
        p=area / area.sum(),
    )
    corners, triangles = np.unique(mesh.faces[chosen], return_inverse=True)
    return Sampled(
        features,
        pose,
        replace(  # a sample drawn by area has the same area at each vertex
            spectrum,
            eigenvectors=spectrum.eigenvectors[pose.sample],
            mass=np.full(count, 1 / count),
        ),
        corners,
        triangles.reshape(-1, 3),
        mesh.vertices / np.sqrt(surface_area(mesh)),
        unit(vertex_normals(mesh)),
    )


def candidate_of(source: Sampled, target: Sampled, index: IntArray, back: IntArray) -> Candidate:
    """The candidate that a map between all vertices, (n,), and a map back, (m,), are."""
    there, here = target.points, source.points
    return Candidate("", (there[index], there), (here, here[back]), None)


def spectral_candidate(
    name: str,
    source: Sampled,
    target: Sampled,
    embeddings: Rows,
    *,
    start: tuple[IntArray, IntArray] | None = None,
    sizes: Sequence[int] = _FROM_NOTHING,
) -> Candidate:
    """A map refined on the samples by `zoomout`, with embeddings of all vertices beside.

    Parameters
    ----------
    start : (s,) and (s,)
        Maps between the samples to start from; by default the nearest embeddings.
    """
    there, back = start if start is not None else (None, None)
    forward, backward = side_by_side(
        lambda way: rows_one_way(*way, sizes=sizes),
        (
            (source, target, embeddings, there),
            (target, source, (embeddings[1], embeddings[0]), back),
        ),
    )
    # computed from the target to the source, and put back into the order (source, target)
    return Candidate(name, forward, (backward[1], backward[0]), embeddings)


def sample_maps(
    source: Sampled, target: Sampled, candidate: Candidate
) -> tuple[IntArray, IntArray]:
    """The map of a candidate between the samples, and the one back, (s,) and (s,)."""
    forward = candidate.forward
    at_samples = forward[0][source.posed.sample], forward[1][target.posed.sample]
    return nearest(*at_samples)[0], nearest(*at_samples[::-1])[0]


def rows_one_way(
    source: Sampled,
    target: Sampled,
    embeddings: Rows,
    start: IntArray | None = None,
    *,
    sizes: Sequence[int] = _FROM_NOTHING,
) -> Rows:
    """The rows of the map of `spectral_candidate`, without the map back."""
    at_samples = embeddings[0][source.posed.sample], embeddings[1][target.posed.sample]
    if start is None:
        start = nearest(*at_samples)[0]
    index = zoomout(source.spectrum, target.spectrum, start, sizes=sizes, embeddings=at_samples)
    return _rows(source, target, index, embeddings, sizes[-1])


def _rows(source: Sampled, target: Sampled, index: IntArray, embeddings: Rows, size: int) -> Rows:
    """Rows of all vertices whose nearest extend a map between the samples."""
    spectra = source.spectrum, target.spectrum
    size = min(size, *(len(spectrum.eigenvalues) for spectrum in spectra))
    functional = functional_map(*spectra, index, size=size)
    here, there = source.posed.sample, target.posed.sample
    at_samples = spectral_rows(*spectra, functional)
    gap = np.sqrt(((at_samples[0] - at_samples[1][index]) ** 2).sum(axis=1).mean())
    miss = np.sqrt(((embeddings[0][here] - embeddings[1][there[index]]) ** 2).sum(axis=1).mean())
    weight = _WEIGHT * gap / max(miss, 1e-3)
    rows = spectral_rows(source.features.spectrum, target.features.spectrum, functional)
    return (
        np.hstack([rows[0], weight * embeddings[0]]).astype(np.float32),
        np.hstack([rows[1], weight * embeddings[1]]).astype(np.float32),
    )


def pair_descriptors(source: Sampled, target: Sampled) -> PairDescriptors:
    """The `PairDescriptors` of two shapes, fitted at their samples."""
    values = source.features.values, target.features.values
    both = np.concatenate([values[0][source.posed.sample], values[1][target.posed.sample]])
    # moments in 64 bits, all else in the 32 of the descriptors
    mean = np.asarray(np.nanmean(both, axis=0, dtype=np.float64), dtype=np.float32)
    deviation = np.asarray(np.nanstd(both, axis=0, dtype=np.float64), dtype=np.float32)
    deviation[deviation == 0] = 1.0
    rows = _standard(both, mean, deviation)
    rows = rows[np.isfinite(rows).all(axis=1)]
    centre = rows.mean(axis=0)
    rows -= centre
    width = rows.shape[1]
    _, axes = linalg.eigh(
        rows.T @ rows,
        subset_by_index=(max(0, width - _COMPONENTS), width - 1),
        overwrite_a=True,
        check_finite=False,
    )
    return PairDescriptors(*values, mean, deviation, centre, axes)


def _standard(rows: Values, mean: Values, deviation: Values) -> Values:
    """Rows without mean and of unit deviation, cut off, of a mean square of nine at the most."""
    result = rows - mean
    result /= deviation
    np.clip(result, -_LIMIT, _LIMIT, out=result)
    result *= np.float32(_LIMIT / np.sqrt(rows.shape[1]))
    return result


def extrinsic_candidate(source: Posed, target: Posed, *, name: str = "extrinsic") -> Candidate:
    """The nearest points of a deformed source and the target, normals beside."""
    rows = (
        np.hstack([source.points, _NORMALS * source.normals]),
        np.hstack([target.points, _NORMALS * target.normals]),
    )
    return Candidate(name, rows, rows, rows)
