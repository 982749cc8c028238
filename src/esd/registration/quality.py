"""How well a registered template fits its scan."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

from esd.common import FloatArray
from esd.deformation.fit import Fit, is_inverted
from esd.mesh.geometry import edges, face_areas, is_referenced, vertex_areas
from esd.mesh.mesh import Mesh, PointCloud
from esd.mesh.surface import closest_points, positions
from esd.mesh.topology import is_collapsed

_COVERED = 0.01  # of the extent: what is farther from the template is not covered
_NEAR = 3  # vertices of the scan around which the closest point of its surface is sought


@dataclass(frozen=True, slots=True)
class Quality:
    """Figures of a registration.

    Parameters
    ----------
    distance, farthest : float
        Mean and largest distance of the supported vertices to the scan, in its unit of length.
    extent : float
        Longest side of the scan's bounding box.
    supported : float
        Share of the template's vertices where the scan has a surface.
    covered : float
        Share of the scan's area that is nearer to the template than 1 % of the extent.
    inverted : int
        Faces whose normal is against the sum of those of their neighbours, and was not at rest.
    intersecting
        Pairs of faces that cut through each other; None where libigl is not installed.
    stretch : (float, float, float)
        Quantiles 1 %, 50 % and 99 % of the lengths of edges over those of the template, its scale
        taken out.
    """

    distance: float
    farthest: float
    extent: float
    supported: float
    covered: float
    inverted: int
    intersecting: int | None
    stretch: tuple[float, float, float]

    @property
    def relative_distance(self) -> float:
        """Mean distance over the longest side of the scan's bounding box."""
        return self.distance / self.extent


def quality(template: Mesh, scan: Mesh | PointCloud, fitted: Fit) -> Quality:
    """How well a fitted template lies on its scan."""
    mesh = Mesh(fitted.vertices, template.faces)
    extent = float(np.ptp(scan.vertices, axis=0).max())
    distance = distance_to(scan, fitted.vertices[fitted.supported])
    i, j = edges(template).T
    before, after = (
        np.linalg.norm(vertices[i] - vertices[j], axis=1)
        for vertices in (template.vertices * fitted.scale, fitted.vertices)
    )
    ratio = after / np.maximum(before, np.finfo(float).tiny)
    low, middle, high = np.quantile(ratio, [0.01, 0.5, 0.99])
    return Quality(
        distance=float(distance.mean()) if len(distance) else float("nan"),
        farthest=float(distance.max()) if len(distance) else float("nan"),
        extent=extent,
        supported=float(fitted.supported.mean()),
        covered=_covered(scan, mesh, extent),
        inverted=int((is_inverted(mesh) & ~is_inverted(template)).sum()),
        intersecting=_intersecting(mesh),
        stretch=(float(low), float(middle), float(high)),
    )


def _covered(scan: Mesh | PointCloud, mesh: Mesh, extent: float) -> float:
    area = vertex_areas(scan) if isinstance(scan, Mesh) else np.ones(len(scan.vertices))
    is_near = distance_to(mesh, scan.vertices) < _COVERED * extent
    return float(area[is_near].sum() / area.sum())


def distance_to(scan: Mesh | PointCloud, points: FloatArray) -> FloatArray:
    """Distance of each point, (p,), to the scan: its surface, or the nearest of its points."""
    if isinstance(scan, PointCloud):
        return np.asarray(KDTree(scan.vertices).query(points)[0])
    used = np.flatnonzero(is_referenced(scan))
    count = min(_NEAR, len(used))
    _, near = KDTree(scan.vertices[used]).query(points, k=np.arange(1, count + 1))
    least = np.full(len(points), np.inf)
    for column in used[near].T:
        found = positions(scan, closest_points(scan, points, column))
        least = np.minimum(least, np.linalg.norm(found - points, axis=1))
    return least


def _intersecting(mesh: Mesh) -> int | None:
    try:
        from igl.copyleft import cgal
    except ImportError:
        return None
    faces = mesh.faces[~is_collapsed(mesh.faces) & (face_areas(mesh) > 0)]
    found = cgal.remesh_self_intersections(np.array(mesh.vertices), faces, detect_only=True)[2]
    return len(found)
