import json
import subprocess
import sys

import numpy as np

from esd.datasets.open import open_collection
from esd.evaluation.protocol import evaluate
from esd.learning.model import load_model
from esd.matching.match import match
from esd.mesh.mesh import Mesh
from esd.spectral.spectrum import spectrum


def test_collections_are_read_whole(real_data):
    for name, shapes, pairs in (("faust_r", 80, 5600), ("tosca_r", 27, 188), ("smal_r", 32, None)):
        collection = open_collection(real_data / name)
        assert len(collection.shapes) == shapes
        assert pairs is None or len(collection.pairs()) == pairs
        first = collection.shapes[0]
        assert first.correspondence().max() < len(first.mesh().vertices)


def test_spectrum_of_a_person_is_orthonormal(real_data):
    mesh = open_collection(real_data / "faust_r")["tr_reg_000"].mesh()
    found = spectrum(mesh, 100)
    gram = found.eigenvectors.T @ (found.mass[:, None] * found.eigenvectors)
    np.testing.assert_allclose(gram, np.eye(100), atol=1e-9)


def test_bundled_embedding_improves_its_descriptor_on_people_it_never_saw(real_data, tmp_path):
    pairs = tmp_path / "pairs"
    pairs.write_text("tr_reg_060\ttr_reg_070\ntr_reg_075\ttr_reg_063\n")
    error = {}
    for model in ("hks", "paper-hks"):
        command = [sys.executable, "-m", "esd", "evaluate", real_data / "faust_r", "--json"]
        command += ["--model", model, "--pairs", pairs]
        done = subprocess.run(command, capture_output=True, check=True)
        error[model] = json.loads(done.stdout)["symmetric_mean_geodesic_error_x100"]
    assert error["paper-hks"] < 0.75 * error["hks"]


def test_default_model_tells_left_from_right_on_people_it_never_saw(real_data):
    people = open_collection(real_data / "faust_r")
    source, target = people["tr_reg_060"], people["tr_reg_070"]
    result, _ = evaluate(load_model("default"), [(source, target)])
    assert result.mean_geodesic_error_x100 < 2.5
    assert result.accuracy_5pct_diameter > 0.95
    mesh = target.mesh()
    straight = match(source.mesh(), mesh)
    assert straight.judgement.verdict == "good"
    mirror = Mesh(mesh.vertices * [-1, 1, 1], mesh.faces)
    mirrored = match(source.mesh(), mirror)
    assert mirrored.judgement.verdict == "mirrored"
