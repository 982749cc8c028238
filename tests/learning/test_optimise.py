import numpy as np
import pytest

from esd.common import InputError
from esd.descriptors.recipe import Descriptor, Recipe
from esd.learning.presets import Training

torch = pytest.importorskip("torch", reason="training needs the extra `train`")
from esd.learning.optimise import adam_with_moments, descend  # noqa: E402
from esd.learning.train import train  # noqa: E402

TRAINING = Training(
    Recipe((Descriptor("hks", 12),), eigenpairs=20), hidden=(10,), outputs=4, steps=1500, batch=64
)


def test_checkpoints_of_other_trainings_are_refused(collection, tmp_path):
    path = tmp_path / "checkpoint"

    def stop(progress):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train(collection, TRAINING, checkpoint=path, on_progress=stop)
    with pytest.raises(InputError, match="belongs to another training"):
        train(collection, TRAINING, checkpoint=path, seed=1)
    path.write_bytes(path.read_bytes()[:50])
    with pytest.raises(InputError, match="is damaged"):
        train(collection, TRAINING, checkpoint=path)


def test_a_gradient_is_shortened_and_one_that_is_not_finite_is_not_followed():
    weight = torch.nn.Parameter(torch.zeros(2))
    optimiser = torch.optim.SGD([weight], lr=1.0)
    descend(optimiser, (weight * torch.tensor([3.0, 4.0])).sum(), rate=0.5, largest_norm=1.0)
    # a step of 0.5 along a gradient of length one
    np.testing.assert_allclose(weight.detach(), [-0.3, -0.4], rtol=1e-5)
    descend(optimiser, (weight * torch.inf).sum(), rate=0.5, largest_norm=1.0)
    np.testing.assert_allclose(weight.detach(), [-0.3, -0.4], rtol=1e-5)


def test_moments_exist_before_the_first_step_and_are_those_of_adam():
    networks = [torch.nn.Linear(3, 2) for _ in range(2)]
    networks[1].load_state_dict(networks[0].state_dict())
    ours = adam_with_moments(networks[0], rate=0.1)
    theirs = torch.optim.Adam(networks[1].parameters(), lr=0.1)
    assert set(ours.state) == set(networks[0].parameters())
    for _ in range(3):
        for network, optimiser in zip(networks, (ours, theirs), strict=True):
            descend(optimiser, network(torch.ones(3)).pow(2).sum(), rate=0.1)
    assert torch.equal(networks[0].weight, networks[1].weight)
    assert type(adam_with_moments(networks[0], rate=0.1, weight_decay=0.1)) is torch.optim.AdamW
