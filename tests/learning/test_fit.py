import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from esd.descriptors.recipe import Descriptor, Recipe
from esd.learning.fit import fit
from esd.learning.model import load_model, save_model
from esd.learning.presets import PRESETS

OSD = replace(
    PRESETS["osd"], recipe=Recipe((Descriptor("hks", 12),), eigenpairs=20), outputs=4, steps=20
)


@pytest.mark.parametrize("kind", ["hks", "geometry"])
def test_a_fitted_model_separates_unseen_subjects_and_survives_the_disk(collection, tmp_path, kind):
    training = replace(OSD, recipe=Recipe((Descriptor(kind, 12),), eigenpairs=20))
    seen, unseen = collection.of_subjects(["s0", "s1", "s2"]), collection.of_subjects(["s3", "s2"])
    model = fit(seen, training, validation=unseen, seed=1)
    assert model.card["separation"] > 3
    assert model.card["validation_separation"] > 3
    assert ("largest" in model.recipe.descriptors[0].options) == (kind == "geometry")
    save_model(model, tmp_path / "m")
    mesh = unseen.shapes[0].mesh()
    embedded = model.embed_mesh(mesh)
    assert embedded.shape == (len(mesh.vertices), 4)
    np.testing.assert_array_equal(load_model(tmp_path / "m").embed_mesh(mesh), embedded)
    again = fit(seen, training, seed=1)
    np.testing.assert_array_equal(again.layers[0].weight, model.layers[0].weight)


def test_osd_needs_no_torch():
    code = (
        "import sys; sys.modules['torch'] = None\n"
        "from esd.datasets.bodies import bodies\n"
        "from esd.descriptors.recipe import Descriptor, Recipe\n"
        "from dataclasses import replace\n"
        "from esd.learning.fit import fit\n"
        "from esd.learning.presets import PRESETS\n"
        "some = bodies(remeshed=False).including('s00_p0[01]')\n"
        "recipe = Recipe((Descriptor('hks', 12),), eigenpairs=20)\n"
        "fit(some, replace(PRESETS['osd'], recipe=recipe, outputs=4, steps=2))\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
