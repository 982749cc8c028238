"""The statistical model of a population: a mean shape and its principal modes."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from esd.common import FloatArray, InputError, IntArray, existing_file, reason, whole_file
from esd.mesh.mesh import Mesh
from esd.population.missing import is_present
from esd.population.procrustes import aligned_to

_NOISE = 1e-6  # of the total variance: of a coordinate, where scores are estimated from a part
_LEAST = 1e-12  # of the largest variance: modes with less are none


@dataclass(frozen=True, slots=True, eq=False)
class ShapeModel:
    """A mean shape and the directions in which a population varies.

    A shape is `mean + Σ score_k modes[k]`. The mean of the squared displacement over the surface is
    the square of the score, since Σ mass |mode|² = 1 over the vertices; so scores are lengths.

    Parameters
    ----------
    mean : (n, 3)
        NaN at vertices that too few shapes have.
    modes : (k, n, 3)
        Principal modes, by falling variance.
    variances : (k,)
        Of the scores, in units of length squared.
    faces : (m, 3)
    mass : (n,)
        Share of the area that belongs to each vertex.
    total_variance : float
        Of all modes, also those that were left out.
    keep_size : bool
        Whether the shapes kept their sizes when they were aligned.
    """

    mean: npt.NDArray[np.float64]
    modes: npt.NDArray[np.float64]
    variances: npt.NDArray[np.float64]
    faces: IntArray
    mass: npt.NDArray[np.float64]
    total_variance: float
    keep_size: bool = False

    def __repr__(self) -> str:
        share = self.explained()
        return (
            f"<ShapeModel of {len(self.mean)} vertices: {len(self.modes)} modes, "
            f"{share[-1] if len(share) else 1:.0%} of the variance>"
        )

    def explained(self) -> npt.NDArray[np.float64]:
        """Share of the total variance that the first 1, 2, … modes explain, (k,)."""
        return np.cumsum(self.variances) / max(self.total_variance, np.finfo(float).tiny)

    def reconstructed(self, scores: FloatArray) -> npt.NDArray[np.float64]:
        """Vertices of the shapes of some scores.

        Parameters
        ----------
        scores : (…, j)
            Of the first j modes, in units of length; further modes have score zero.

        Returns
        -------
        (…, n, 3)

        Raises
        ------
        InputError
            If there are more scores than modes.
        """
        scores = np.asarray(scores, dtype=np.float64)
        count = scores.shape[-1] if scores.ndim else 0
        if scores.ndim == 0 or count > len(self.modes):
            raise InputError(
                f"`scores` must have shape (…, j) with j up to {len(self.modes)}, the number of "
                f"modes; got {scores.shape}."
            )
        return self.mean + np.tensordot(scores, self.modes[:count], axes=1)

    def scores(self, vertices: FloatArray) -> npt.NDArray[np.float64]:
        """Scores, (k,), of a registered shape; where vertices are missing, the most probable ones.

        Parameters
        ----------
        vertices : (n, 3)
            In the template's order, anywhere in space; NaN at missing vertices.

        Raises
        ------
        InputError
            If the number of vertices is another, or too few are there.
        """
        if np.shape(vertices) != self.mean.shape:
            raise InputError(
                f"`vertices` must have shape {self.mean.shape}; got {np.shape(vertices)}."
            )
        moved = aligned_to(self.mean, vertices, mass=self.mass, keep_size=self.keep_size)
        present = is_present(moved) & is_present(self.mean)
        modes = self.modes[:, present].reshape(len(self.modes), -1)
        weighted = modes * np.repeat(self.mass[present], 3)
        noise = _NOISE * self.total_variance
        # conditional mean of Gaussian scores, given the vertices that are there and their noise
        precision = weighted @ modes.T + np.diag(noise / self.variances)
        right = weighted @ (moved - self.mean)[present].ravel()
        return np.asarray(np.linalg.solve(precision, right))

    def deviation(self) -> npt.NDArray[np.float64]:
        """Standard deviation of the position of each vertex by the modes, (n,), a length."""
        squares = (self.modes**2).sum(axis=2)
        return np.asarray(np.sqrt(np.tensordot(self.variances, squares, axes=1)))


@dataclass(frozen=True, slots=True, eq=False)
class Components:
    """A model, and the scores of the shapes that it was made of, (s, k)."""

    model: ShapeModel
    scores: npt.NDArray[np.float64]


def principal_components(
    vertices: npt.NDArray[np.float64],
    faces: IntArray,
    *,
    mass: FloatArray,
    count: int | None = None,
    keep_size: bool = False,
) -> Components:
    """The principal modes of aligned shapes.

    Parameters
    ----------
    vertices : (s, n, 3)
        Complete, see `esd.population.missing.completed`; NaN only where all shapes have it.
    mass : (n,)
        Weights of the vertices; they sum to one over those that are there.
    count
        Number of modes that are kept; by default all with variance.
    keep_size
        See `ShapeModel`.

    References
    ----------
    Cootes, Taylor, Cooper, Graham 1995, *Active shape models: their training and application*.
    """
    mean = vertices.mean(axis=0)
    present = is_present(mean)
    centred = vertices - mean
    gram = np.einsum(
        "ivc,jvc,v->ij", centred[:, present], centred[:, present], mass[present], optimize=True
    )
    values, vectors = np.linalg.eigh(gram)
    values, vectors = np.maximum(values[::-1], 0.0), vectors[:, ::-1]
    real = int(np.count_nonzero(values > _LEAST * max(values[0], np.finfo(float).tiny)))
    kept = min(real, len(vertices) - 1) if count is None else min(real, count, len(vertices) - 1)
    values, vectors = values[:kept], vectors[:, :kept]
    scores = vectors * np.sqrt(values)
    modes = np.einsum("ik,ivc->kvc", vectors / np.sqrt(values), centred, optimize=True)
    # signs are arbitrary: the first shape that scores most has a positive score
    sign = np.sign(scores[np.abs(scores).argmax(axis=0), np.arange(kept)])
    freedom = len(vertices) - 1
    model = ShapeModel(
        mean=mean,
        modes=modes * sign[:, None, None],
        variances=values / freedom,
        faces=faces,
        mass=np.asarray(mass, dtype=np.float64),
        total_variance=float(np.trace(gram) / freedom),
        keep_size=keep_size,
    )
    return Components(model, scores * sign)


def without_missing(vertices: npt.NDArray[np.float64], faces: IntArray) -> Mesh:
    """The mesh of the faces all of whose vertices are there; others lie at the mean of these."""
    present = is_present(vertices)
    middle = vertices[present].mean(axis=0)
    return Mesh(np.where(present[:, None], vertices, middle), faces[present[faces].all(axis=1)])


_ARRAYS = ("mean", "modes", "variances", "faces", "mass", "total_variance", "keep_size")


def save_shape_model(model: ShapeModel, path: str | os.PathLike[str]) -> None:
    """Write a model to a `.npz` file, its arrays by the names of `ShapeModel`.

    Raises
    ------
    InputError
        If the name ends otherwise, or the file cannot be written.
    """
    path = Path(path)
    if path.suffix.lower() != ".npz":
        raise InputError(f"'{path}': models of populations are written to .npz files.")
    with whole_file(path) as temporary:
        np.savez_compressed(temporary, **{name: getattr(model, name) for name in _ARRAYS})


def load_shape_model(path: str | os.PathLike[str]) -> ShapeModel:
    """The model in a file that `save_shape_model` wrote.

    Raises
    ------
    InputError
        If there is no such file, or no model in it.
    """
    path = existing_file(path)
    try:
        with np.load(path, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in _ARRAYS}
    except Exception as error:  # zipfile and numpy fail in many ways on damaged files
        raise InputError(
            f"'{path}' is no model of a population as `esd atlas` writes them: {reason(error)}."
        ) from error
    mean, modes, faces = arrays["mean"], arrays["modes"], arrays["faces"]
    count = len(modes) if modes.ndim else 0
    shapes = {
        "mean": (mean.shape[0] if mean.ndim else 0, 3),
        "modes": (count, *mean.shape),
        "variances": (count,),
        "faces": (len(faces) if faces.ndim else 0, 3),
        "mass": mean.shape[:1],
        "total_variance": (),
        "keep_size": (),
    }
    for name, shape in shapes.items():
        if arrays[name].shape != shape:
            raise InputError(
                f"'{path}': `{name}` must have shape {shape}; got {arrays[name].shape}."
            )
    within = faces.min(initial=0) >= 0 and faces.max(initial=-1) < len(mean)
    if faces.dtype.kind not in "iu" or not within:
        raise InputError(f"'{path}': `faces` must hold vertices from 0 to {len(mean) - 1}.")
    return ShapeModel(
        mean=mean.astype(np.float64),
        modes=modes.astype(np.float64),
        variances=arrays["variances"].astype(np.float64),
        faces=faces.astype(np.int64),
        mass=arrays["mass"].astype(np.float64),
        total_variance=float(arrays["total_variance"]),
        keep_size=bool(arrays["keep_size"]),
    )
