"""What can be wrong with a mesh: what it does to results and what can be done about it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

Severity: TypeAlias = Literal["harmless", "slight", "serious"]

SMALL_HOLE = 1.0
"""Holes with a shorter rim, in units of √area, are filled; longer ones may be the shape's own."""

FEW_VERTICES = 300
"""The models' descriptors need as many connected vertices."""


@dataclass(frozen=True, slots=True)
class _Kind:
    """What is known of a kind of finding.

    `serious` is the share from which it is serious; where it is None, it never does harm.
    """

    one: str
    many: str
    serious: float | None
    effect: str
    remedy: str
    always: bool = False


_KINDS = {
    "non_finite_vertices": _Kind(
        "vertex with a coordinate that is no number",
        "vertices with a coordinate that is no number",
        0.01,
        "They have no place; nothing can be computed for them.",
        "left out with their faces",
        always=True,
    ),
    "missing_vertices": _Kind(
        "face that names a vertex which is not there",
        "faces that name vertices which are not there",
        0.0,
        "The file is damaged: matching refuses it.",
        "those faces are left out",
    ),
    "spikes": _Kind(
        "face longer than the rest of the shape",
        "faces longer than the rest of the shape",
        0.0,
        "A vertex far away, or a ground plane: it inflates the area, beside which every error "
        "looks small.",
        "left out",
        always=True,
    ),
    "extreme_coordinates": _Kind(
        "coordinate range that leaves no digits to compute with",
        "coordinate ranges that leave no digits to compute with",
        1.0,
        "Squares of lengths overflow or vanish; far from the origin, single precision has lost "
        "the shape.",
        "moved to the origin and scaled",
        always=True,
    ),
    "unreferenced_vertices": _Kind(
        "vertex without a face",
        "vertices without a face",
        None,
        "None on the others; they themselves get no match.",
        "left out",
        always=True,
    ),
    "duplicate_vertices": _Kind(
        "vertex doubled along a seam",
        "vertices doubled along seams",
        0.01,
        "The surface is torn there: heat does not pass, and descriptors change nearby.",
        "each is joined with the one at its place",
        always=True,
    ),
    "zero_length_edges": _Kind(
        "edge without length",
        "edges without length",
        0.0,
        "They have no stiffness: vertices are cut off, and the spectrum gets false zeros.",
        "collapsed",
        always=True,
    ),
    "collapsed_faces": _Kind(
        "face that names a vertex twice",
        "faces that name a vertex twice",
        None,
        "None: they have no area.",
        "left out",
        always=True,
    ),
    "duplicate_faces": _Kind(
        "face that is there twice",
        "faces that are there twice",
        0.01,
        "Their area and stiffness count twice.",
        "one of each is kept",
        always=True,
    ),
    "flat_meshes": _Kind(
        "mesh without area",
        "meshes without area",
        0.0,
        "All faces are points or lines: nothing can be computed.",
        "none is known",
    ),
    "slivers": _Kind(
        "degenerate (sliver) triangle",
        "degenerate (sliver) triangles",
        0.2,
        "Little: flat angles are made less flat, and gradients across slivers not counted.",
        "nothing is moved; the robust Laplacian sees none of them",
    ),
    "non_manifold_edges": _Kind(
        "non-manifold edge",
        "non-manifold edges",
        0.002,
        "Heat passes between sheets that only touch: a short cut, over which the descriptors of "
        "both change.",
        "the sheets are split there",
        always=True,
    ),
    "non_manifold_vertices": _Kind(
        "non-manifold vertex",
        "non-manifold vertices",
        0.002,
        "Heat passes through them between parts that only touch: a short cut, even where they "
        "are few.",
        "the vertex is split",
        always=True,
    ),
    "inconsistent_winding": _Kind(
        "edge with inconsistently oriented faces",
        "edges with inconsistently oriented faces",
        None,
        "None on HKS, WKS, GPS; normals, and all that tells left from right, go wrong.",
        "the minority of the faces is turned",
        always=True,
    ),
    "one_sided_pieces": _Kind(
        "non-orientable component, like a Möbius strip",
        "non-orientable components, like a Möbius strip",
        0.1,
        "It has no normals: nothing can tell left from right on it.",
        "none is known",
    ),
    "folded_edges": _Kind(
        "edge folded by more than a right angle",
        "edges folded by more than a right angle",
        0.15,
        "Noise folds a surface: its area and distances grow, and descriptors change; to match, it "
        "is smoothed unasked.",
        "smoothed",
    ),
    "inside_out_pieces": _Kind(
        "piece turned inside out",
        "pieces turned inside out",
        None,
        "None on HKS, WKS, GPS; what tells left from right takes it for its mirror image.",
        "its faces are turned",
        always=True,
    ),
    "holes": _Kind(
        "hole",
        "holes",
        0.5,
        "Descriptors change nearby, and what tells left from right everywhere; to match, those "
        "that can be are filled unasked. A large one may be where a part is missing.",
        f"filled where the rim is shorter than {SMALL_HOLE:g} √area",
    ),
    "ground_planes": _Kind(
        "flat piece that everything else lies on",
        "flat pieces that everything else lies on",
        0.0,
        "A ground or a table is no part of the shape, and often larger.",
        "left out",
        always=True,
    ),
    "loose_pieces": _Kind(
        "loose piece",
        "loose pieces",
        0.05,
        "Heat does not pass between them. The largest is matched, and vertices of others take the "
        "match of its nearest vertex if that is near; where that leaves out much, pieces that "
        "touch are matched together, by a closed surface around them.",
        "left out",
        always=True,
    ),
    "self_intersections": _Kind(
        "pair of faces that cut through each other",
        "pairs of faces that cut through each other",
        None,
        "None: only distances within the surface count.",
        "none is needed",
    ),
    "few_vertices": _Kind(
        "mesh of few connected vertices",
        "meshes of few connected vertices",
        0.0,
        f"The models need {FEW_VERTICES}; fewer cannot carry their descriptors.",
        "subdivide the mesh",
    ),
}


@dataclass(frozen=True, slots=True)
class Finding:
    """Something wrong with a mesh.

    Parameters
    ----------
    kind
        A name that does not change, such as `holes`.
    count
        How many there are.
    share
        How much of the mesh it concerns: a share of its vertices, faces, edges or area. For
        `holes` the length of the longest rim in units of √area.
    first
        The first vertex, face or, of edges, vertex concerned, from 0; None where there is no one.
    """

    kind: str
    count: int
    share: float
    first: int | None = None

    @property
    def what(self) -> str:
        """What it is, counted, in words."""
        kind = _KINDS[self.kind]
        return f"{self.count} {kind.one if self.count == 1 else kind.many}"

    @property
    def severity(self) -> Severity:
        """How bad it is for the result if nothing is done."""
        limit = _KINDS[self.kind].serious
        if limit is None:
            return "harmless"
        return "serious" if self.share >= limit else "slight"

    @property
    def effect(self) -> str:
        """What it does to the result."""
        return _KINDS[self.kind].effect

    @property
    def remedy(self) -> str:
        """What `repair` does about it."""
        return _KINDS[self.kind].remedy

    @property
    def always_repaired(self) -> bool:
        """Whether it is repaired unasked."""
        return _KINDS[self.kind].always


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """What is wrong with a mesh.

    Parameters
    ----------
    vertices, faces
        How many there are; no faces make a point cloud.
    size
        Diagonal of the bounding box, in units of length. It has no effect: shapes are scaled to
        unit area.
    findings
        What is wrong, in the order in which it is repaired.
    """

    vertices: int
    faces: int
    size: float
    findings: tuple[Finding, ...]

    @property
    def severity(self) -> Severity:
        """That of the worst finding."""
        found = {finding.severity for finding in self.findings}
        return "serious" if "serious" in found else "slight" if "slight" in found else "harmless"

    def in_a_line(self) -> str:
        """The findings in one line."""
        return ", ".join(finding.what for finding in self.findings) or "nothing wrong"
