"""A correspondence as one self-contained web page: both shapes, turned together, with their map."""

from __future__ import annotations

import base64
import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from string import Template
from typing import Any

from esd.common import FloatArray, InputError, whole_file
from esd.matching.correspondence import Correspondence
from esd.mesh.convert import MeshLike
from esd.viewing.scene import Scene, scene

MODULES = ("data.js", "colours.js", "shape.js", "viewer.js", "panel.js")
"""The viewer, as modules that import each other by the names `esd/…`."""


@dataclass(frozen=True, slots=True)
class Page:
    """A web page that needs neither a server nor a network; notebooks show it."""

    html: str

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the page.

        Raises
        ------
        InputError
            If the name does not end in .html, or the file cannot be written.
        """
        path = check_page_path(path)
        with whole_file(path) as temporary:
            temporary.write_text(self.html, encoding="utf-8")

    def __repr__(self) -> str:
        return f"<Page of {len(self.html) / 1e6:.1f} MB; save it, or show it in a notebook>"

    def _repr_html_(self) -> str:
        escaped = self.html.replace("&", "&amp;").replace('"', "&quot;")
        frame = 'style="width: 100%; height: 560px; border: 0"'
        return f'<iframe srcdoc="{escaped}" {frame}></iframe>'


def check_page_path(path: str | os.PathLike[str]) -> Path:
    """The path, if it ends in .html; raises an `InputError` otherwise."""
    path = Path(path)
    if path.suffix.lower() not in (".html", ".htm"):
        raise InputError(f"'{path}': the name of a page ends in .html.")
    return path


def view(
    source: MeshLike,
    target: MeshLike,
    match: Correspondence,
    *,
    error: FloatArray | None = None,
    source_name: str = "",
    target_name: str = "",
    model: str | None = None,
    up: str | None = None,
) -> Page:
    """A page on which both shapes turn together and every match can be looked at.

    The shapes are shown at equal area, the target turned rigidly onto the source by the map. The
    target has colours by position, the map transfers them to the source. The page also shows the
    verdict, confidence, error and stretch with their histograms, the worst places, lines between
    matched points, and the source on its way to its image on the target.

    Parameters
    ----------
    source, target
        Meshes, or whatever `as_mesh` takes.
    error : (n,), optional
        Geodesic error at each source vertex over √area of the target; NaN where unknown.
    source_name, target_name
        Shown above the shapes.
    model
        Name of the model that the map is by, shown among the figures.
    up
        The axis, one of `x`, `-x`, `y`, `-y`, `z` and `-z`, that points up; by default z where the
        source is longest along z, otherwise y.

    Raises
    ------
    InputError
        If the map or the errors do not fit the meshes, or the axis is another.
    """
    return page_of(
        scene(
            source,
            target,
            match,
            error=error,
            source_name=source_name,
            target_name=target_name,
            model=model,
            up=up,
        )
    )


def page_of(shown: Scene) -> Page:
    """The page that shows a scene."""
    names = (shown.meta["source"], shown.meta["target"])
    title = " → ".join(name for name in names if name) or "correspondence"
    body = Template(part("view.html")).substitute(
        stage=part("stage.html"), panel=part("panel.html")
    )
    return page_with(
        shown,
        title=title,
        style=part("viewer.css"),
        modules=MODULES,
        body=body,
        start=part("start.js"),
    )


def page_with(
    shown: Scene, *, title: str, style: str, modules: Sequence[str], body: str, start: str
) -> Page:
    """A page of one file that shows a scene.

    Parameters
    ----------
    title, style
        Text of the title, and the style sheet.
    modules
        Names of the scripts that the page imports.
    body
        What is on the page.
    start
        The script that draws the scene there.
    """
    meta, content = shown.packed()
    return Page(
        Template(part("page.html")).substitute(
            title=escaped(title),
            style=style,
            body=body,
            modules=_import_map(modules),
            meta=_as_script(meta),
            arrays=base64.b64encode(content).decode("ascii"),
            library=part("three.min.js"),
            start=start,
        )
    )


def _import_map(modules: Sequence[str]) -> str:
    """Where a page of one file has modules: each is named by its content."""
    sources = {f"esd/{name}": _as_address(part(name)) for name in modules}
    return json.dumps({"imports": sources})


def _as_script(meta: Mapping[str, Any]) -> str:
    """JSON that does not end the script element that it is in."""
    return json.dumps(meta, ensure_ascii=True).replace("<", "\\u003c")


def part(name: str) -> str:
    """The text of a file that the page is made of."""
    return (resources.files("esd.viewing") / "page" / name).read_text(encoding="utf-8")


def escaped(text: str) -> str:
    """The text, so that HTML shows it as it is."""
    return text.replace("&", "&amp;").replace("<", "&lt;").replace('"', "&quot;")


def _as_address(module: str) -> str:
    return "data:text/javascript;base64," + base64.b64encode(module.encode()).decode("ascii")
