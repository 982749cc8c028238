"""Feed whatever esd reads with files changed at random, guided by coverage.

Run by `make fuzz`. The first byte of an input chooses the kind of file. An input that ends in
anything but a result or an InputError is written to the folder `fuzz`, once for each place in the
code where that happens, and the run continues; its exit code is 1 if there was any. The arguments
are those of libFuzzer, such as `-seed=1 -max_total_time=1800`; after `--only`, words name the
groups or kinds that are tried: `python tools/fuzz.py -seed=1 --only maps cache`.
"""

from __future__ import annotations

import atexit
import gzip
import logging
import os
import re
import signal
import sys
import tempfile
import traceback
import warnings
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import atheris

with atheris.instrument_imports(
    include=["esd", "trimesh.exchange", "meshio", "nibabel"],
    exclude=["esd.cli", "esd.learning.train", "esd.spectral.eigensolver"],
):
    import h5py
    import numpy as np

    from esd.common import InputError
    from esd.datasets.dyna import dyna_collection
    from esd.datasets.folder import folder_collection
    from esd.datasets.store import StoredShape, open_store, save_store
    from esd.descriptors.recipe import single_recipe
    from esd.learning.model import Layer, Model, load_model, save_model
    from esd.matching.batch import read_pairs_of_files
    from esd.matching.correspondence import MAP_SUFFIXES, Correspondence, load_map, save_map
    from esd.matching.landmarks import read_landmark_pairs
    from esd.mesh.io.attributes import read_vertex_colours, write_with_attributes
    from esd.mesh.io.fields import read_labels, read_values
    from esd.mesh.io.landmarks import (
        LANDMARK_FORMATS,
        Landmarks,
        read_landmarks,
        write_landmarks,
    )
    from esd.mesh.io.meshes import (
        FORMATS,
        POINT_FORMATS,
        WRITTEN_FORMATS,
        read_arrays,
        write_mesh,
    )
    from esd.mesh.io.textures import read_texture
    from esd.mesh.repair.repair import repair
    from esd.mesh.shapes import icosphere
    from esd.spectral.cache import Cache

_MEMORY = Path("/dev/shm")
_FOLDER = Path(tempfile.mkdtemp(prefix="esd-fuzz-", dir=_MEMORY if _MEMORY.is_dir() else None))
_KEPT = Path("fuzz")
_LONGEST = 12_000  # bytes of a file to start from, as `make fuzz` limits all
_MESH = icosphere(0)
_MAP = Correspondence(np.array([2, 0, -1, 1]), np.array([0.5, 0.25, np.inf, 1]), np.ones(4))


class Kind(NamedTuple):
    """A kind of file: its name, what reads it, and whole ones to start from."""

    name: str
    group: str
    read: Callable[[Path], object]
    seeds: tuple[bytes, ...]


def _repaired(path: Path) -> None:
    arrays = read_arrays(path)
    repaired = repair(arrays, everything=len(arrays[0]) % 2 == 1, restore=len(arrays[1]) % 2 == 1)
    assert len(repaired.vertex_index) == len(arrays[0])
    assert np.isfinite(repaired.shape.vertices).all()


def _mapped(path: Path) -> None:
    found = load_map(path)
    assert found.target_index.min() >= -1
    assert len(found.target_index) == len(found.confidence) == len(found.distance)


def _landmarks(path: Path) -> None:
    found = read_landmarks(path, _MESH)
    assert len(found.names) == len(found.vertices)
    assert -1 <= found.vertices.min() <= found.vertices.max() < len(_MESH.vertices)


def _entry(path: Path) -> None:
    content = path.read_bytes()
    found = Cache(_FOLDER, 10**9).load(path.stem)
    # a damaged entry is removed, and never believed
    assert (found is None) != path.exists()
    if found is not None:
        assert content.startswith(b"PK")
        assert {name: array.tolist() for name, array in found.items()} == {"a": [0, 1, 2]}


def _model(path: Path) -> None:
    (_MODEL / "config.json").write_bytes(path.read_bytes())
    model = load_model(_MODEL)
    assert np.isfinite(model.mean).all()


def _subjects(path: Path) -> None:
    (_SET / "subjects.csv").write_bytes(path.read_bytes())
    folder_collection(_SET)


def _correspondence(path: Path) -> None:
    (_SET / "corres" / "a.vts").write_bytes(path.read_bytes())
    for shape in folder_collection(_SET).shapes:
        shape.correspondence()


def _in_a_child(read: Callable[[Path], object], whole: bytes, path: Path) -> None:
    """Read a whole file with some bytes changed in a process of its own.

    The HDF5 library itself crashes on some damaged files, which is counted. What Python raises is a
    failure. Coverage does not reach here, so that the input says which bytes are changed: two bytes
    where, and one by which.
    """
    edits, changed = path.read_bytes(), bytearray(whole)
    for i in range(0, len(edits) - 2, 3):
        changed[int.from_bytes(edits[i : i + 2], "little") % len(changed)] ^= edits[i + 2]
    path.write_bytes(changed)
    ours, theirs = os.pipe()
    child = os.fork()
    if child == 0:
        signal.alarm(8)  # in some damaged files the library goes round in circles
        try:
            read(path)
        except InputError:
            pass
        except BaseException:
            os.write(theirs, traceback.format_exc().encode()[-4000:])
        os._exit(0)
    os.close(theirs)
    with os.fdopen(ours, "rb") as pipe:
        said = pipe.read().decode(errors="replace")
    _, status = os.waitpid(child, 0)
    if os.WIFSIGNALED(status):
        CRASHES.append(os.WTERMSIG(status))
    if said:
        raise RuntimeError(said)


def _frames(path: Path) -> None:
    for shape in dyna_collection(path).shapes[:3]:
        mesh = shape.mesh()
        assert len(shape.correspondence()) == len(mesh.vertices)


def _store(path: Path) -> None:
    for shape in open_store(path).shapes():
        values, index = shape.read()
        assert index.max(initial=-1) < max(len(values), 1)


def _material(path: Path) -> None:
    (_FOLDER / "m.mtl").write_bytes(path.read_bytes())
    (_FOLDER / "m.obj").write_text(
        "mtllib m.mtl\nusemtl a\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nf 1/1 2/1 3/1\n"
    )
    read_texture(_FOLDER / "m.obj")


def _kinds() -> list[Kind]:
    kinds = []
    for suffix in (*FORMATS, *POINT_FORMATS):
        whole = []
        if suffix in WRITTEN_FORMATS:
            write_mesh(_MESH, _FOLDER / f"seed{suffix}")
            whole.append((_FOLDER / f"seed{suffix}").read_bytes())
        whole += [content for name, content in HOSTILE.items() if Path(name).suffix == suffix]
        whole += _WRITTEN_BY_OTHERS.get(suffix, [])
        kinds.append(Kind(f"m{suffix}", "meshes", _repaired, tuple(whole)))
    write_mesh(_MESH, _FOLDER / "seed.ply")
    packed = gzip.compress((_FOLDER / "seed.ply").read_bytes())
    kinds.append(Kind("m.ply.gz", "meshes", _repaired, (packed,)))
    for suffix in MAP_SUFFIXES:
        save_map(_MAP, _FOLDER / f"seed{suffix}")
        kinds.append(
            Kind(f"p{suffix}", "maps", _mapped, ((_FOLDER / f"seed{suffix}").read_bytes(),))
        )
    for suffix in LANDMARK_FORMATS:
        marks = Landmarks(("a", "b b", "c"), np.array([0, -1, 5]))
        write_landmarks(marks, _MESH, _FOLDER / f"seed{suffix}")
        content = (_FOLDER / f"seed{suffix}").read_bytes()
        kinds.append(Kind(f"l{suffix}", "landmarks", _landmarks, (content,)))
    Cache(_FOLDER, 10**9).store("seed", {"a": np.arange(3)})
    kinds.append(Kind("e.npz", "cache", _entry, ((_FOLDER / "seed.npz").read_bytes(),)))
    config = (_MODEL / "config.json").read_bytes()
    array = (_FOLDER / "seed.npy").read_bytes()
    kinds += [
        Kind("c.json", "models", _model, (config,)),
        Kind("f.txt", "fields", read_labels, (b"1\n2\n-1\n", b"arm\nleg\narm\n")),
        Kind("f.csv", "fields", read_values, (b"1,2\n3,4\nnan,1e3\n",)),
        Kind("f.npy", "fields", read_values, (array,)),
        Kind("n.npy", "fields", read_labels, (array,)),
        Kind(
            "q.csv", "pairs", read_pairs_of_files, (b"source,target,output\na.off,b.off,c.csv\n",)
        ),
        Kind("r.csv", "pairs", read_landmark_pairs, (b"source,target,name\n1,2,nose\n3,4,ear\n",)),
        Kind("s.csv", "folders", _subjects, (b"name,subject,template\na,x,t\nb,y,t\n",)),
        Kind("d.hdf5", "hdf5", partial(_in_a_child, _frames, _recording()), (b"\0\0\0",)),
        Kind("d.h5", "hdf5", partial(_in_a_child, _store, _stored()), (b"\0\0\0",)),
        Kind("v.vts", "folders", _correspondence, (b"1\n2\n0\n3\n",)),
        Kind("t.mtl", "textures", _material, (b"newmtl a\nmap_Kd -s 1 1 1 a.png\nKd 1 1 1\n",)),
        Kind("t.glb", "textures", read_texture, ((_FOLDER / "seed.glb").read_bytes(),)),
        Kind("v.ply", "textures", read_vertex_colours, ((_FOLDER / "seed.ply").read_bytes(),)),
    ]
    return kinds


def _recording() -> bytes:
    """A file of the layout of Dyna: one sequence of two frames."""
    path = _FOLDER / "seed.hdf5"
    with h5py.File(path, "w") as file:
        file["faces"] = _MESH.faces.astype("u2")
        file["50002_hips"] = np.stack([_MESH.vertices, _MESH.vertices], axis=2).astype("f4")
        file["50002_hips"].attrs["frames"] = [3, 9]
    return path.read_bytes()


def _stored() -> bytes:
    """A store of the descriptors of two shapes."""
    recipe = single_recipe("gps")
    shape = StoredShape(
        "a", "x", "t", "k", 2, 3, lambda: (np.ones((2, recipe.width), "f4"), np.array([0, 1, -1]))
    )
    shapes = [shape, replace(shape, name="b")]
    path = _FOLDER / "seed.h5"
    save_store(path, shapes, collection=folder_collection(_SET), recipe=recipe, remeshings=0)
    return path.read_bytes()


def _legacy_vtk(*, is_text: bool) -> bytes:
    """A legacy file of VTK with the data set POLYDATA, of version 5 if it is binary."""
    count, faces = len(_MESH.vertices), len(_MESH.faces)
    head = f"title\n{'ASCII' if is_text else 'BINARY'}\nDATASET POLYDATA\nPOINTS {count} double\n"
    if is_text:
        points = " ".join(map(str, _MESH.vertices.ravel()))
        cells = "\n".join(f"3 {a} {b} {c}" for a, b, c in _MESH.faces)
        body = f"{points}\nPOLYGONS {faces} {4 * faces}\n{cells}\n"
        return f"# vtk DataFile Version 3.0\n{head}{body}".encode()
    return b"".join(
        [
            f"# vtk DataFile Version 5.1\n{head}".encode(),
            _MESH.vertices.astype(">f8").tobytes(),
            f"\nPOLYGONS {faces + 1} {3 * faces}\nOFFSETS vtktypeint64\n".encode(),
            (3 * np.arange(faces + 1)).astype(">i8").tobytes(),
            b"\nCONNECTIVITY vtktypeint64\n",
            _MESH.faces.astype(">i8").tobytes(),
        ]
    )


def _by_others() -> dict[str, list[bytes]]:
    """Whole files of the formats that other packages write, where they are installed."""
    found: dict[str, list[bytes]] = {
        ".pcd": [
            b"VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 2\nHEIGHT 1\n"
            b"POINTS 2\nDATA ascii\n1 2 3\n4 5 6\n"
        ],
        ".vtk": [_legacy_vtk(is_text=True), _legacy_vtk(is_text=False)],
        ".xyz": [b"0 0 0\n1 0 0\n0 1 0\n0 0 1\n"],
    }
    write_with_attributes(_MESH, {"a": np.zeros(len(_MESH.vertices))}, _FOLDER / "seed.vtp")
    found[".vtp"] = [(_FOLDER / "seed.vtp").read_bytes()]
    try:
        import meshio
        import nibabel
    except ImportError:
        return found
    cells = [("triangle", _MESH.faces)]
    for suffix, options in {".vtk": {}, ".vtu": {}, ".msh": {"file_format": "gmsh"}}.items():
        for binary in (False, True):
            path = _FOLDER / f"seed{suffix}"
            meshio.Mesh(_MESH.vertices, cells).write(path, binary=binary, **options)
            found.setdefault(suffix, []).append(path.read_bytes())
    nibabel.freesurfer.write_geometry(str(_FOLDER / "seed.pial"), _MESH.vertices, _MESH.faces)
    found[".pial"] = [(_FOLDER / "seed.pial").read_bytes()]
    arrays = [
        nibabel.gifti.GiftiDataArray(_MESH.vertices.astype("f4"), intent="NIFTI_INTENT_POINTSET"),
        nibabel.gifti.GiftiDataArray(_MESH.faces.astype("i4"), intent="NIFTI_INTENT_TRIANGLE"),
    ]
    nibabel.save(nibabel.gifti.GiftiImage(darrays=arrays), _FOLDER / "seed.gii")
    found[".gii"] = [(_FOLDER / "seed.gii").read_bytes()]
    return found


def _small_model() -> Model:
    """A model of one layer, whose configuration is as rich as that of a trained one."""
    recipe = single_recipe("hks")
    layer = Layer(np.ones((4, recipe.width), np.float32), np.ones(4, np.float32))
    return Model(
        "small",
        recipe,
        np.zeros(recipe.width),
        np.ones(recipe.width),
        (layer,),
        margin=5.0,
        limit=3.0,
        unit_length=True,
        card={"preset": "small"},
    )


def try_input(data: bytes) -> None:
    """Read bytes as the kind of file that the first of them chooses."""
    if not data:
        return
    kind = KINDS[data[0] % len(KINDS)]
    path = _FOLDER / kind.name
    path.write_bytes(data[1:])
    try:
        kind.read(path)
    except InputError:
        return
    except Exception as error:
        _report(kind, error, data)


def _report(kind: Kind, error: Exception, data: bytes) -> None:
    """Show a failure and keep its input, unless it happened at the same place before."""
    last = traceback.extract_tb(error.__traceback__)[-1]
    place = f"{kind.name}-{type(error).__name__}-{Path(last.filename).stem}-{last.lineno}"
    if isinstance(error, RuntimeError) and kind.group == "hdf5":  # of the child: its last place
        place = f"{kind.name}-{'-'.join(re.findall(r'line ([0-9]+)', str(error))[-1:])}"
    if place in FAILURES:
        return
    FAILURES.add(place)
    _KEPT.mkdir(exist_ok=True)
    (_KEPT / place).write_bytes(data[1:])
    print(f"\n{place}: kept in {_KEPT / place}", file=sys.stderr)
    traceback.print_exception(error)


def _start(arguments: list[str]) -> None:
    corpus = Path(tempfile.mkdtemp(prefix="esd-corpus-"))
    for number, kind in enumerate(KINDS):
        for place, content in enumerate(kind.seeds):
            if len(content) < _LONGEST:
                (corpus / f"{number}-{place}").write_bytes(bytes([number]) + content)
    atheris.Setup([*arguments, str(corpus)], try_input)
    atheris.Fuzz()  # ends the process


if __name__ == "__main__":
    logging.disable()
    warnings.simplefilter("ignore")
    sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
    from hostile_files import HOSTILE

    _MODEL, _SET = _FOLDER / "model", _FOLDER / "set"
    save_model(_small_model(), _MODEL)
    (_SET / "corres").mkdir(parents=True)
    for name in "ab":
        write_mesh(_MESH, _SET / f"{name}.off")
        (_SET / "corres" / f"{name}.vts").write_text("1\n2\n3\n4\n")
    _WRITTEN_BY_OTHERS = _by_others()
    wanted = []
    if "--only" in sys.argv:
        at = sys.argv.index("--only")
        wanted = sys.argv[at + 1 :]
        del sys.argv[at:]
    KINDS = [kind for kind in _kinds() if not wanted or {kind.group, kind.name} & set(wanted)]
    FAILURES: set[str] = set()
    CRASHES: list[int] = []
    atexit.register(lambda: os._exit(1) if FAILURES else None)
    atexit.register(lambda: print(f"{len(CRASHES)} crashes of the HDF5 library", file=sys.stderr))
    _start(sys.argv)
