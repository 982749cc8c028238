"""Feed the mesh readers and the doctor with files changed at random, guided by coverage.

Run by `make fuzz`. An input that ends in anything but a result or an InputError stops the run and
is written to the folder of `-artifact_prefix`. The arguments are those of libFuzzer.
"""

from __future__ import annotations

import logging
import sys
import tempfile
import warnings
from pathlib import Path

import atheris

with atheris.instrument_imports(include=["esd", "trimesh.exchange"]):
    import numpy as np

    from esd.common import InputError
    from esd.mesh.io.meshes import FORMATS, POINT_FORMATS, WRITTEN_FORMATS, read_arrays
    from esd.mesh.repair.repair import repair

_SUFFIXES = FORMATS + POINT_FORMATS
_MEMORY = Path("/dev/shm")
_FOLDER = Path(tempfile.mkdtemp(prefix="esd-fuzz-", dir=_MEMORY if _MEMORY.is_dir() else None))


def try_input(data: bytes) -> None:
    """Read bytes as the kind of file that the first of them chooses, and repair what is in it."""
    if not data:
        return
    path = _FOLDER / f"input{_SUFFIXES[data[0] % len(_SUFFIXES)]}"
    path.write_bytes(data[1:])
    try:
        arrays = read_arrays(path)
        repaired = repair(arrays, everything=data[0] >= 128, restore=data[0] % 2 == 1)
    except InputError:
        return
    assert len(repaired.vertex_index) == len(arrays[0])
    assert np.isfinite(repaired.shape.vertices).all()


def _seeds(folder: Path) -> None:
    """Whole files of each kind to start from."""
    sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
    from esd.mesh.io.meshes import write_mesh
    from esd.mesh.shapes import icosphere
    from hostile_files import HOSTILE

    for number, suffix in enumerate(_SUFFIXES):
        if suffix in WRITTEN_FORMATS:
            write_mesh(icosphere(0), _FOLDER / f"seed{suffix}")
            content = (_FOLDER / f"seed{suffix}").read_bytes()
            (folder / f"whole{number}").write_bytes(bytes([number]) + content)
    for name, content in HOSTILE.items():
        if len(content) < 5000:
            number = _SUFFIXES.index(Path(name).suffix)
            (folder / name).write_bytes(bytes([number]) + content)


if __name__ == "__main__":
    logging.disable()
    warnings.simplefilter("ignore")
    corpus = Path(tempfile.mkdtemp(prefix="esd-corpus-"))
    _seeds(corpus)
    atheris.Setup([*sys.argv, str(corpus)], try_input)
    atheris.Fuzz()
