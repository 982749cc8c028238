"""Transferring vertex and face data along a correspondence, and shapes between the two."""

from __future__ import annotations

from typing import Literal

import numpy as np
from scipy import sparse
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from esd.common import FloatArray, InputError, IntArray
from esd.matching.correspondence import Correspondence
from esd.mesh.geodesics import geodesic_graph
from esd.mesh.geometry import edge_lengths, is_referenced, surface_area, vertex_areas
from esd.mesh.mesh import Mesh
from esd.mesh.surface import (
    SurfacePoints,
    at_vertices,
    barycentric_weights,
    closest_in_triangles,
    interpolated,
)

Method = Literal["barycentric", "nearest"]

_TORN = 5  # a face whose image has edges this many times too long lies across a tear of the map
_CHUNK = 20_000


def vertex_places(
    source: Mesh, target: Mesh, match: Correspondence, *, method: Method = "barycentric"
) -> SurfacePoints:
    """The place on the source of each vertex of the target.

    The map takes the source's faces onto the target; a target vertex belongs where it lies in such
    a face (`barycentric`). With `nearest`, and where there is no such face, it belongs to the
    source vertex that is mapped nearest to it, by geodesic distance; of several source vertices
    with one image, that of the best match.

    Raises
    ------
    InputError
        If the map does not fit the meshes, or has no match.
    """
    vertices = np.arange(len(target.vertices))
    return places_of_points(source, target, match, target.vertices, vertices[:, None], method)


def face_places(
    source: Mesh, target: Mesh, match: Correspondence, *, method: Method = "barycentric"
) -> SurfacePoints:
    """The place on the source of the middle of each face of the target; see `vertex_places`."""
    middle = target.vertices[target.faces].mean(axis=1)
    return places_of_points(source, target, match, middle, target.faces, method)


def carried_values(values: FloatArray, source: Mesh, places: SurfacePoints) -> FloatArray:
    """Values (n, ...) at the source's vertices, interpolated at some places; NaN for none.

    Raises
    ------
    InputError
        If there is not one value for each vertex of the source.
    """
    _check_length(values, len(source.vertices), "value for each vertex")
    return interpolated(np.asarray(values, dtype=float), source, places)


def carried_labels(labels: IntArray, source: Mesh, places: SurfacePoints) -> IntArray:
    """Labels (n,) of the source's vertices at some places: that of most weight; -1 for none.

    Raises
    ------
    InputError
        If there is not one label for each vertex of the source.
    """
    _check_length(labels, len(source.vertices), "label for each vertex")
    corners = np.asarray(labels)[source.faces[places.face]]
    votes = np.einsum("pc,pcd->pd", places.weights, corners[:, :, None] == corners[:, None, :])
    winner = np.take_along_axis(corners, votes.argmax(axis=1)[:, None], axis=1)[:, 0]
    return np.where(places.face >= 0, winner, -1)


def carried_texture(
    coordinates: FloatArray, source: Mesh, target: Mesh, match: Correspondence
) -> FloatArray:
    """Texture coordinates at the corners of the target's faces, (m, 3, 2).

    A target face that lies across a seam of the texture is coloured from the side of the seam on
    which its middle lies: the coordinates there go on beyond the seam.

    Parameters
    ----------
    coordinates : (k, 3, 2)
        At the corners of the source's faces.

    Raises
    ------
    InputError
        If the coordinates or the map do not fit the meshes, or part of the target is out of reach.
    """
    _check_length(coordinates, len(source.faces), "triple of texture coordinates for each face")
    at_corners = vertex_places(source, target, match)
    middle = face_places(source, target, match)
    if (at_corners.face[target.faces] < 0).any() or (middle.face < 0).any():
        raise InputError("Part of the target has no match on any of its vertices; no texture.")

    def coloured(places: SurfacePoints) -> FloatArray:
        return np.asarray(np.einsum("pc,pcd->pd", places.weights, coordinates[places.face]))

    direct = coloured(at_corners)[target.faces]
    centre = coloured(middle)[:, None]
    image = target.vertices[match.target_index[source.faces[middle.face]]]
    corners = target.vertices[target.faces]
    going_on = np.empty_like(direct)
    for corner in range(3):
        with np.errstate(over="ignore"):  # images of faces may have hardly any area, or none
            weights = barycentric_weights(corners[:, corner], image)
        going_on[:, corner] = np.einsum("pc,pcd->pd", weights, coordinates[middle.face])
    is_across = np.linalg.norm(direct - centre, axis=2) > 2 * np.linalg.norm(
        going_on - centre, axis=2
    )
    return np.where(is_across.any(axis=1)[:, None, None], going_on, direct)


def carried_landmarks(vertices: IntArray, match: Correspondence) -> IntArray:
    """Target vertices, (l,), of some source vertices, of which -1 is none; -1 for none.

    Raises
    ------
    InputError
        If a landmark is no vertex of the source.
    """
    vertices = np.asarray(vertices)
    count = len(match.target_index)
    if len(vertices) and not (vertices.min() >= -1 and vertices.max() < count):
        raise InputError(
            f"Landmarks must be vertices from 0 to {count - 1}; "
            f"got {vertices.min()} to {vertices.max()}."
        )
    return np.where(vertices < 0, -1, match.target_index[vertices])


def aligned_image(source: Mesh, target: Mesh, match: Correspondence) -> FloatArray:
    """Positions (n, 3) of the matched points of the target, moved rigidly onto the source.

    The motion minimises the squared distances of matched points, weighted by area (Kabsch 1976).
    Source vertices without a match take the displacement of the nearest one that has one.

    Raises
    ------
    InputError
        If the map does not fit the meshes, or has no match.
    """
    rotation = aligning_rotation(source, target, match)
    here, there, weights = _matched_points(source, target, match)
    moved = (there - weights @ there) @ rotation.T + weights @ here
    _, nearest = KDTree(here).query(source.vertices)
    return np.asarray(source.vertices + (moved - here)[nearest])


def aligning_rotation(source: Mesh, target: Mesh, match: Correspondence) -> FloatArray:
    """The rotation (3, 3) that turns the target onto the source, columns to columns.

    It minimises the squared distances of matched points, weighted by area (Kabsch 1976).

    Raises
    ------
    InputError
        If the map does not fit the meshes, or has no match.
    """
    _check_fit(source, target, match)
    here, there, weights = _matched_points(source, target, match)
    if len(here) == 1:
        return np.eye(3)
    rotation, _ = Rotation.align_vectors(here - weights @ here, there - weights @ there, weights)
    return np.asarray(rotation.as_matrix())


def in_between(
    source: Mesh, target: Mesh, match: Correspondence, *, count: int
) -> tuple[Mesh, ...]:
    """Shapes from the source to its image on the target, both included, with the source's faces.

    Vertices move on straight lines, after the target has been moved rigidly onto the source.

    Raises
    ------
    InputError
        If `count` is less than two, or the map does not fit the meshes or has no match.
    """
    if count < 2:
        raise InputError(f"`count` must be two or more, the ends among them; got {count}.")
    image = aligned_image(source, target, match)
    shares = np.linspace(0, 1, count)
    return tuple(Mesh((1 - t) * source.vertices + t * image, source.faces) for t in shares)


def places_of_points(
    source: Mesh,
    target: Mesh,
    match: Correspondence,
    points: FloatArray,
    near: IntArray,
    method: Method,
) -> SurfacePoints:
    """Where points (p, 3) of the target lie on the source; each is near some vertices, (p, c)."""
    _check_fit(source, target, match)
    usable = np.flatnonzero(match.is_matched() & is_referenced(source))
    if len(usable) == 0:
        raise InputError("No face of the source has a match.")
    usable = usable[np.lexsort((match.distance[usable], match.target_index[usable]))]
    hit, first = np.unique(match.target_index[usable], return_index=True)
    hits = geodesic_graph(target).nearest_source(hit)[near]
    reach = np.linalg.norm(points[:, None] - target.vertices[hits], axis=2)
    reach[hits < 0] = np.inf
    first_choice = reach.argmin(axis=1)[:, None]
    of_image = np.full(len(target.vertices) + 1, -1)  # one more, for none
    of_image[hit] = usable[first]
    places = at_vertices(source, of_image[np.take_along_axis(hits, first_choice, axis=1)[:, 0]])
    if method == "nearest":
        return places

    image = match.target_index[source.faces]
    touching = _faces_at_images(source, target, image)
    best = np.take_along_axis(reach, first_choice, axis=1)[:, 0]
    for start in range(0, len(points), _CHUNK):
        chunk, column = np.nonzero(hits[start : start + _CHUNK] >= 0)
        rows = touching[hits[start + chunk, column]]
        which = np.repeat(start + chunk, np.diff(rows.indptr))
        triangles = target.vertices[image[rows.indices]]
        weights, squared = closest_in_triangles(points[which], triangles)
        order = np.lexsort((squared, which))
        order = order[np.unique(which[order], return_index=True)[1]]
        order = order[np.sqrt(squared[order]) < best[which[order]]]
        places.face[which[order]] = rows.indices[order]
        places.weights[which[order]] = weights[order]
    return places


def _faces_at_images(source: Mesh, target: Mesh, image: IntArray) -> sparse.csr_array:
    """Which source faces have a corner at which target vertex, without those the map destroys.

    Left out are faces that lose a corner, collapse, or are torn apart.
    """
    corners = target.vertices[image]
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    scale = np.sqrt(surface_area(target) / surface_area(source))
    usual = np.maximum(scale * edge_lengths(source).max(axis=1), edge_lengths(target).mean())
    area = np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    keep = (image >= 0).all(axis=1) & (longest <= _TORN * usual) & (area > 1e-9 * longest**2)
    face = np.flatnonzero(keep)
    return sparse.csr_array(
        (np.ones(3 * len(face)), (image[face].ravel(), np.repeat(face, 3))),
        shape=(len(target.vertices), len(image)),
    )


def _matched_points(
    source: Mesh, target: Mesh, match: Correspondence
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Matched points of both meshes, (c, 3), and the share of each in the area of all, (c,)."""
    matched = match.is_matched()
    areas = vertex_areas(source)
    areas = areas + 1e-9 * max(areas.sum(), 1e-300)  # none is zero, so that some are left
    weights = areas[matched] / areas[matched].sum()
    return source.vertices[matched], target.vertices[match.target_index[matched]], weights


def _check_fit(source: Mesh, target: Mesh, match: Correspondence) -> None:
    if len(match.target_index) != len(source.vertices):
        raise InputError(
            f"The map has {len(match.target_index)} vertices; the source mesh has "
            f"{len(source.vertices)}."
        )
    if match.target_index.max() >= len(target.vertices):
        raise InputError(
            f"The map names target vertex {match.target_index.max()} (from 0); the target mesh "
            f"has {len(target.vertices)}."
        )
    if not match.is_matched().any():
        raise InputError("The map has no match.")


def _check_length(values: FloatArray | IntArray, count: int, what: str) -> None:
    if len(values) != count:
        raise InputError(f"Expected one {what} of the source, {count} in all; got {len(values)}.")
