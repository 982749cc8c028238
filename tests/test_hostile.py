import json
import os
import resource
import subprocess
import sys

import pytest

from esd.common import InputError
from esd.mesh.io.meshes import read_mesh
from hostile_files import HOSTILE, glb, gltf

_MEMORY = 2 * 2**30
_READ_ALL = """
import json, resource, sys, time
from pathlib import Path
import numpy as np, scipy.spatial, trimesh, robust_laplacian
from esd.common import InputError
from esd.mesh.io.meshes import read_mesh
base = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
for path in sorted(Path(sys.argv[1]).iterdir()):
    start = time.perf_counter()
    try:
        read_mesh(path)
        said = None
    except InputError as error:
        said = str(error)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - base
    print(json.dumps([path.name, said, time.perf_counter() - start, peak]), flush=True)
"""


@pytest.fixture(scope="module")
def answers(tmp_path_factory) -> dict[str, tuple[str | None, float, int]]:
    """What is said to each file by one process of bounded memory: message, seconds, peak in kB."""
    folder = tmp_path_factory.mktemp("hostile") / "in"
    folder.mkdir()
    (folder.parent / "outside.bin").write_bytes(bytes(48))
    for name, content in HOSTILE.items():
        (folder / name).write_bytes(content)
    done = subprocess.run(
        [sys.executable, "-c", _READ_ALL, str(folder)],
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
        env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (_MEMORY, _MEMORY)),
    )
    assert done.returncode == 0, done.stderr
    return {name: rest for name, *rest in map(json.loads, done.stdout.splitlines())}


@pytest.mark.parametrize("name", HOSTILE)
def test_a_hostile_file_is_refused_by_name_soon_and_without_much_memory(answers, name):
    message, seconds, peak = answers[name]
    assert message is not None
    assert name in message
    assert seconds < 10  # each takes milliseconds; the machine may be busy
    assert peak < 300_000  # of a gigabyte and more that the worst of them ask for


def test_each_says_what_is_wrong_with_it(answers):
    for name, part in {
        "billion_vertices.off": "",
        "billion_faces.off": "announces 1000000000 faces, 1 were read",
        "longer_than_itself.glb": "no GLB file, or cut short",
        "unknown_format.ply": "format is 'binary_middle_endian'",
        "list.gltf": "no scene in it",
        "zero_accessor.glb": "has 1000000000 vertices; expected at most",
        "climbing_path.gltf": "'../outside.bin', which is not beside it",
        "absolute_path.gltf": "'/etc/passwd', which is not beside it",
        "far_path.gltf": "'http://localhost:9/a.bin', which is not beside it",
        "laughing_nodes.gltf": "no tree",
        "node_circle.gltf": "no tree",
        "word_coordinate.obj": "cannot be read as OBJ",
        "infinite.off": "must be finite",
    }.items():
        assert part in answers[name][0], answers[name][0]


def test_a_scene_without_harm_is_read(tmp_path):
    for name, content in (("a.gltf", gltf()), ("a.glb", glb(gltf()))):
        (tmp_path / name).write_bytes(content)
        assert read_mesh(tmp_path / name).faces.tolist() == [[0, 1, 2]]


def test_a_file_beyond_all_size_is_refused_before_it_is_read(tmp_path):
    with (tmp_path / "vast.off").open("wb") as file:
        file.truncate(2**32 + 1)  # a hole: it takes no space
    with pytest.raises(InputError, match="larger than 4 GiB"):
        read_mesh(tmp_path / "vast.off")


def test_links_pipes_and_folders_are_no_mesh_files(tmp_path):
    (tmp_path / "loop.off").symlink_to(tmp_path / "loop.off")
    (tmp_path / "nowhere.off").symlink_to(tmp_path / "none.off")
    os.mkfifo(tmp_path / "pipe.off")
    (tmp_path / "folder.off").mkdir()
    for name in ("loop", "nowhere", "pipe", "folder"):
        with pytest.raises(InputError, match="There is no file"):
            read_mesh(tmp_path / f"{name}.off")
