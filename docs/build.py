"""Hook of mkdocs: draws the pictures of the pages from shapes that ship with the package.

`python docs/build.py` draws the picture of the README, docs/match.png, which is committed.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from esd.datasets.bodies import bodies
from esd.descriptors.recipe import descriptors, single_recipe
from esd.evaluation.errors import true_map, vertex_errors
from esd.matching.match import match
from esd.mesh.mesh import Mesh
from esd.mesh.shapes import subdivide
from esd.spectral.cache import default_cache
from esd.viewing.colours import position_colours
from esd.viewing.figures import (
    blank_figure,
    curves_figure,
    draw_mesh,
    match_figure,
    save_figure,
    values_figure,
)
from esd.viewing.page import view

DOCS = Path(__file__).parent
PICTURES = DOCS / "pictures"


def on_pre_build(config: Any) -> None:
    """Draw the pictures unless they exist; `make clean` removes them."""
    PICTURES.mkdir(exist_ok=True)
    if (PICTURES / "page.html").exists():
        return
    collection = bodies()
    shapes = collection["s10_p01"], collection["s12_p05"]
    source, target = (shape.mesh() for shape in shapes)
    points = [shape.correspondence() for shape in shapes]
    truth = true_map(points[0], points[1], len(source.vertices))
    maps = {name: match(source, target, model=name) for name in ("default", "wks", "hks")}
    errors = {
        name: vertex_errors(target, found.target_index, truth) for name, found in maps.items()
    }
    known = {name: error[truth >= 0] for name, error in errors.items()}
    save_figure(match_figure(source, target, maps["default"]), PICTURES / "match.png")
    save_figure(curves_figure(known), PICTURES / "curves.png")
    wks = descriptors(single_recipe("wks"), source, cache=default_cache())
    shown = {
        "WKS, component 10": wks[:, 10],
        "WKS, component 50": wks[:, 50],
        "error / √area": np.minimum(errors["default"], 0.5),
    }
    save_figure(values_figure(source, shown), PICTURES / "values.png")
    page = view(
        source,
        target,
        maps["default"],
        error=errors["default"],
        source_name="s10_p01",
        target_name="s12_p05",
    )
    page.save(PICTURES / "page.html")


def draw_readme_picture() -> None:
    """Draw four bodies in the colours and the checkerboard of one, carried by maps."""
    collection = bodies()
    target = collection["s12_p05"].mesh()
    colours = position_colours(target)
    figure = blank_figure(10, 4.4)
    axes = figure.subplots()
    right = 0.0  # where the next body begins
    for name in ("s10_p08", "s11_p02", "s12_p05", "s13_p06"):
        mesh = collection[name].mesh()
        index = match(mesh, target).target_index if name != "s12_p05" else slice(None)
        mesh = Mesh(mesh.vertices + np.array([right, 0, 0]) - mesh.vertices.min(axis=0), mesh.faces)
        right = mesh.vertices[:, 0].max() + 0.12
        # the pattern is finer than the faces: each is divided, with what it carries
        fine, paint, place = (
            subdivide(subdivide(Mesh(values, mesh.faces))).vertices
            for values in (mesh.vertices, colours[index], target.vertices[index])
        )
        light = np.where(np.sin(np.pi * place / 0.1).prod(axis=1) < 0, 0.78, 1.18)
        faces = subdivide(subdivide(mesh)).faces
        draw_mesh(axes, Mesh(fine, faces), np.clip(paint * light[:, None], 0, 1), "z")
    figure.savefig(
        DOCS / "match.png",
        dpi=110,
        transparent=True,
        bbox_inches="tight",
        pil_kwargs={"optimize": True},
    )


if __name__ == "__main__":
    draw_readme_picture()
