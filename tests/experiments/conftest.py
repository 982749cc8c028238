from contextlib import contextmanager
from types import SimpleNamespace

import numpy as np
import pytest

from esd.datasets.collection import Collection, Shape
from esd.experiments import architecture, costs, dimension, setting, table2
from esd.experiments.setting import Setting
from esd.mesh.mesh import Mesh
from esd.mesh.shapes import torus
from esd.spectral.cache import Cache


@contextmanager
def silent(what, total):
    yield lambda count: None


def bent(i):
    mesh = torus(24, 16)
    bend = np.sin(mesh.vertices[:, [1, 2, 0]] * (1 + 0.2 * i) + np.arange(3))
    return Mesh(mesh.vertices + 0.2 * bend, mesh.faces)


@pytest.fixture(scope="session")
def made(tmp_path_factory):
    """A setting of four subjects, whose trainings all experiments share."""
    pytest.importorskip("torch", reason="training needs the extra `train`")
    patch = pytest.MonkeyPatch()
    patch.setattr(setting, "_QUICK_STEPS", 30)
    patch.setattr(architecture, "_QUICK_STEPS", 3)
    patch.setattr(dimension, "_QUICK_PICKS", 20)
    shapes = tuple(
        Shape(f"s{i}_{j}", f"s{i}", "t", lambda i=i, j=j: bent(i + j / 2), lambda: np.arange(384))
        for i in range(4)
        for j in range(2)
    )
    whole = Collection("bent", shapes, ("s2", "s3"))
    folder = tmp_path_factory.mktemp("experiments")
    yield Setting(
        training=whole.of_subjects(["s0", "s1"]),
        testing=whole.of_subjects(["s2", "s3"]),
        folder=folder,
        seed=0,
        quick=True,
        cache=Cache(folder / "spectra", 10**9),
        progress=silent,
    )
    patch.undo()


@contextmanager
def in_this_process(processes, mp_context):
    """In place of a fresh process, which takes seconds to start."""
    yield SimpleNamespace(submit=lambda *work: SimpleNamespace(result=lambda: work[0](*work[1:])))


@pytest.fixture
def compared(made, monkeypatch):
    monkeypatch.setattr(table2, "_QUICK_STEPS", dict.fromkeys(table2.LEARNED.values(), 4))
    monkeypatch.setattr(costs, "ProcessPoolExecutor", in_this_process)
    return made


@pytest.fixture
def drawn(tmp_path):
    """Draws figures to files, and says their names."""

    def names(figures):
        for name, figure in figures.items():
            figure.savefig(tmp_path / f"{name}.png")
            assert (tmp_path / f"{name}.png").stat().st_size > 5000
        return set(figures)

    return names
