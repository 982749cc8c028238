"""Bad input to every command: the right exit code, one clear line, no file written or changed."""

import hashlib
import json
import logging
import os
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest

from esd.cli import main
from esd.matching.correspondence import Correspondence, save_map
from esd.mesh.io.meshes import write_mesh
from esd.mesh.mesh import Mesh
from esd.mesh.shapes import icosphere, torus
from hostile_files import HOSTILE

HEAD = "source,target,distance,confidence\n"
COMMON = ("a.off", "b.off", "map.csv")
TRIANGLE = "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 "


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """Good and bad inputs; nothing is ever written here but to `out`."""
    where = tmp_path_factory.mktemp("bad")
    make_inputs(where)
    return where


def make_inputs(where: Path) -> None:
    """Write good and bad inputs to a folder; `tools/list_bad_input.py` does, too."""
    mesh = torus(12, 8)
    for name in ("a.off", "b.off", "a.ply", "a.obj"):
        write_mesh(mesh, where / name)
    (where / "set").mkdir()
    for i in range(2):
        write_mesh(Mesh(mesh.vertices * (1 + 0.1 * i), mesh.faces), where / "set" / f"x{i}.off")
    count = len(mesh.vertices)
    save_map(Correspondence(np.arange(count), np.zeros(count), np.ones(count)), where / "map.csv")
    save_map(Correspondence(np.arange(5), np.zeros(5), np.ones(5)), where / "short.csv")
    write_mesh(icosphere(1), where / "small.off")
    np.savetxt(where / "points.xyz", mesh.vertices)
    np.save(where / "words.npy", np.array(["one"] * count))
    np.save(where / "cube.npy", np.zeros((2, 2, 2)))
    with h5py.File(where / "other.h5", "w") as file:
        file["x"] = np.zeros(3)
    rows = "".join(f"{i},{i},0,1\n" for i in range(count - 1))
    texts = {
        "empty.off": "",
        "word.off": "OFF\nmany 1 0\n",
        "nan.off": "OFF\n96 1 0\n" + "nan nan nan\n" * 96 + "3 0 1 2\n",
        "beyond.off": "OFF\n96 1 0\n" + "0 0 0\n" * 96 + "3 0 1 500\n",
        "line.off": "OFF\n96 1 0\n" + "".join(f"{i} 0 0\n" for i in range(96)) + "3 0 1 2\n",
        "words.gltf": '{"meshes": "x", "nodes": ["a"], "buffers": ["x"]}',
        "tiny.off": TRIANGLE + "2\n",
        "page.obj": "<html></html>",
        "two.xyz": "0 0 0\n1 1 1\n",
        "holes.xyz": "nan nan nan\n" * 96,
        "mesh.abc": "x",
        "twice.csv": HEAD + rows + "0,0,0,1\n",
        "gap.csv": HEAD + rows + f"{count},0,0,1\n",
        "negative.csv": HEAD + rows + f"{count - 1},-5000,0,1\n",
        "beyond.csv": HEAD + rows + f"{count - 1},6000,0,1\n",
        "cut.csv": HEAD + rows + f"{count - 1},1",
        "text.csv": HEAD + rows + f"{count - 1},one,0,1\n",
        "columns.csv": "a,b\n1,2\n",
        "empty.csv": "",
        "none.csv": "source,target\n" + "".join(f"{i},-1\n" for i in range(count)),
        "sure.csv": HEAD + "".join(f"{i},{i},0,7\n" for i in range(count)),
        "near.csv": HEAD + "".join(f"{i},{i},-1,1\n" for i in range(count)),
        "decimal.csv": "source,target\n" + "".join(f"{i},{i}.0\n" for i in range(count)),
        "hex.off": "OFF\n3 1 0\n0x10 0 0\n1 0 0\n0 1 0\n3 0 1 2\n",
        "fortran.off": "OFF\n3 1 0\n1D+00 0 0\n1 0 0\n0 1 0\n3 0 1 2\n",
        "decimal.off": TRIANGLE.replace("3 0 1 ", "3 0.0 1.0 2.0\n"),
        "four.off": "4OFF\n3 1 0\n0 0 0 1\n1 0 0 1\n0 1 0 1\n3 0 1 2\n",
        "binary.off": "OFF BINARY\n\0\0\0\3",
        "edge.off": "OFF\n2 1 0\n0 0 0\n1 0 0\n2 0 1\n",
        "comma.obj": "v 1,5 0,0 0,0\nv 0 1 0\nv 1 0 0\nf 1 2 3\n",
        "off.stl": TRIANGLE + "2\n",
        "off.ply": TRIANGLE + "2\n",
        "ply.obj": "ply\nformat ascii 1.0\nelement vertex 0\nend_header\n",
        "words.xyz": "one two three\nfour five six\n",
        "plane.xyz": "0 0\n1 1\n2 2\n",
        "word.txt": "one\n" * 96,
        "short.txt": "1\n2\n",
        "float.txt": "1.5\n" * 96,
        "uneven.txt": "1 2\n3\n",
        "landmarks.csv": "name,vertex\nnose,9999\n",
        "landmark-words.csv": "name,vertex\nnose,tip\n",
        "pairs.csv": "source,target\na.off,b.off\n",
        "pairs-gap.csv": "source,target\na.off,\n",
        "pairs-twice.csv": "source,target\na.off,b.off\na.off,b.off\n",
        "pairs-over.csv": "source,target,output\na.off,b.off,map.csv\n",
        "pairs-suffix.csv": "source,target,output\na.off,b.off,m.doc\n",
        "pairs-none.csv": "source,target\n",
        "pairs-self.csv": "source,target,output\na.off,b.off,pairs-self.csv\n",
        "unknown.tsv": "x0\tx9\n",
        "one.tsv": "x0\n",
        "a.vts": "1\n2\n",
        "b.vts": "1\n2\n3\n",
        "zero.vts": "-1\n-1\n",
    }
    for name, text in texts.items():
        (where / name).write_text(text)
    for name in ("odd.csv", "odd.txt", "odd.npy", "odd.tsv", "odd.vts", "odd.off", "odd.h5"):
        (where / name).write_bytes(b"\xff\xfe\x00\x93\x81odd\n")
    for name, config in {
        "list": "[]",
        "word": '"model"',
        "old": '{"format": 0}',
        "bare": '{"format": 1}',
        "cut": '{"format": 1, ',
        "layers": json.dumps({"format": 1, "recipe": {}, "layers": []}),
    }.items():
        (where / "models" / name).mkdir(parents=True)
        (where / "models" / name / "config.json").write_text(config)
    for name in ("wide.off", "wide.obj", "wide.csv"):
        (where / name).write_bytes((TRIANGLE + "2\n").encode("utf-16"))
    np.save(where / "decimal.npy", np.arange(count) * 1.0)
    np.save(where / "huge.npy", np.full(count, 2**40))
    np.save(where / "objects.npy", np.array([None] * count), allow_pickle=True)
    (where / "models" / "none").mkdir()
    (where / "shapeless").mkdir()
    (where / "shapeless" / "note.txt").touch()
    (where / "mixed").mkdir()
    write_mesh(mesh, where / "mixed" / "a.off")
    write_mesh(icosphere(2), where / "mixed" / "b.off")
    (where / "lost" / "shapes").mkdir(parents=True)
    (where / "lost" / "corres").mkdir()
    write_mesh(mesh, where / "lost" / "shapes" / "a.off")
    (where / "out").mkdir()


BAD_MESHES = (
    ("missing.off", "There is no file"),
    ("empty.off", "empty.off"),
    ("word.off", "word.off"),
    ("nan.off", "nan.off"),
    ("beyond.off", "beyond.off"),
    ("line.off", "line.off"),
    ("page.obj", "page.obj"),
    ("mesh.abc", "expected one of"),
    ("odd.off", "odd.off"),
    ("set", "is a folder; expected a file"),
    ("holes.xyz", "holes.xyz"),
)
BAD_MAPS = (
    ("missing.csv", "There is no file"),
    ("short.csv", "maps 5 vertices; the source mesh has 96"),
    ("twice.csv", "source vertex 0 has two lines"),
    ("gap.csv", "source vertex 95 has no line"),
    ("negative.csv", "-5000"),
    ("beyond.csv", "names target vertex 6000"),
    ("cut.csv", "no line break"),
    ("text.csv", "line 97"),
    ("columns.csv", "expected the columns source,target"),
    ("empty.csv", "it is empty"),
    ("odd.csv", "odd.csv"),
    ("odd.txt", "odd.txt"),
    ("odd.npy", "odd.npy"),
    ("word.txt", "word.txt"),
    ("cube.npy", "expected integers of shape (n,)"),
    ("map.doc", "a map's file ends in"),
)
CASES: list[tuple[tuple[str, ...], int, str]] = [
    *(
        (command, 1, said)
        for mesh, said in BAD_MESHES
        for command in (
            ("match", mesh, "b.off", "-m", "hks", "-o", "out/m.csv"),
            ("match", "a.off", mesh, "-m", "hks", "-o", "out/m.csv"),
            ("spectrum", mesh, "-k", "5", "-o", "out/s.npz"),
            ("descriptor", mesh, "-o", "out/d.npy"),
            ("view", mesh, "b.off", "map.csv", "-o", "out/v.html"),
            ("transfer", "a.off", mesh, "map.csv", "--morph", "3", "-o", "out/morph"),
        )
    ),
    *(
        (command, 1, said)
        for file, said in BAD_MAPS
        for command in (
            ("view", "a.off", "b.off", file, "-o", "out/v.html"),
            ("transfer", "a.off", "b.off", file, "--labels", "word.txt", "-o", "out/l.txt"),
            ("export", "a.off", "b.off", file, "-o", "out/m.npy"),
        )
    ),
    (("doctor", "missing.off"), 1, "There is no file 'missing.off'"),
    (("doctor", "empty.off"), 1, "empty.off"),
    (("doctor", "words.gltf"), 1, "it is damaged, or of another format"),
    (("doctor", "a.off", "--repair", "out/r.doc"), 1, "expected a suffix among"),
    (("doctor", "points.xyz", "--repair", "out/r.ply"), 1, "cannot be written as a mesh"),
    (("doctor", "nan.off", "--repair", "out/r.ply"), 1, "nan.off"),
    *(
        (("doctor", name), 1, said)
        for name, said in (
            ("wide.off", "is text in UTF-16; save it in UTF-8"),
            ("wide.obj", "is text in UTF-16; save it in UTF-8"),
            ("hex.off", "expected a number; got '0x10'"),
            ("fortran.off", "expected a number; got '1D+00'"),
            ("decimal.off", "expected a whole number; got '0.0'"),
            ("four.off", "does not begin with OFF"),
            ("binary.off", "it is binary OFF"),
            ("edge.off", "there are no faces in it"),
            ("comma.obj", "expected a number; got '1,5'"),
            ("off.stl", "it is no STL file"),
            ("off.ply", "does not begin with `ply`"),
            ("ply.obj", "there are no vertices in it"),
            ("words.xyz", "words.xyz"),
            ("plane.xyz", "line 1 has only 2 columns"),
        )
    ),
    *(
        (("export", "a.off", "b.off", name, "-o", "out/m.npy"), 1, said)
        for name, said in (
            ("sure.csv", "line 2: expected a number from 0 to 1; got '7'"),
            ("near.csv", "line 2: expected a number from 0 to inf; got '-1'"),
            ("decimal.csv", "line 2: expected a whole number; got '0.0'"),
            ("wide.csv", "byte 1 of it is no text in UTF-8"),
            ("decimal.npy", "expected integers of shape (n,), got float64"),
            ("huge.npy", "names target vertex 1099511627776"),
            ("objects.npy", "Python objects"),
        )
    ),
    (("view", "a.off", "b.off", "none.csv", "-o", "out/v.html"), 1, "'none.csv' has no match"),
    (
        ("transfer", "a.off", "b.off", "none.csv", "--labels", "word.txt", "-o", "out/l.txt"),
        1,
        "'none.csv' has no match",
    ),
    (("match", "a.off", "b.off", "--candidates", "abc"), 2, "Candidates are embedding"),
    (("match", "a.off", "b.off", "--candidates", ","), 2, "got none"),
    (("batch", "pairs.csv", "--candidates", "abc"), 2, "Candidates are embedding"),
    (("match", "a.off", "b.off", "-m", "hks", "--adapt", "-o", "out/m.csv"), 1, "cannot learn"),
    (("match", "a.off", "b.off", "-m", "", "-o", "out/m.csv"), 1, "There is no model ''"),
    (("match", "a.off", "b.off", "-o", "/proc/m.csv"), 1, "cannot be written"),
    (("register", "a.off", "missing.off", "-o", "out/r.ply"), 1, "There is no file"),
    (("register", "a.off", "b.off", "-o", "out/r.doc"), 1, "expected a suffix among"),
    (("register", "a.off", "b.off", "-o", "a.off", "--force"), 1, "is read by this command"),
    (("atlas", "missing", "-o", "out/a"), 1, "There is no data set 'missing'"),
    (("atlas", "shapeless", "-o", "out/a"), 1, "There is no mesh in"),
    (("atlas", "set", "-o", "set", "--force"), 1, "lie one in the other"),
    (("studio", "missing.off", "--no-browser"), 1, "There is no file 'missing.off'"),
    (("studio", "--port", "99999"), 2, "--port"),
    (("evaluate", "set", "-m", "hks", "--rotate", "x"), 2, "--rotate"),
    (("train", "set", "--steps", "1e3"), 2, "--steps"),
    (("cache", "now"), 2, "now"),
    (("data", "list", "set"), 1, "There is no sequence of Dyna or D-FAUST"),
    (("match", "small.off", "a.off", "-m", "hks", "-o", "out/m.csv"), 1, "small.off"),
    (("match", "a.off", "b.off", "-m", "no-model", "-o", "out/m.csv"), 1, "no-model"),
    (("match", "a.off", "b.off", "-o", "out/m.doc"), 1, "a map's file ends in"),
    (
        ("match", "a.off", "b.off", "-m", "hks", "--reject", "-o", "out/m.csv"),
        1,
        "--min-confidence",
    ),
    (("match", "a.off", "b.off", "--min-confidence", "2"), 2, "--min-confidence"),
    (("match", "a.off", "b.off", "--coarse", "10"), 2, "--coarse"),
    (("match", "a.off", "b.off", "--coarse", "400", "--one-to-one"), 2, "not both"),
    (("match", "a.off", "b.off", "--coarse", "400", "--full"), 2, "not both"),
    (("match", "a.off", "b.off", "--mirror", "maybe"), 2, "--mirror"),
    (("match", "a.off", "b.off", "--device", "abacus", "-o", "out/m.csv"), 1, "abacus"),
    (("match", "a.off", "b.off", "-o", "a.off/m.csv"), 1, "is a file, not a folder"),
    (("match", "a.off"), 2, "TARGET"),
    (("match", "a.off", "b.off", "c.off"), 2, "c.off"),
    *(
        (
            ("match", "a.off", "b.off", "-m", f"models/{name}", "-o", "out/m.csv"),
            1,
            f"models/{name}",
        )
        for name in ("list", "word", "old", "bare", "cut", "layers", "none")
    ),
    (
        ("match", "a.off", "b.off", "--landmarks", "missing.csv", "-o", "out/m.csv"),
        1,
        "missing.csv",
    ),
    (("batch", "missing.csv", "-o", "out"), 1, "There is no file 'missing.csv'"),
    (("batch", "columns.csv", "-o", "out"), 1, "must have the columns source,target"),
    (("batch", "odd.csv", "-o", "out"), 1, "odd.csv"),
    (("batch", "pairs-gap.csv", "-o", "out"), 1, "pair 1: a source and a target are needed"),
    (("batch", "pairs-twice.csv", "-o", "out"), 1, "several maps to"),
    (("batch", "pairs-over.csv", "-o", "out"), 1, "--force"),
    (("batch", "pairs-suffix.csv", "-o", "out"), 1, "a map's file ends in"),
    (("batch", "pairs-none.csv", "-o", "out"), 1, "lists no pair"),
    (("batch", "pairs-self.csv", "-o", "out", "--force"), 1, "is read by this command"),
    (("batch", "pairs.csv", "-o", "out", "-m", "hks", "--reject"), 1, "--min-confidence"),
    (("batch", "pairs.csv", "-o", "out", "--workers", "0"), 2, "--workers"),
    (("batch", "pairs.csv", "--workers", "2", "--scheduler", "tcp://a:1"), 2, "not both"),
    (("batch", "pairs.csv", "--scheduler", "http://a:8787"), 1, "not the address of a Dask"),
    (("batch", "pairs.csv", "--scheduler", "nonsense"), 1, "not the address of a Dask"),
    (("batch", "pairs.csv", "--patience", "0"), 2, "--patience"),
    (("view", *COMMON, "-o", "out/v.doc"), 1, "ends in .html"),
    (("view", *COMMON, "--up", "w", "-o", "out/v.html"), 2, "--up"),
    (("view", *COMMON, "--truth", "short.csv", "-o", "out/v.html"), 1, "maps 5 vertices"),
    (("view", *COMMON, "--points", "a.vts", "b.vts", "-o", "out/v.html"), 1, "same points"),
    (("view", *COMMON, "--points", "odd.vts", "b.vts", "-o", "out/v.html"), 1, "odd.vts"),
    (("view", *COMMON, "--points", "zero.vts", "b.vts", "-o", "out/v.html"), 1, "zero.vts"),
    (("view", *COMMON, "--truth", "map.csv", "--points", "a.vts", "b.vts"), 2, "not both"),
    (("export", *COMMON, "-o", "out/m.obj"), 1, ".ply, .vtp for SOURCE with its matches"),
    (("export", *COMMON, "--truth", "map.csv", "--points", "a.vts", "b.vts"), 2, "not both"),
    (("transfer", *COMMON), 2, "Give one of --texture"),
    (("transfer", *COMMON, "--labels", "word.txt", "--morph", "3"), 2, "Give one of --texture"),
    (("transfer", *COMMON, "--morph", "1"), 2, "--morph"),
    (("transfer", *COMMON, "--labels", "missing.txt", "-o", "out/l.txt"), 1, "missing.txt"),
    (("transfer", *COMMON, "--labels", "short.txt", "-o", "out/l.txt"), 1, "short.txt"),
    (("transfer", *COMMON, "--labels", "words.npy", "-o", "out/l.npy"), 1, "must hold integers"),
    (("transfer", *COMMON, "--labels", "word.txt", "-o", "out/l.doc"), 1, "labels are written to"),
    (("transfer", *COMMON, "--labels", "odd.txt", "-o", "out/l.txt"), 1, "odd.txt"),
    (("transfer", *COMMON, "--values", "word.txt", "-o", "out/l.txt"), 1, "must hold numbers"),
    (("transfer", *COMMON, "--values", "uneven.txt", "-o", "out/l.txt"), 1, "uneven.txt"),
    (("transfer", *COMMON, "--values", "cube.npy", "-o", "out/l.npy"), 1, "cube.npy"),
    (("transfer", *COMMON, "--values", "odd.npy", "-o", "out/l.npy"), 1, "odd.npy"),
    (("transfer", *COMMON, "--values", "short.txt", "-o", "out/l.txt"), 1, "short.txt"),
    (("transfer", *COMMON, "--landmarks", "landmarks.csv", "-o", "out/l.csv"), 1, "9999"),
    (("transfer", *COMMON, "--landmarks", "landmark-words.csv", "-o", "out/l.csv"), 1, "words.csv"),
    (("transfer", *COMMON, "--landmarks", "columns.csv", "-o", "out/l.csv"), 1, "columns.csv"),
    (("transfer", *COMMON, "--landmarks", "odd.csv", "-o", "out/l.csv"), 1, "odd.csv"),
    (("transfer", *COMMON, "--texture", "-o", "out/t.obj"), 1, "textures are read from"),
    (("transfer", "a.obj", *COMMON[1:], "--texture", "-o", "out/t.obj"), 1, "a.obj"),
    (("transfer", *COMMON, "--texture", "-o", "out/t.ply"), 1, "textures are written to"),
    (("transfer", *COMMON, "--vertex-colors", "-o", "out/c.ply"), 1, "has no colours"),
    (("transfer", *COMMON, "--vertex-colors", "-o", "out/c.obj"), 1, "colours are written to"),
    (("transfer", "points.xyz", *COMMON[1:], "--morph", "3", "-o", "out/m"), 1, "points.xyz"),
    (("spectrum", "a.off", "-k", "0"), 2, "-k"),
    (("spectrum", "a.off", "-k", "5000", "-o", "out/s.npz"), 1, "a.off"),
    (("spectrum", "a.off", "-k", "5", "-o", "out/s.doc"), 1, ".npz"),
    (("spectrum", "a.off", "--laplacian", "guessed"), 2, "guessed"),
    (("descriptor", "a.off", "--kind", "abc", "-o", "out/d.npy"), 1, "abc"),
    (("descriptor", "a.off", "--kind", "chirality", "-o", "out/d.npy"), 1, "expected one of gps"),
    (("register", "points.xyz", "a.off", "-o", "out/r.ply"), 1, "a surface is needed"),
    (("descriptor", "a.off", "-o", "out/d.doc"), 1, "descriptors are written to"),
    (("descriptor", "tiny.off", "-o", "out/d.npy"), 1, "tiny.off"),
    (("descriptor", "two.xyz", "-o", "out/d.npy"), 1, "two.xyz"),
    (("train", "missing", "-o", "out/m"), 1, "missing"),
    (("train", "shapeless", "-o", "out/m"), 1, "There is no mesh in"),
    (("train", "set", "--preset", "abc", "-o", "out/m"), 1, "There is no preset 'abc'"),
    (("train", "set", "--include", "z*", "-o", "out/m"), 1, "z*"),
    (("train", "set", "--validation", "x*", "--hold-out", "1", "-o", "out/m"), 2, "not both"),
    (("train", "set", "--steps", "0"), 2, "--steps"),
    (("train", "set", "--preset", "paper-gps", "-o", "shapeless"), 1, "is no model"),
    (("train", "set", "--preset", "paper-gps", "-o", "a.off"), 1, "a.off"),
    (("evaluate", "missing", "-m", "hks"), 1, "missing"),
    (("evaluate", "shapeless", "-m", "hks"), 1, "There is no mesh in"),
    (("evaluate", "set", "-m", "no-model"), 1, "no-model"),
    (("evaluate", "set", "-m", "hks", "--reject"), 1, "--min-confidence"),
    (("evaluate", "set", "-m", "hks", "--include", "z*"), 1, "z*"),
    (("evaluate", "set", "-m", "hks", "--pairs", "missing.tsv"), 1, "missing.tsv"),
    (("evaluate", "set", "-m", "hks", "--pairs", "unknown.tsv"), 1, "x9"),
    (("evaluate", "set", "-m", "hks", "--pairs", "one.tsv"), 1, "one.tsv"),
    (("evaluate", "set", "-m", "hks", "--pairs", "odd.tsv"), 1, "odd.tsv"),
    (("evaluate", "set", "--pairs", "unknown.tsv", "--include", "x*"), 2, "not both"),
    (("evaluate", "set", "-m", "hks", "--plot", "out/p.doc"), 1, ".png, .pdf or .svg"),
    (("evaluate", "set", "-m", "hks", "--plot", "out"), 1, "out"),
    (("evaluate", "lost", "-m", "hks"), 1, "has no correspondence"),
    (("precompute", "set", "-o", "out/s.zarr"), 1, "stores are written to .h5"),
    (("precompute", "set", "-o", "out/s.h5", "--preset", "gcnn", "-m", "hks"), 2, "not both"),
    (("precompute", "set", "-o", "out/s.h5", "--preset", "abc"), 1, "abc"),
    (("precompute", "set", "-o", "other.h5", "-m", "gps"), 1, "other.h5"),
    (("precompute", "set", "-o", "other.h5", "-m", "gps", "--force"), 1, "is no store"),
    (("precompute", "missing", "-o", "out/s.h5", "-m", "gps"), 1, "missing"),
    (("precompute", "set", "-o", "out/s.h5", "--scheduler", "http://a"), 1, "not the address"),
    (("reproduce", "abc", "--data", "set"), 2, "abc"),
    (("reproduce", "dimension", "--data", "missing", "-o", "out/r"), 1, "missing"),
    (("reproduce", "dimension", "--data", "set", "--data", "set", "-o", "out/r"), 2, "once"),
    (("reproduce", "dimension", "--data", "set", "--per-subject", "1"), 2, "--per-subject"),
    (("reproduce", "dimension", "--data", "set", "-o", "set"), 1, "is read by this command"),
    (("data", "list", "missing"), 1, "missing"),
    (("data", "list", "other.h5"), 1, "other.h5"),
    (("data", "list", "odd.h5"), 1, "odd.h5"),
    (("data", "select", "missing", "-o", "out/s.hdf5"), 1, "missing"),
    (("data", "select", "other.h5", "-o", "other.h5", "--force"), 1, "is read by this command"),
    (("data", "bodies", "--include", "z*", "--export", "out/bodies"), 1, "z*"),
    (("model", "show", "no-model"), 1, "no-model"),
    (("model", "show", "models/bare"), 1, "models/bare"),
    (("nosuch",), 2, "nosuch"),
    (("match", "a.off", "b.off", "--nosuch"), 2, "--nosuch"),
]


def contents(folder: Path) -> dict[str, str]:
    return {
        str(path.relative_to(folder)): hashlib.sha1(path.read_bytes()).hexdigest()
        for path in folder.rglob("*")
        if path.is_file()
    }


def run(arguments, folder, monkeypatch, capsys) -> tuple[int, str]:
    """Exit code of a command in this process, and what it said on standard error."""
    monkeypatch.chdir(folder)
    monkeypatch.setenv("COLUMNS", "300")
    monkeypatch.setenv("ESD_CACHE", "off")
    monkeypatch.setattr(sys, "argv", ["esd", *arguments])
    capsys.readouterr()
    with pytest.raises(SystemExit) as ended:
        main()
        raise SystemExit(0)
    logging.getLogger().setLevel(logging.WARNING)
    return ended.value.code or 0, capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "code", "said"), CASES, ids=[" ".join(case[0]) for case in CASES]
)
def test_bad_input_is_refused(folder, monkeypatch, capsys, arguments, code, said):
    before = contents(folder)
    found, message = run(arguments, folder, monkeypatch, capsys)
    assert found == code, message
    assert said in message
    assert "Traceback" not in message
    assert "fault of esd" not in message
    if code == 1:
        assert message.splitlines()[-1].startswith("esd: ")
        assert sum(not line.startswith("'") for line in message.splitlines()) == 1, message
    assert contents(folder) == before
    assert not list((folder / "out").rglob("*"))


def test_there_are_enough_kinds_of_it_and_the_page_lists_them():
    assert len({case[0] for case in CASES}) == len(CASES) >= 150
    page = (Path(__file__).parents[1] / "docs" / "robustness.md").read_text()
    listed = [
        line.split("|")[1].strip(" `") for line in page.splitlines() if line.startswith("| `")
    ]
    commands = {" ".join(["esd", *arguments]).replace("|", "") for arguments, *_ in CASES}
    assert commands | set(HOSTILE) <= set(listed), "run tools/list_bad_input.py"
    assert len(set(listed)) >= 150


WRITING = {
    "match": (("match", "a.off", "b.off", "-m", "gps"), "-o", "a.off", ".csv"),
    "spectrum": (("spectrum", "a.off", "-k", "5"), "-o", "a.off", ".npz"),
    "descriptor": (("descriptor", "a.off", "--kind", "gps"), "-o", "a.off", ".npy"),
    "doctor": (("doctor", "a.off"), "--repair", "a.off", ".off"),
    "view": (("view", *COMMON), "-o", "map.csv", ".html"),
    "export": (("export", *COMMON), "-o", "map.csv", ".csv"),
    "transfer": (("transfer", *COMMON, "--labels", "labels.txt"), "-o", "labels.txt", ".txt"),
    "precompute": (("precompute", "dyna.hdf5", "-m", "gps"), "-o", "dyna.hdf5", ".h5"),
    "select": (("data", "select", "dyna.hdf5"), "-o", "dyna.hdf5", ".hdf5"),
    "evaluate": (("evaluate", "dyna.hdf5", "-m", "gps"), "--plot", "dyna.hdf5", ".png"),
}


@pytest.fixture
def inputs(folder, tmp_path) -> Path:
    for name in COMMON:
        (tmp_path / name).write_bytes((folder / name).read_bytes())
    (tmp_path / "labels.txt").write_text("one\n" * 96)
    mesh = torus(12, 8)
    with h5py.File(tmp_path / "dyna.hdf5", "w") as file:
        file["faces"] = mesh.faces
        file["50002_hips"] = np.repeat(mesh.vertices[:, :, None], 3, axis=2)
    return tmp_path


@pytest.mark.parametrize("link", ["itself", "symbolic", "hard"])
@pytest.mark.parametrize("command", WRITING)
def test_no_command_writes_on_its_input(inputs, monkeypatch, capsys, command, link):
    arguments, option, read, suffix = WRITING[command]
    output = inputs / f"other{suffix}"
    if link == "symbolic":
        output.symlink_to(read)
    elif link == "hard":
        os.link(inputs / read, output)
    elif Path(read).suffix == suffix:
        output = inputs / "set" / ".." / read
        (inputs / "set").mkdir()
    else:
        pytest.skip("the suffix alone is refused")
    before = contents(inputs)
    code, message = run((*arguments, option, str(output), "--force"), inputs, monkeypatch, capsys)
    assert code == 1
    assert "is read by this command; choose another name" in message
    assert contents(inputs) == before


@pytest.mark.parametrize("command", WRITING)
def test_no_command_replaces_a_file_without_force(inputs, monkeypatch, capsys, command):
    arguments, option, _, suffix = WRITING[command]
    if command == "precompute":
        pytest.skip("it brings a store up to date, and refuses what is no store")
    (inputs / f"mine{suffix}").write_text("mine")
    before = contents(inputs)
    code, message = run((*arguments, option, f"mine{suffix}"), inputs, monkeypatch, capsys)
    assert code == 1
    assert "give --force to replace it" in message
    assert contents(inputs) == before


@pytest.mark.parametrize("command", ["spectrum", "doctor", "view", "export", "transfer", "select"])
def test_outputs_may_lie_in_folders_that_do_not_exist(inputs, monkeypatch, capsys, command):
    arguments, option, _, suffix = WRITING[command]
    output = inputs / "new" / "er" / f"x{suffix}"
    assert run((*arguments, option, str(output)), inputs, monkeypatch, capsys)[0] == 0
    assert output.is_file()
