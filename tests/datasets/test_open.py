import h5py
import numpy as np
import pytest

from esd.common import InputError
from esd.datasets.open import open_collection
from esd.mesh.io.meshes import write_mesh


def test_what_a_data_set_is_follows_from_its_content(tmp_path, blob):
    assert len(open_collection("bodies").shapes) == 140
    first, same = (open_collection(name).shapes[0] for name in ("bodies", "bodies-registered"))
    assert first.name == same.name
    folder = tmp_path / "set"
    folder.mkdir()
    write_mesh(blob, folder / "a.off")
    assert [shape.name for shape in open_collection(folder).shapes] == ["a"]
    with h5py.File(tmp_path / "frames", "w") as file:  # whatever it is called
        file["faces"] = blob.faces
        file["50002_hips"] = np.repeat(blob.vertices[:, :, None], 3, axis=2)
    assert len(open_collection(tmp_path / "frames").shapes) == 3
    with pytest.raises(InputError, match="There is no data set"):
        open_collection(tmp_path / "none")
