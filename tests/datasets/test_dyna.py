import h5py
import numpy as np
import pytest

from esd.common import InputError
from esd.datasets.dyna import dyna_collection, is_dyna, recordings, save_selection
from esd.datasets.open import open_collection
from esd.mesh.shapes import torus

SEQUENCES = {
    "50002_one_leg_jump": 1400,
    "50002_running_on_spot_bugfix": 7,
    "50020_hips": 900,
    "50004_jiggle_on_toes": 40,
}


def vertices(key, frame):
    """Positions that tell the sequence and the frame."""
    return torus(4, 3).vertices + 10 * list(SEQUENCES).index(key) + frame / 1e4


def write(path, sequences=SEQUENCES):
    with h5py.File(path, "w") as file:
        file["faces"] = torus(4, 3).faces.astype(np.uint32)
        for key in sequences:
            frames = [vertices(key, t) for t in range(SEQUENCES[key])]
            file[key] = np.stack(frames, axis=2).astype(np.float32)
    return path


@pytest.fixture
def dyna(tmp_path):
    return write(tmp_path / "any_name.dat")


def test_files_are_recognised_by_content_and_indexed(dyna, tmp_path):
    (tmp_path / "text.h5").write_text("not HDF5")
    assert is_dyna(dyna)
    assert not is_dyna(tmp_path / "text.h5")
    assert not is_dyna(tmp_path / "missing")
    listed = [(r.subject, r.sequence, len(r.frames)) for r in recordings(dyna)]
    assert listed == [
        ("50002", "one_leg_jump", 1400),
        ("50002", "running_on_spot_bugfix", 7),
        ("50004", "jiggle_on_toes", 40),
        ("50020", "hips", 900),
    ]
    collection = open_collection(dyna)
    assert len(collection.shapes) == 2347
    assert collection.subjects == ("50002", "50004", "50020")


@pytest.mark.parametrize("name", [r"50002_one_leg_jump\00455", r"50020_hips\00515"])
def test_frames_are_named_as_in_the_paper_and_read_alone(dyna, name):
    shape = dyna_collection(dyna)[name]
    key, frame = name.split("\\")
    mesh = shape.mesh()
    # coordinates up to 21 in single precision
    np.testing.assert_allclose(mesh.vertices, vertices(key, int(frame)), atol=2e-6)
    np.testing.assert_array_equal(mesh.faces, torus(4, 3).faces)
    np.testing.assert_array_equal(shape.correspondence(), np.arange(12))
    assert shape.subject == key[:5]


def test_a_folder_of_files_is_one_collection(tmp_path):
    write(tmp_path / "m.h5", ["50002_one_leg_jump"])
    write(tmp_path / "f.hdf5", ["50004_jiggle_on_toes"])
    assert open_collection(tmp_path).subjects == ("50002", "50004")
    write(tmp_path / "again.h5", ["50004_jiggle_on_toes"])
    with pytest.raises(InputError, match=r"'50004_jiggle_on_toes' is in .* and in"):
        dyna_collection(tmp_path)


def test_a_selection_keeps_the_names_and_shapes_of_its_frames(dyna, tmp_path):
    selection = tmp_path / "selection.hdf5"
    assert save_selection(dyna, selection, per_subject=5, seed=1) == 15
    small, whole = dyna_collection(selection), dyna_collection(dyna)
    assert len(small.shapes) == 15
    for shape in small.shapes:
        np.testing.assert_array_equal(shape.mesh().vertices, whole[shape.name].mesh().vertices)
    assert selection.stat().st_size < 0.1 * dyna.stat().st_size
    save_selection(dyna, tmp_path / "again.hdf5", per_subject=5, seed=1)
    assert [s.name for s in dyna_collection(tmp_path / "again.hdf5").shapes] == [
        s.name for s in small.shapes
    ]
    with pytest.raises(InputError, match="cannot be written"):
        save_selection(dyna, selection / "b.hdf5")


def test_broken_files_are_refused(dyna, tmp_path):
    cut = tmp_path / "cut.h5"
    cut.write_bytes(dyna.read_bytes()[:-5000])
    with pytest.raises(InputError, match="is cut short"):
        dyna_collection(cut)
    with pytest.raises(InputError, match="There is no file"):
        dyna_collection(tmp_path / "none.h5")
    other = tmp_path / "other.h5"
    for content, message in [
        ({"x": np.zeros(3)}, "no data set 'faces'"),
        ({"faces": np.zeros((3, 4))}, r"faces of shape \(F, 3\), got \(3, 4\)"),
        ({"faces": np.zeros((4, 3))}, "no sequence"),
        (
            {"faces": np.zeros((4, 3)), "50002_hips": np.zeros((3, 5, 7))},
            r"'50002_hips': expected shape \(V, 3, T\), got \(3, 5, 7\)",
        ),
        (
            {
                "faces": np.zeros((4, 3)),
                "50002_hips": np.zeros((5, 3, 7)),
                "50004_hips": np.zeros((6, 3, 7)),
            },
            "'50004_hips' has 6 vertices, '50002_hips' 5",
        ),
    ]:
        with h5py.File(other, "w") as file:
            for key, value in content.items():
                file[key] = value
        with pytest.raises(InputError, match=message):
            dyna_collection(other)


def test_unreadable_frames_are_reported(dyna, tmp_path):
    packed = tmp_path / "packed.h5"
    values = np.random.default_rng(0).random((12, 3, 50))
    with h5py.File(packed, "w") as file:
        file["faces"] = torus(4, 3).faces
        file.create_dataset("50002_hips", data=values, chunks=(12, 3, 1), fletcher32=True)
        at = file["50002_hips"].id.get_chunk_info(7).byte_offset
    content = bytearray(packed.read_bytes())
    content[at] ^= 255
    packed.write_bytes(content)
    collection = dyna_collection(packed)
    assert len(collection.shapes[6].mesh().vertices) == 12
    with pytest.raises(InputError, match="'50002_hips', frame 7 cannot be read"):
        collection.shapes[7].mesh()
