import h5py
import numpy as np

from esd.mesh.shapes import torus


def test_sequences_are_listed_and_selected(run, tmp_path):
    source, selection = tmp_path / "dyna", tmp_path / "selection.hdf5"
    mesh = torus(6, 5)
    with h5py.File(source, "w") as file:
        file["faces"] = mesh.faces
        file["50002_hips"] = np.repeat(mesh.vertices[:, :, None], 30, axis=2)
    assert run("data", "list", source).stdout == "50002\thips\t30\n"
    assert "4 frames" in run("data", "select", source, "-o", selection, "--per-subject", 4).stdout
    assert run("data", "list", selection).stdout == "50002\thips\t4\n"
