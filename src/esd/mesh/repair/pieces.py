"""What becomes of the vertices of loose pieces, of which only one is matched."""

from __future__ import annotations

import numpy as np
from scipy.spatial import KDTree

from esd.common import FloatArray, IntArray
from esd.mesh.repair.arrays import diagonal

NEAR = 0.05
"""Of the kept piece's bounding diagonal: vertices of other pieces within it have a stand-in."""


def stand_ins(vertices: FloatArray, *, kept: IntArray, dropped: IntArray) -> IntArray:
    """The kept vertex nearest to each dropped one, (d,), if it is near; −1 otherwise.

    Parameters
    ----------
    vertices : (n, 3)
    kept, dropped : (k,) and (d,)
        Vertices of the piece that is kept, and of the others.
    """
    if len(dropped) == 0:
        return np.zeros(0, dtype=np.int64)
    limit = NEAR * diagonal(vertices[kept])
    distance, nearest = KDTree(vertices[kept]).query(
        vertices[dropped], distance_upper_bound=np.nextafter(limit, np.inf)
    )
    # where there is none within the bound, the distance is infinite and the index beyond the last
    return np.where(np.isfinite(distance), np.append(kept, -1)[nearest], -1)
