"""Styles of triangles."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Style:
    """What the triangles are like.

    Parameters
    ----------
    grading : float
        Power of the curvature by which edges are shorter where the surface bends, up to four
        times. 0 for triangles of equal size.
    stretch : float
        Ratio of the sides of the triangles, the longer along the direction of least bending.
    spreading : int
        Rounds in which each site moves to the middle of its cell.
    relaxing : int
        Rounds in which edges are flipped and vertices move to the middle of their triangles.
    """

    grading: float = 0.0
    stretch: float = 1.0
    spreading: int = 3
    relaxing: int = 3


STYLES = {
    "graded": Style(grading=0.65),
    "even": Style(),
    "adaptive": Style(grading=1.0),
    "stretched": Style(grading=0.3, stretch=2.5, relaxing=0),
    "rough": Style(grading=0.3, spreading=0, relaxing=0),
}
"""Styles by name: 'graded' varies as the shapes of FAUST_r do, 'rough' is a careless sampling."""
