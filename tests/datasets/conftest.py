import pytest

from esd.mesh.io.meshes import write_mesh
from esd.mesh.shapes import grid, torus


@pytest.fixture
def registered(tmp_path):
    """Four meshes of one connectivity, of three subjects."""
    for name in ("tr_reg_000", "tr_reg_001", "tr_reg_010", "tr_reg_020"):
        write_mesh(torus(6, 5), tmp_path / f"{name}.off")
    return tmp_path


@pytest.fixture
def remeshed(tmp_path):
    """Two cats and a wolf with their points, of other connectivities."""
    (tmp_path / "shapes").mkdir()
    (tmp_path / "corres").mkdir()
    for name, rows in (("cat0", 5), ("cat1", 6), ("wolf0", 7)):
        write_mesh(grid(4, rows), tmp_path / "shapes" / f"{name}.off")
        (tmp_path / "corres" / f"{name}.vts").write_text("3\n1\n20\n")
    (tmp_path / "corres" / "cat0.sym.vts").write_text("1\n3\n20\n")
    return tmp_path
