"""Landmarks of real shapes lie on them, and are missed in another unit."""

import os
from pathlib import Path

import pytest

from esd.common import InputError
from esd.mesh.io.landmarks import read_landmarks
from esd.mesh.io.meshes import read_mesh
from esd.mesh.mesh import Mesh

DATA = Path(os.environ.get("ESD_DATA", Path(__file__).parents[3] / "shared" / "data"))
FILES = [
    *(
        (file, DATA / "skulls/shapes" / f"{file.stem}.ply")
        for file in sorted((DATA / "skulls/landmarks").glob("*.csv"))[:3]
    ),
    *(
        (file, file.with_name(file.name[:3] + ".ply"))
        for file in sorted((DATA / "heads").glob("*.lm.csv"))
    ),
    *((file, file.with_suffix(".ply")) for file in sorted((DATA / "endocasts").glob("*.csv"))),
]


@pytest.mark.skipif(not FILES, reason=f"the landmarks of real shapes are not in {DATA}")
def test_landmarks_of_experts_are_on_their_shapes():
    for file, shape in FILES:
        mesh = read_mesh(shape)
        assert len(read_landmarks(file, mesh).names) >= 51
        metres = Mesh(mesh.vertices / 1000, mesh.faces)
        with pytest.raises(InputError, match=r"millimetres to metres \(times 0.001\)"):
            read_landmarks(file, metres)
