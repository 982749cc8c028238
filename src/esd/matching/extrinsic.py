"""Maps between shapes of one pose by alignment and smooth deformation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy import sparse
from scipy.spatial import KDTree
from scipy.spatial.distance import cdist
from scipy.spatial.transform import Rotation

from esd.common import BoolArray, FloatArray, IntArray
from esd.matching.precise import precise_map
from esd.mesh.geometry import is_referenced, unit, vertex_areas, vertex_normals
from esd.mesh.mesh import Mesh
from esd.mesh.sampling import spread
from esd.mesh.topology import boundary_edges

_NORMAL = 0.2  # weight of unit normals beside positions of unit root mean square radius
_COARSE, _SAMPLES = 300, 1500  # vertices that starts are compared by, and that alignment takes
_ROTATIONS = 8  # random starts beside the four of the principal axes
_KEPT = 4  # starts that are aligned finely
_SAME = 0.3  # rotations that differ by less, in radians, are one start
_TRIM = 0.8  # share of the correspondences nearer than which they count fully
_EXACT = 1e-9  # in √area: distances below it are rounding errors
_WHOLE, _DETAIL = (60, 0.8), (300, 0.3)  # number, and width in radii, of kernels that deform
_AMPLITUDE = 0.02  # expected displacement, in radii; the largest in detail
_OF_FOUND = 2.0  # expected displacement, times that of the round before, which is too small
_LANDMARK = 10.0  # weight of a landmark beside that of a nearest point
_RESOLUTION = 0.01  # least residual that is believed, in units of the radius


@dataclass(frozen=True, slots=True, eq=False)
class Posed:
    """Vertices of a shape in a frame of its own, and those of them that alignment takes.

    Parameters
    ----------
    points, normals : (n, 3)
        Centred, of unit root mean square radius by area; unit normals.
    usable : (n,)
        Whether a vertex is a fair counterpart: no vertex at a boundary, and none of a filling.
    sample : (s,)
        Vertices drawn by area.
    faces : (m, 3)
        Of the mesh, for normals after deformation.
    """

    points: FloatArray
    normals: FloatArray
    usable: BoolArray
    sample: IntArray
    faces: IntArray

    def keys(self) -> FloatArray:
        """Rows (n, 6) by which nearest points are found: positions, and normals beside them."""
        return np.hstack([self.points, _NORMAL * self.normals])

    def moved(self, linear: FloatArray, shift: FloatArray) -> Posed:
        """The shape after an affine motion."""
        # normals move by the inverse transposed, which keeps them outside in reflections as well
        normals = unit(self.normals @ np.linalg.inv(linear))
        return replace(self, points=self.points @ linear.T + shift, normals=normals)

    def displaced(self, points: npt.NDArray[np.float64]) -> Posed:
        """The shape with its vertices at other places."""
        return replace(self, points=points, normals=unit(vertex_normals(Mesh(points, self.faces))))


def posed(mesh: Mesh, *, filling: BoolArray | None = None, seed: int = 0) -> Posed:
    """A mesh centred and scaled, with a sample of its vertices.

    Parameters
    ----------
    filling : (n,)
        Vertices that fill holes, which take no part.
    """
    area = vertex_areas(mesh)
    usable = np.ones(len(area), dtype=bool) if filling is None else ~filling
    area = np.where(usable, area, 0.0)
    usable[boundary_edges(mesh).ravel()] = False
    area /= area.sum()
    points = mesh.vertices - area @ mesh.vertices
    points /= np.sqrt(area @ (points**2).sum(axis=1))
    count = min(_SAMPLES, int(np.count_nonzero(area)))
    sample = np.random.default_rng(seed).choice(len(area), count, replace=False, p=area)
    return Posed(points, unit(vertex_normals(mesh)), usable, sample, mesh.faces)


@dataclass(frozen=True, slots=True, eq=False)
class Alignment:
    """A source moved onto a target.

    Parameters
    ----------
    source
        After the motion.
    residual
        Root mean squared distance to the target, normals included, in radii of the target;
        about 0.05 for skulls of one species, 0.15 for people in different poses.
    """

    source: Posed
    residual: float


def aligned(
    source: Posed,
    target: Posed,
    *,
    matches: Sequence[tuple[IntArray, IntArray]] = (),
    search: bool = True,
    mirrored: bool = False,
    seed: int = 0,
) -> Alignment:
    """The source moved onto the target by the affine motion that fits best.

    Starts are the principal axes with their flips, random rotations, and the similarities that fit
    given matches. A similarity ICP of a few hundred points follows each; a trimmed ICP of all
    samples, first by similarities, then by affine motions, follows the best. Points at boundaries
    are no counterparts.

    Parameters
    ----------
    matches
        Pairs of source vertices and target vertices, (l,) each, of which a start is made each.
    search
        Whether there are other starts than those of the matches.
    mirrored
        Whether the motion reflects.

    References
    ----------
    Besl, McKay 1992, *A method for registration of 3-D shapes*; Chetverikov et al. 2002, *The
    trimmed iterative closest point algorithm*.
    """
    sign = -1.0 if mirrored else 1.0
    rotations = [
        (rotation, np.zeros(3))
        for rotation in _rotations(source, target, mirrored=mirrored, seed=seed)
        if search
    ]
    fitted = [
        _robust_fit(source.points[here], target.points[there], sign) for here, there in matches
    ]
    starts = [_followed(source, target, *start, sign) for start in (*rotations, *fitted)]
    trees = KDTree(target.keys()[target.sample]), KDTree(target.keys())
    return min(
        (_affine(source, target, trees, *start, sign) for start in _different(starts)[:_KEPT]),
        key=lambda alignment: alignment.residual,
    )


def deformed(
    source: Posed,
    target: Posed,
    *,
    landmarks: tuple[IntArray, IntArray] | None = None,
    rounds: int = 15,
) -> Posed:
    """An aligned source deformed smoothly onto the target, first as a whole, then in detail.

    The displacement is a Gaussian process: sums of Gaussian kernels, whose expected size is known
    and whose residual is estimated in each round, so that shapes that fit already are left alone.
    In detail the size is estimated too, and points of one surface are drawn to the nearest of the
    other, which need not be vertices: the distances between vertices would count as displacement.

    Parameters
    ----------
    landmarks : (l,) and (l,)
        Source vertices and target vertices that should meet.

    References
    ----------
    Myronenko, Song 2010, *Point set registration: coherent point drift*.
    """
    corners = [sparse.eye_array(len(each.points), format="csr") for each in (source, target)]
    whole = _searchable(target)
    wanted = whole.keys[target.sample]
    for kernels in (_WHOLE, _DETAIL):
        in_detail = kernels is _DETAIL
        basis = _smooth_functions(source, *kernels)
        amplitude, result = _AMPLITUDE, source
        for _ in range(rounds):
            own = _searchable(result)
            there, is_usable = _nearest_places(whole, own.keys[source.sample], on_faces=in_detail)
            here, is_usable_too = _nearest_places(own, wanted, on_faces=in_detail)
            here = sparse.vstack([corners[0][source.sample][is_usable], here[is_usable_too]])
            there = sparse.vstack([there[is_usable], corners[1][target.sample][is_usable_too]])
            weight = _trimmed(np.linalg.norm(here @ own.keys - there @ whole.keys, axis=1))
            if landmarks is not None:
                here = sparse.vstack([here, corners[0][landmarks[0]]])
                there = sparse.vstack([there, corners[1][landmarks[1]]])
                weight = np.append(weight, np.full(len(landmarks[0]), _LANDMARK))
            aim = there @ target.points
            gap = ((here @ result.points - aim) ** 2).sum(axis=1) / 3
            variance = max(weight @ gap / weight.sum(), _RESOLUTION**2)
            values = here @ basis
            normal = (values * weight[:, None]).T @ values
            normal[np.diag_indices_from(normal)] += variance / amplitude**2
            moments = (values * weight[:, None]).T @ (aim - here @ source.points)
            moved = basis @ np.linalg.solve(normal, moments)
            result = source.displaced(source.points + moved)
            if in_detail:
                found = float(np.sqrt((moved[source.sample] ** 2).mean()))
                amplitude = float(np.clip(_OF_FOUND * found, _EXACT, _AMPLITUDE))
        source = result
    return source


def _smooth_functions(shape: Posed, count: int, width: float) -> FloatArray:
    """Functions (n, c) whose sums, with coefficients of unit variance, are a Gaussian process."""
    points = shape.points[shape.sample]
    centre = points[spread(points, count)]

    def kernel(points: FloatArray) -> FloatArray:
        return np.asarray(np.exp(cdist(points, centre, "sqeuclidean") / (-2 * width**2)))

    values, vectors = np.linalg.eigh(kernel(centre))
    kept = values > 1e-6 * values[-1]
    return np.asarray(kernel(shape.points) @ (vectors[:, kept] / np.sqrt(values[kept])))


@dataclass(frozen=True, slots=True, eq=False)
class _Searchable:
    """A shape with the keys of its vertices, and a tree of those that have a face."""

    shape: Posed
    keys: FloatArray
    faced: IntArray
    tree: KDTree


def _searchable(shape: Posed) -> _Searchable:
    keys = shape.keys()
    mesh = Mesh(np.asarray(shape.points, dtype=np.float64), shape.faces)
    faced = np.flatnonzero(is_referenced(mesh))
    return _Searchable(shape, keys, faced, KDTree(keys[faced]))


def _nearest_places(
    found: _Searchable, rows: FloatArray, *, on_faces: bool
) -> tuple[sparse.csr_array, BoolArray]:
    """Weights (r, n) of the vertices at the places nearest to some rows, and which are usable."""
    index = found.faced[found.tree.query(rows)[1]]
    columns: IntArray = index[:, None]
    weights: FloatArray = np.ones((len(rows), 1))
    if on_faces:
        place = precise_map(rows, found.keys, found.shape.faces, index)
        columns, weights = found.shape.faces[place.face], place.weights
    start = columns.shape[1] * np.arange(len(rows) + 1)
    size = len(rows), len(found.keys)
    places = sparse.csr_array((weights.ravel(), columns.ravel(), start), size)
    return places, found.shape.usable[index]


def _rotations(source: Posed, target: Posed, *, mirrored: bool, seed: int) -> list[FloatArray]:
    """Orthogonal matrices to start from, which turn with the shapes."""
    axes = [_principal_axes(shape.points[shape.sample]) for shape in (source, target)]
    sign = -1.0 if mirrored else 1.0
    flips = [np.diag(each) for each in ((1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1))]
    random = Rotation.random(_ROTATIONS, random_state=seed).as_matrix()
    turned = [axes[1].T @ rotation @ axes[0] for rotation in (*flips, *random)]
    # the axes themselves may be left-handed: all three flipped are right-handed then
    return [each if np.linalg.det(each) * sign > 0 else -each for each in turned]


def _principal_axes(points: FloatArray) -> FloatArray:
    """Of points around the origin, (3, 3), a row each, towards where they reach farther."""
    axes = np.linalg.svd(points, full_matrices=False)[2]
    return np.asarray(axes * np.where(((points @ axes.T) ** 3).sum(axis=0) < 0, -1.0, 1.0)[:, None])


def _robust_fit(
    points: FloatArray, images: FloatArray, sign: float
) -> tuple[FloatArray, FloatArray]:
    """The similarity that takes most points to their images, by reweighted least squares."""
    weight = np.ones(len(points))
    for _ in range(10):
        linear, shift = _fit(points, images, weight, sign=sign, affine=False)
        miss = np.linalg.norm(points @ linear.T + shift - images, axis=1)
        weight = 1 / (1 + (miss / max(float(np.median(miss)), _EXACT)) ** 2)
    return linear, shift


def _followed(
    source: Posed,
    target: Posed,
    linear: FloatArray,
    shift: FloatArray,
    sign: float,
    rounds: int = 12,
) -> tuple[float, FloatArray, FloatArray]:
    """Residual, matrix and shift of a similarity ICP of few points from a start."""
    few, others = source.sample[:_COARSE], target.sample[:_COARSE]
    keys = target.keys()[others]
    tree = KDTree(keys)
    part = replace(source, points=source.points[few], normals=source.normals[few])
    every = np.arange(len(few))
    for _ in range(rounds):
        rows = part.moved(linear, shift).keys()
        away, there = tree.query(rows)
        back, here = KDTree(rows).query(keys)
        distance = np.concatenate([away, back])
        weight = 1.0 * (distance <= np.quantile(distance, 0.9)) + 1e-6
        linear, shift = _fit(
            part.points[np.concatenate([every, here])],
            target.points[others][np.concatenate([there, np.arange(len(others))])],
            weight,
            sign=sign,
            affine=False,
        )
    limit = np.quantile(distance, 0.95)
    return float(np.sqrt((np.minimum(distance, limit) ** 2).mean())), linear, shift


def _different(
    starts: Sequence[tuple[float, FloatArray, FloatArray]],
) -> list[tuple[FloatArray, FloatArray]]:
    """Matrices and shifts, best first, without those that lead where a better one does."""
    found: list[tuple[FloatArray, FloatArray]] = []
    for _, linear, shift in sorted(starts, key=lambda start: start[0]):
        size = np.linalg.norm(linear)
        if all(
            np.trace(linear.T @ other) < (1 + 2 * np.cos(_SAME)) / 3 * size * np.linalg.norm(other)
            for other, _ in found
        ):
            found.append((linear, shift))
    return found


def _affine(
    source: Posed,
    target: Posed,
    trees: tuple[KDTree, KDTree],
    linear: FloatArray,
    shift: FloatArray,
    sign: float,
) -> Alignment:
    """The source after a trimmed ICP: by similarities, then by affine motions.

    Parameters
    ----------
    trees
        Of the keys of the target's samples, which are enough until the last rounds, and of all.
    """
    samples, every = trees
    rounds = [(False, samples)] * 10 + [(True, samples)] * 7 + [(True, every)] * 3
    for affine, tree in rounds:
        here, there, weight, distance = _pairs(
            source.moved(linear, shift), target, tree, sampled=tree is samples
        )
        linear, shift = _fit(
            source.points[here], target.points[there], weight, sign=sign, affine=affine
        )
    residual = float(np.sqrt(weight @ distance**2 / weight.sum()))
    return Alignment(source.moved(linear, shift), residual)


def _pairs(
    source: Posed, target: Posed, tree: KDTree, *, sampled: bool = False
) -> tuple[IntArray, IntArray, FloatArray, FloatArray]:
    """Source vertices, target vertices, weights and distances of nearest points, both ways.

    With `sampled`, between the samples only, of which the tree is then.
    """
    keys = source.keys()
    away, there = tree.query(keys[source.sample])
    sought = target.keys()[target.sample]
    if sampled:
        there = target.sample[there]
        back, place = KDTree(keys[source.sample]).query(sought)
        here = source.sample[place]
    else:
        back, here = KDTree(keys).query(sought)
    one, two = target.usable[there], source.usable[here]
    distance = np.concatenate([away[one], back[two]])
    return (
        np.concatenate([source.sample[one], here[two]]),
        np.concatenate([there[one], target.sample[two]]),
        _trimmed(distance),
        distance,
    )


def _trimmed(distance: FloatArray) -> FloatArray:
    """Weights of correspondences by their distances, (l,)."""
    scale = max(float(np.quantile(distance, _TRIM)), _EXACT)
    return np.asarray(1 / (1 + (distance / scale) ** 4))


def _fit(
    points: FloatArray, images: FloatArray, weight: FloatArray, *, sign: float, affine: bool
) -> tuple[FloatArray, FloatArray]:
    """Matrix and shift of the affine motion, or the similarity, that takes points to images."""
    weight = weight / weight.sum()
    middle, other = weight @ points, weight @ images
    x, y = points - middle, images - other
    product = (y * weight[:, None]).T @ x
    u, stretch, vt = np.linalg.svd(product)  # Umeyama 1991
    flips = np.array([1.0, 1.0, sign * np.sign(np.linalg.det(u @ vt))])
    size = (stretch * flips).sum() / (weight @ (x**2).sum(axis=1))
    linear = size * u @ np.diag(flips) @ vt
    if affine:
        moment = (x * weight[:, None]).T @ x
        ridge = 1e-6 * np.trace(moment)
        moment[np.diag_indices(3)] += ridge
        # where the points do not extend, as across a flat shape, the similarity decides
        linear = np.linalg.solve(moment, (product + ridge * linear).T).T
    return linear, other - linear @ middle
