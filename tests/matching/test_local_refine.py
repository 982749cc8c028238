import numpy as np
import pytest

from esd.common import InputError
from esd.matching import local_refine
from esd.matching.local_refine import levels, local_zoomout
from esd.matching.refine import zoomout
from esd.mesh.geometry import vertex_areas
from esd.mesh.mesh import Mesh
from esd.mesh.shapes import subdivide
from esd.nearest import nearest
from esd.spectral.spectrum import Spectrum, spectrum

SIZES = 20, 60, 90, 120


@pytest.fixture
def pair(blob, monkeypatch):
    """A shape of 2,048 vertices, itself renumbered and turned, and the true map."""
    monkeypatch.setattr(local_refine, "_SAMPLES", 500)
    mesh = subdivide(blob)
    order = np.random.default_rng(0).permutation(len(mesh.vertices))
    place = np.argsort(order)
    turned = Mesh(mesh.vertices[order][:, [1, 2, 0]], place[mesh.faces])
    return mesh, turned, place


def noisy(mesh, turned):
    """Rows that lead near the truth: positions in one frame, moved a little."""
    noise = 0.03 * np.random.default_rng(0).standard_normal((2, *mesh.vertices.shape))
    return mesh.vertices + noise[0], turned.vertices[:, [2, 0, 1]] + noise[1]


def test_a_noisy_map_becomes_the_true_one_as_by_zoomout(pair):
    mesh, turned, truth = pair
    rows = noisy(mesh, turned)
    spectra = spectrum(mesh, 120), spectrum(turned, 120)
    both = [
        levels(each, shape.vertices, count=len(truth))
        for each, shape in zip(spectra, (mesh, turned), strict=True)
    ]
    index, products = local_zoomout(*both, rows, embeddings=rows, sizes=SIZES)
    first, _ = nearest(*rows)
    everywhere = zoomout(*spectra, first, embeddings=rows, sizes=SIZES)
    assert (first == truth).mean() < 0.7
    assert (index == truth).mean() > (everywhere == truth).mean() - 0.02
    assert products < 0.3 * len(SIZES) * len(truth) ** 2


def test_vertices_without_a_face_have_no_match_and_are_none(pair):
    mesh, turned, truth = pair
    lone = [
        Mesh(np.concatenate([np.ones((3, 3)), shape.vertices]), shape.faces + 3)
        for shape in (mesh, turned)
    ]
    rows = tuple(np.concatenate([np.ones((3, 3)), each]) for each in noisy(mesh, turned))
    both = [levels(spectrum(shape, 80), shape.vertices, count=len(truth)) for shape in lone]
    index, _ = local_zoomout(*both, rows, embeddings=rows, sizes=(20, 80))
    assert (index[:3] == -1).all()
    assert (index[3:] >= 3).all()


def test_the_number_of_products_grows_linearly(pair):
    """Four times as many vertices: products of all pairs of them would be sixteen times as many."""
    mesh, turned, _ = pair
    taken = {}
    for _ in range(3):
        count = len(mesh.vertices)
        rows = mesh.vertices, turned.vertices[:, [2, 0, 1]]
        # coordinates in place of eigenfunctions: what is counted does not depend on them
        both = [levels(coordinates(shape), shape.vertices, count=count) for shape in (mesh, turned)]
        _, taken[count] = local_zoomout(*both, rows, embeddings=rows, sizes=(3, 4))
        mesh, turned = subdivide(mesh), subdivide(turned)
    few, some, many = taken
    assert taken[many] - taken[some] < 6 * (taken[some] - taken[few])
    assert taken[many] < 1000 * many


def coordinates(mesh):
    mass = vertex_areas(mesh)
    rows = np.column_stack([np.ones(len(mass)), mesh.vertices])
    return Spectrum(np.arange(4.0), rows, mass / mass.sum(), 1)


def test_shapes_of_different_levels_are_refused(pair):
    mesh, turned, truth = pair
    a = levels(coordinates(mesh), mesh.vertices, count=len(truth))
    b = levels(coordinates(turned), turned.vertices, count=20_000)
    with pytest.raises(InputError, match="need as many levels; got 2 and 3"):
        local_zoomout(a, b, noisy(mesh, turned), embeddings=noisy(mesh, turned))
    with pytest.raises(InputError, match="must be ascending"):
        local_zoomout(a, a, noisy(mesh, mesh), embeddings=noisy(mesh, mesh), sizes=(4, 3))
