from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest

from esd.datasets.collection import Collection, Shape
from esd.datasets.perturb import PERTURBATIONS
from esd.experiments import noise
from esd.experiments.noisy_maps import mean_error
from esd.experiments.setting import Setting
from esd.mesh.mesh import Mesh
from esd.mesh.shapes import torus
from esd.spectral.cache import Cache

POINTS = 32 * 20


@contextmanager
def silent(what, total):
    yield lambda count: None


def bent(shift: float) -> Mesh:
    mesh = torus(32, 20)
    bend = 0.2 * np.sin(mesh.vertices[:, [1, 2, 0]] * 2 + np.arange(3))
    return Mesh(mesh.vertices + bend + shift, mesh.faces)


@pytest.fixture(scope="module")
def outcome_and_setting(tmp_path_factory):
    """The experiment on a shape and a copy of it elsewhere."""
    folder = tmp_path_factory.mktemp("noise")
    shapes = tuple(
        Shape(f"s{i}", f"s{i}", "t", lambda i=i: bent(i), lambda: np.arange(POINTS))
        for i in range(2)
    )
    collection = Collection("copies", shapes, ())
    patch = pytest.MonkeyPatch()
    patch.setattr(noise, "_QUICK_PAIRS", 1)
    # maps between parts, tested elsewhere, would take most of the time
    patch.setattr("esd.matching.match._fits", lambda _: True)
    patch.setattr(
        noise,
        "PERTURBATIONS",
        {name: replace(kind, levels=kind.levels[:2]) for name, kind in PERTURBATIONS.items()},
    )
    setting = Setting(
        training=collection,
        testing=collection,
        folder=folder,
        seed=0,
        quick=True,
        cache=Cache(folder / "spectra", 10**9),
        progress=silent,
    )
    yield noise.run(setting), setting
    patch.undo()


def test_a_copy_is_matched_without_error_and_a_disturbed_one_with_some(outcome_and_setting):
    outcome, _ = outcome_and_setting
    for model in noise.MODELS:
        clean, disturbed = outcome.series("positions", model)
        assert clean.errors.shape == (1, POINTS)
        assert mean_error(clean) < 0.5  # percent: hardly a vertex is elsewhere
        # the default finds a copy by where its surface lies, and a disturbed copy as well
        assert mean_error(disturbed) > mean_error(clean) or model == "default"
        assert (clean.confidence > 0).all()
        np.testing.assert_array_equal(clean.nearer, clean.errors)  # no mirrored truth is known
    assert outcome.series("positions", "default")[0].verdicts == ("good",)


def test_points_that_are_cut_off_have_no_error_and_no_counterpart(outcome_and_setting):
    outcome, _ = outcome_and_setting
    for name in noise.PARTIAL:
        maps = outcome.series(name, "default")[-1]
        gone = outcome.shown[name, maps.level].vertex_index < 0
        assert gone.any()
        np.testing.assert_array_equal(maps.present[0], ~gone)
        assert np.isnan(maps.errors[0, gone]).all()
        assert np.isfinite(maps.errors[0, ~gone]).all()
        assert np.isfinite(maps.reverse).all()
    assert np.isnan(outcome.series("flips", "default")[-1].reverse).all()


def test_what_is_finished_is_not_measured_again(outcome_and_setting, monkeypatch):
    outcome, setting = outcome_and_setting
    monkeypatch.setattr(noise, "_maps_of_pair", None)
    monkeypatch.setattr(noise, "errors_on_target", None)
    again = noise.run(setting)
    assert again.report == outcome.report
    with pytest.raises(TypeError):
        noise.run(replace(setting, seed=1))


def test_the_report_tells_errors_verdicts_and_counterparts(outcome_and_setting):
    outcome, _ = outcome_and_setting
    tables = {table.name: table for table in outcome.report.tables}
    assert len(tables["errors"].rows) == 2 * len(PERTURBATIONS)
    noisy = outcome.series("positions", "EHKS")[1]
    assert ("positions", noisy.level) == tables["errors"].rows[1][:2]
    assert tables["errors"].rows[1][3] == mean_error(noisy)
    assert tables["verdicts"].rows[0][-1] == "good 1"
    assert len(tables["thresholds"].rows) == 2 * 3 * len(noise.THRESHOLDS)
    assert "- Short circuits, from none to 0.005 (share of the faces): HKS from" in "".join(
        outcome.report.findings
    )


def test_figures_are_drawn(outcome_and_setting, tmp_path, monkeypatch):
    outcome, _ = outcome_and_setting
    figures = noise.figures(outcome)
    painted = {f"painted-{name.replace(' ', '-')}" for name in PERTURBATIONS}
    assert set(figures) == {"errors", "curves", "counterparts"} | painted
    for name in ("errors", "counterparts", "painted-cut"):
        figures[name].savefig(tmp_path / f"{name}.png")
        assert (tmp_path / f"{name}.png").stat().st_size > 5000
    lines = figures["curves"].axes[0].lines
    assert [line.get_label() for line in lines] == ["0", "0.2"]
    assert lines[0].get_ydata()[-1] == 100
