"""Places of a scan that distant parts of a template claim, and which part has the better claim."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import sparse
from scipy.sparse import csgraph
from scipy.spatial import KDTree

from esd.common import BoolArray, FloatArray
from esd.deformation.elastic import Elastic
from esd.mesh.sampling import spread

_ANCHORS = 48  # vertices, distances from which bound those between any two from below
_APART = 0.2  # in √area: along the template, between parts that cannot share a place
_PLACE = 0.04  # in √area: how large a place of the scan is
_CLAIMS = 24  # at most, that are compared at a place


@dataclass(frozen=True, slots=True, eq=False)
class Claims:
    """How far the vertices of a template are from each other.

    Parameters
    ----------
    distance : (n, a)
        Along the edges at rest, in √area, from each of some vertices spread over the template. By
        the triangle inequality, the largest difference of two rows is no more than the distance of
        their vertices.
    mass : (n,)
        Share of the area that belongs to each vertex.
    """

    distance: npt.NDArray[np.float64]
    mass: npt.NDArray[np.float64]

    def contested(
        self, places: FloatArray, normals: FloatArray, weight: FloatArray, *, unit: float
    ) -> BoolArray:
        """Whether a part of the template far from a vertex has a better claim to its place, (n,).

        A surface lies on a scan once. Where a scan lacks a leg, a map or nearest points may put
        both legs of a template on the one that is there; the claim with more weight is upheld.

        Parameters
        ----------
        places : (n, 3)
            On the scan.
        normals : (n, 3)
            Of the scan there: both sides of thin parts are different places.
        weight : (n,)
            Of the claim of each vertex; zero for none.
        unit
            √area of the template at the scale of the scan.
        """
        claiming = np.flatnonzero(weight > 0)
        result = np.zeros(len(weight), dtype=bool)
        if len(claiming) == 0:
            return result
        reach = _PLACE * unit
        position = np.hstack([places, reach * normals])[claiming]
        count = min(_CLAIMS, len(claiming))
        gap, column = KDTree(position).query(
            position, k=np.arange(1, count + 1), distance_upper_bound=reach
        )
        is_there = np.isfinite(gap)
        other = claiming[np.where(is_there, column, 0)]
        claim = np.where(is_there, (self.mass * weight)[other], 0.0)
        apart = np.stack(
            [
                np.abs(self.distance[claiming] - self.distance[each]).max(axis=1) > _APART
                for each in other.T
            ],
            axis=1,
        )
        result[claiming] = (claim * apart).sum(axis=1) > (claim * ~apart).sum(axis=1)
        return result


def claims(body: Elastic) -> Claims:
    """The `Claims` of the parts of a template."""
    i, j = body.edge.T
    length = np.linalg.norm(body.rest[i] - body.rest[j], axis=1) / body.unit
    # a zero entry would mean 'no edge', but vertices at one place are connected
    length = np.maximum(length, np.finfo(float).tiny)
    size = len(body.rest)
    graph = sparse.csr_array((length, (i, j)), shape=(size, size))
    anchor = spread(body.rest, _ANCHORS)
    return Claims(csgraph.dijkstra(graph, directed=False, indices=anchor).T, body.mass)
