import numpy as np
import pytest

import esd
from esd.mesh.io.meshes import read_mesh
from esd.population.atlas import is_atlas_folder
from esd.population.files import save_atlas


def test_an_atlas_is_written_to_a_folder(ellipsoids, tmp_path):
    save_atlas(ellipsoids, tmp_path / "a")
    assert is_atlas_folder(tmp_path / "a")
    model = esd.load_shape_model(tmp_path / "a" / "model.npz")
    lines = (tmp_path / "a" / "scores.csv").read_text().splitlines()
    assert lines[0].startswith("name,subject,size,distance,outlier,mode_1")
    scores = np.array([float(cell) for cell in lines[3].split(",")[5:]])
    # nine digits are written
    assert model.reconstructed(scores) == pytest.approx(ellipsoids.aligned[2], abs=1e-6)
    assert len((tmp_path / "a" / "modes.csv").read_text().splitlines()) == 1 + len(model.modes)
    assert len((tmp_path / "a" / "shapes.csv").read_text().splitlines()) == 7
    assert len(read_mesh(tmp_path / "a" / "mean.ply").vertices) == 162
