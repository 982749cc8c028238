from esd.mesh import files
from esd.mesh.io import meshes


def test_the_former_names_are_the_new_ones():
    assert files.__all__ == ["FORMATS", "read_arrays", "read_mesh", "write_mesh"]
    for name in files.__all__:
        assert getattr(files, name) is getattr(meshes, name)
