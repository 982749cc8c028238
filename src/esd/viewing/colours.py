"""Colours of vertices that people with colour blindness can tell apart too."""

from __future__ import annotations

import numpy as np

from esd.common import FloatArray, IntArray
from esd.mesh.mesh import Mesh

UNMATCHED = (0.62, 0.62, 0.62)
"""Red, green and blue of a vertex without a match, or without a value."""

VIRIDIS = (
    *("440154", "482475", "414487", "355f8d", "2a788e", "21918c"),
    *("22a884", "44bf70", "7ad151", "bddf26", "fde725"),
)
"""Equally spaced colours of matplotlib's viridis, whose lightness rises evenly."""


def position_colours(mesh: Mesh) -> FloatArray:
    """A colour of each vertex, red, green and blue (n, 3) from 0 to 1, smooth over space.

    Along the longest side of the bounding box blue turns into yellow by way of red, and along the
    second and less along the third the lightness changes: nearly all people can tell these apart,
    and nothing is grey.
    """
    extents = np.ptp(mesh.vertices, axis=0)
    order = np.argsort(-extents, kind="stable")
    relative = (mesh.vertices - mesh.vertices.min(axis=0)) / np.maximum(extents, 1e-300)
    # half by rank, so that colours differ most where most of the shape is
    rank = np.argsort(np.argsort(mesh.vertices, axis=0, kind="stable"), axis=0) / len(relative)
    first, second, third = ((relative + rank) / 2)[:, order].T
    hue = np.deg2rad(-100 + 200 * first)  # in Oklab's plane: blue, through red, to yellow
    lightness = 0.43 + 0.16 * first + 0.24 * second + 0.06 * third
    return oklab_to_rgb(lightness, 0.14 * np.cos(hue), 0.16 * np.sin(hue))


def oklab_to_rgb(lightness: FloatArray, a: FloatArray, b: FloatArray) -> FloatArray:
    """Red, green and blue (n, 3) of colours in Oklab, those beyond what screens show clipped.

    Ottosson 2020, *A perceptual color space for image processing*.
    """
    cone = np.stack(
        [
            lightness + 0.3963377774 * a + 0.2158037573 * b,
            lightness - 0.1055613458 * a - 0.0638541728 * b,
            lightness - 0.0894841775 * a - 1.2914855480 * b,
        ],
        axis=-1,
    )
    matrix = np.array(
        [
            [4.0767416621, -3.3077115913, 0.2309699292],
            [-1.2684380046, 2.6097574011, -0.3413193965],
            [-0.0041960863, -0.7034186147, 1.7076147010],
        ]
    )
    linear = np.clip(cone**3 @ matrix.T, 0, 1)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)


def carried_colours(colours: FloatArray, target_index: IntArray) -> FloatArray:
    """The colours (m, 3) of a target's vertices brought to a source by a map, (n, 3)."""
    matched = target_index >= 0
    return np.where(matched[:, None], colours[np.maximum(target_index, 0)], UNMATCHED)
