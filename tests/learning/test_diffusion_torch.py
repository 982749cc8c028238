import numpy as np
import pytest

from esd.datasets.parts import part_of
from esd.learning.diffusion import diffusion_network, surface_of
from esd.spectral.spectrum import spectrum

torch = pytest.importorskip("torch", reason="training needs the extra `train`")
from esd.learning.diffusion_torch import seeded_layers, surface_tensors  # noqa: E402


def test_the_network_of_torch_is_that_of_numpy(blob):
    part = part_of(blob, "cut of 20 %").mesh
    surface = surface_of(part, spectrum(part, 80).with_area(0.8))
    found = surface.spectrum
    tensors = surface_tensors(
        found.eigenvalues,
        found.eigenvectors,
        found.mass,
        surface.gradient,
        device=torch.device("cpu"),
    )
    layers = seeded_layers(7, 10, 6, 5, 3, seed=0)
    values = np.random.default_rng(0).standard_normal((len(part.vertices), 7)).astype(np.float32)
    with torch.no_grad():
        for name, parameter in layers.named_parameters():  # of norms these are ones and zeros
            if "norm" in name:
                parameter.add_(0.1 * torch.randn(6, generator=torch.Generator().manual_seed(1)))
        theirs = layers(torch.from_numpy(values), tensors).numpy()
    ours = diffusion_network(layers.arrays(), inputs=7)(values, surface)
    np.testing.assert_allclose(ours, theirs, atol=2e-5 * np.abs(theirs).max())  # 32 bits


def test_dropout_keeps_the_mean_and_follows_its_generator(blob):
    surface = surface_of(blob, spectrum(blob, 20))
    tensors = surface_tensors(
        surface.spectrum.eigenvalues,
        surface.spectrum.eigenvectors,
        surface.spectrum.mass,
        surface.gradient,
        device=torch.device("cpu"),
    )
    layers = seeded_layers(7, 10, 6, 5, 1, seed=0)
    values = torch.ones(len(blob.vertices), 7)
    with torch.no_grad():
        first, again, other = (
            layers(values, tensors, torch.Generator().manual_seed(seed)) for seed in (0, 0, 1)
        )
        plain = layers(values, tensors)
    assert (first == again).all()
    assert (first != other).any()
    assert (first != plain).any()
    assert (seeded_layers(7, 10, 6, 5, 1, seed=0).first.weight == layers.first.weight).all()
    assert (seeded_layers(7, 10, 6, 5, 1, seed=1).first.weight != layers.first.weight).any()
