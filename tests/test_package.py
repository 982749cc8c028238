import re
import subprocess
import sys

import numpy as np
import pytest

import esd
from esd.mesh.io.meshes import write_mesh
from esd.mesh.shapes import icosphere


def test_public_names_are_there():
    for name in esd.__all__:
        assert getattr(esd, name) is not None
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        esd.nothing  # noqa: B018


def test_only_public_names_are_completed():
    assert dir(esd) == sorted(esd.__all__)
    assert {"train", "evaluate", "hks", "wks", "gps", "zoomout", "transfer"} <= set(dir(esd))


def test_everything_shows_itself_in_a_line(sphere, collection):
    spectrum = esd.spectrum(sphere, 10)
    match = esd.Correspondence(*(np.zeros(len(sphere.vertices), dtype=int) for _ in range(3)))
    page = esd.view(sphere, sphere, match)
    for thing in (sphere, collection, spectrum, match, page, esd.load_model("default")):
        assert re.fullmatch(r"<\w+.{1,150}>", repr(thing)), repr(thing)[:200]


def test_importing_it_loads_no_other_package():
    code = "import sys, esd; sys.exit(', '.join({'numpy', 'scipy', 'torch'} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert not done.stderr.strip()


def test_a_map_of_plain_files_loads_only_what_it_needs(tmp_path):
    for name in ("a.off", "b.off"):
        write_mesh(icosphere(4), tmp_path / name)
    code = (
        "import sys; from esd.cli import main\n"
        "try: main()\n"
        "except SystemExit as end: assert not end.code\n"
        "slow = {'trimesh', 'scipy.optimize', 'torch', 'h5py', 'matplotlib'}\n"
        "assert not slow & set(sys.modules), slow & set(sys.modules)"
    )
    files = [str(tmp_path / name) for name in ("a.off", "b.off", "map.csv")]
    command = [sys.executable, "-c", code, "match", *files[:2], "-o", files[2]]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
