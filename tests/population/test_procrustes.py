import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from esd.common import InputError
from esd.mesh.geometry import vertex_areas
from esd.mesh.shapes import icosphere
from esd.population.procrustes import aligned_to, generalised_procrustes

SPHERE = icosphere(2)
MASS = vertex_areas(SPHERE)


def moved(shape: np.ndarray, seed: int, scale: float = 1.0) -> np.ndarray:
    generator = np.random.default_rng(seed)
    rotation = Rotation.random(random_state=generator).as_matrix()
    return scale * shape @ rotation + generator.normal(size=3)


def lump(shape: np.ndarray) -> np.ndarray:
    """Without any symmetry."""
    return shape * (1 + 0.4 * shape[:, :1] + 0.2 * shape[:, 1:2] * shape[:, 2:]) + 0.1 * shape**2


LUMP = lump(SPHERE.vertices)


def test_copies_in_other_places_become_one():
    scales = [1.0, 2.0, 0.5]
    shapes = np.stack([moved(LUMP, i, scale) for i, scale in enumerate(scales)])
    found = generalised_procrustes(shapes, mass=MASS, start=LUMP)
    assert found.vertices == pytest.approx(np.broadcast_to(found.mean, shapes.shape), abs=1e-9)
    assert found.sizes / found.sizes[0] == pytest.approx(scales)
    # the mean of the logarithms of 1, 2 and ½ is zero: all get the size of the first
    centred = LUMP - np.average(LUMP, axis=0, weights=MASS)
    assert found.mean == pytest.approx(centred, abs=1e-6)


def test_sizes_may_be_kept():
    shapes = np.stack([moved(LUMP, i, scale) for i, scale in enumerate([1.0, 1.2])])
    found = generalised_procrustes(shapes, mass=MASS, keep_size=True)
    size = np.sqrt(np.average(((found.vertices) ** 2).sum(axis=2), axis=1, weights=MASS))
    assert size == pytest.approx(found.sizes)
    assert size[1] / size[0] == pytest.approx(1.2)


def test_missing_parts_change_neither_place_nor_size():
    shapes = np.stack([moved(LUMP, i, 1 + i) for i in range(4)])
    whole = generalised_procrustes(shapes, mass=MASS, start=LUMP)
    shapes[1, SPHERE.vertices[:, 0] > 0.3] = np.nan
    shapes[2, SPHERE.vertices[:, 1] > 0.0] = np.nan
    found = generalised_procrustes(shapes, mass=MASS, start=LUMP)
    assert found.sizes == pytest.approx(whole.sizes, rel=1e-6)
    assert found.mean == pytest.approx(whole.mean, abs=1e-6)
    assert (np.isnan(found.vertices) == np.isnan(shapes)).all()


def test_mirror_images_are_not_aligned():
    mirrored = LUMP * [-1.0, 1.0, 1.0]
    found = aligned_to(LUMP, mirrored, mass=MASS)
    # a rotation of the mirrored shape, which keeps the sign of the volume of any four vertices
    corners = [0, 5, 20, 60]
    volume = [np.linalg.det(x[corners[1:]] - x[corners[0]]) for x in (mirrored, found)]
    assert volume[0] == pytest.approx(volume[1], rel=1e-6)
    # no other of many rotations brings it nearer
    gap = MASS @ ((found - LUMP) ** 2).sum(axis=1)
    centre = np.average(LUMP, axis=0, weights=MASS)
    for rotation in Rotation.random(200, random_state=0).as_matrix():
        other = (found - centre) @ rotation + centre
        assert MASS @ ((other - LUMP) ** 2).sum(axis=1) >= gap


def test_shapes_without_common_vertices_are_refused():
    shapes = np.stack([LUMP, LUMP, LUMP])
    shapes[1, 2:] = np.nan
    with pytest.raises(InputError, match="2 vertices in common with the mean; 3 or more"):
        generalised_procrustes(shapes, mass=MASS)
