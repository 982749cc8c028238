import numpy as np
import pytest
from scipy import linalg, sparse

from esd.mesh.shapes import torus
from esd.spectral.factorisation import factorise
from esd.spectral.lanczos import BlockLanczos
from esd.spectral.laplacian import lumped_mass, stiffness

MESH = torus(20, 12)
MASS = lumped_mass(MESH)
SHIFT = 1.7


@pytest.fixture
def space() -> BlockLanczos:
    operator = factorise(stiffness(MESH), MASS, SHIFT)
    return BlockLanczos(operator, MASS, block=6, generator=np.random.default_rng(0), run=map)


def test_ritz_pairs_converge_to_eigenpairs_and_their_errors_are_estimated(space):
    exact = linalg.eigh(stiffness(MESH).toarray(), np.diag(MASS), eigvals_only=True)
    errors = []
    for size in (12, 18, 30):
        space.extend(size)
        assert space.size >= size
        ritz = space.ritz()
        first = np.flatnonzero(np.abs(ritz.values - SHIFT) < 1.5)
        gap = np.abs(ritz.values[first, None] - exact).min(axis=1)
        # estimates are norms of residuals, which bound the distance to the next eigenvalue
        assert (gap <= ritz.errors[first] * (1 + 1e-6) + 1e-10).all()
        errors.append(gap.max())
    assert errors[2] < 1e-9 < 1e-2 < errors[0]


def test_vectors_are_orthonormal_in_the_mass_and_satisfy_the_equation(space):
    space.extend(150)
    ritz = space.ritz()
    vectors = space.vectors(ritz, 10)
    np.testing.assert_allclose(vectors * MASS @ vectors.T, np.eye(10), atol=1e-9)
    residual = stiffness(MESH) @ vectors.T - (MASS[:, None] * vectors.T) * ritz.values[:10]
    assert np.abs(residual).max() < 1e-9


def test_a_space_ends_where_it_spans_everything(space):
    space.extend(2 * len(MASS))
    assert space.size == len(MASS)
    np.testing.assert_allclose(
        space.ritz().values,
        linalg.eigh(stiffness(MESH).toarray(), np.diag(MASS), eigvals_only=True),
        atol=1e-7,  # of values up to 10⁴
    )


def test_a_wider_block_sees_more_copies_of_an_eigenvalue():
    """A block of two sees two copies of an eigenvalue that four vectors share."""
    diagonal = np.repeat(np.arange(1.0, 60.0), 4)
    operator = factorise(sparse.diags_array(diagonal).tocsc(), np.ones(236), 0.5)
    made = BlockLanczos(
        operator, np.ones(236), block=2, generator=np.random.default_rng(0), run=map
    )
    made.extend(20)
    assert np.sum(np.abs(made.ritz().values - 1) < 1e-8) == 2
    made.widen(2)
    made.extend(60)
    assert np.sum(np.abs(made.ritz().values - 1) < 1e-8) == 4
