import csv
import json
import time
from contextlib import contextmanager
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from esd.common import InputError
from esd.datasets.collection import Collection, Shape
from esd.evaluation.errors import truth_of
from esd.experiments import (
    architecture,
    comparison,
    concatenation,
    costs,
    counting,
    dimension,
    scale,
    setting,
    table1,
    table2,
    transfer,
)
from esd.experiments.report import Report, Table, write_report
from esd.experiments.setting import Setting, fingerprint, provenance, shortened, trained
from esd.learning.model import raw_model
from esd.learning.presets import PRESETS
from esd.mesh.geometry import surface_area, vertex_areas
from esd.mesh.mesh import Mesh
from esd.mesh.shapes import torus
from esd.spectral.cache import Cache

pytest.importorskip("torch", reason="training needs the extra `train`")


@contextmanager
def silent(what, total):
    yield lambda count: None


def bent(i):
    mesh = torus(24, 16)
    bend = np.sin(mesh.vertices[:, [1, 2, 0]] * (1 + 0.2 * i) + np.arange(3))
    return Mesh(mesh.vertices + 0.2 * bend, mesh.faces)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A setting of four subjects, whose trainings all tests of this file share."""
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


def drawn(figures, folder):
    for name, figure in figures.items():
        figure.savefig(folder / f"{name}.png")
        assert (folder / f"{name}.png").stat().st_size > 5000
    return set(figures)


def test_a_shape_matches_its_copy_everywhere_and_a_wrong_truth_nowhere(made):
    source = made.testing.shapes[0]
    moved = replace(source, name="moved", mesh=lambda: Mesh(bent(2).vertices + 1, bent(2).faces))
    far = replace(moved, name="far", correspondence=lambda: np.roll(np.arange(384), 192))
    models = {"HKS": raw_model("hks"), "strict": replace(raw_model("hks"), margin=1e-300)}
    pairs = [(source, moved), (source, far)]
    raw, strict = counting.correct_matches(made, models, pairs, data="copies")
    assert raw.counts[0] == 384
    assert raw.shares[0] == raw.covered[0] == 1
    assert raw.counts[1] < 20
    assert (raw.covered <= 1).all()
    assert strict.counts[0] < 384  # rounding alone is beyond such a threshold


def test_true_signs_undo_arbitrary_ones(made):
    shape = made.testing.shapes[0]
    values = raw_model("gps").embed_mesh(shape.mesh())
    signs = np.where(np.arange(25) % 2, 1, -1)
    truth = truth_of(shape)
    ends = [counting.Embedded(truth, {"GPS": v, "signed": v}) for v in (values, values * signs)]
    models = {"GPS": raw_model("gps"), "signed": raw_model("gps")}
    found = counting._correct_on_target(ends[1], [ends[0]], models, ["signed"])
    assert found["signed", 0].all()
    assert found["GPS", 0].mean() < 0.5


def test_table1_counts_six_descriptors_and_goes_on(made, tmp_path, monkeypatch):
    outcome = table1.run(made)
    assert [m.name for m in outcome.matched] == ["GPS", "HKS", "WKS", "EGPS", "EHKS", "EWKS"]
    first = outcome.report.tables[0]
    assert first.rows[0][:2] == (outcome.pairs[0][0].name, outcome.pairs[0][1].name)
    assert first.rows[0][3] == outcome.matched[1].counts[0] > 0
    assert outcome.report.tables[1].rows[0][-1] == 706
    assert "in the paper, on Dyna, 19.78 times (1579 against 80 of 6890)" in "".join(
        outcome.report.findings
    )
    assert all({s.subject, t.subject} == {"s2", "s3"} for s, t in outcome.pairs)
    assert drawn(table1.figures(outcome), tmp_path) == {"matches", "counts"}
    # again: nothing is trained or matched anew
    monkeypatch.setattr(counting, "_correct_on_target", None)
    monkeypatch.setattr("esd.learning.train.train", None)
    assert table1.run(made).report == outcome.report


@contextmanager
def in_this_process(processes, mp_context):
    """In place of a fresh process, which takes seconds to start."""
    yield SimpleNamespace(submit=lambda *work: SimpleNamespace(result=lambda: work[0](*work[1:])))


@pytest.fixture
def compared(made, monkeypatch):
    monkeypatch.setattr(table2, "_QUICK_STEPS", dict.fromkeys(table2.LEARNED.values(), 4))
    monkeypatch.setattr(costs, "ProcessPoolExecutor", in_this_process)
    return made


def test_table2_compares_methods_on_ever_more_different_subjects(compared, tmp_path, monkeypatch):
    outcome = table2.run(compared)
    assert list(outcome.models) == ["HKS", *table2.LEARNED]
    assert len(outcome.groups) == 2
    same, other = outcome.groups
    # the smaller of the two subjects is the source of all pairs
    area = {s.subject: surface_area(s.mesh()) for s in compared.testing.shapes}
    smallest = min(area, key=area.get)
    assert same.subjects == f"{smallest}\\{smallest}"
    assert {s.subject for s, _ in other.pairs} == {smallest}
    assert {t.subject for _, t in other.pairs} == {"s2", "s3"} - {smallest}
    assert len(same.pairs) == 2  # all there are
    assert len(other.pairs) == 4
    assert 0 < same.disparity.mean() < other.disparity.mean()
    for group in outcome.groups:
        for method in outcome.models:
            assert [len(errors) for errors in group.errors[method]] == [38] * len(group.pairs)
            curve = group.curve(method)
            assert (np.diff(curve) >= 0).all()
            at_5_percent = curve[np.searchsorted(comparison.RADII, 0.05)]
            assert 100 * at_5_percent == pytest.approx(group.accuracies(method).mean())
    # trained on one subject, validated on the other, as HKS is not
    shapes = {tuple(model.card.get("shapes", ())) for model in outcome.models.values()}
    assert len(shapes) == 2
    tables = {table.name: table for table in outcome.report.tables}
    assert tables["paper_table2"].rows[3][-2:] == (10.12, 0.10)
    assert [row[0] for row in tables["costs"].rows] == list(outcome.models)
    assert all(row[1] > 0 for row in tables["costs"].rows)
    trained_by_steps = [name for name in outcome.models if name not in ("HKS", "OSD")]
    assert list(dict.fromkeys(row[0] for row in tables["training"].rows)) == trained_by_steps
    assert "mirrored" not in tables
    text = " ".join(outcome.report.findings)
    assert "nothing is excluded" in text
    assert "EHKS has 5.62 times the share of OSD, the best of the others" in text
    assert drawn(table2.figures(outcome), tmp_path) == {"curves", "matches", "training"}
    # again: nothing is trained, matched or measured anew
    monkeypatch.setattr(comparison, "_errors", None)
    monkeypatch.setattr(costs, "embedding_cost", None)
    monkeypatch.setattr("esd.learning.train.train", None)
    assert table2.run(compared).report == outcome.report


def test_table2_leaves_out_parts_and_takes_mirrored_matches(compared):
    parts = np.where(np.arange(384) < 96, "left hand", "torso")

    def known(collection):
        return replace(
            collection,
            shapes=tuple(
                replace(s, symmetric=lambda: np.roll(np.arange(384), 192), parts=lambda: parts)
                for s in collection.shapes
            ),
        )

    outcome = table2.run(replace(compared, testing=known(compared.testing)))
    assert "(25% of the points) are excluded" in " ".join(outcome.report.findings)
    assert outcome.report.tables[1].name == "mirrored"
    for group in outcome.groups:
        for method in outcome.models:
            assert not group.shown[method][:96].any()
            for direct, nearer in zip(group.errors[method], group.mirrored[method], strict=True):
                assert len(direct) == 29  # a tenth of the 288 that are left
                assert (nearer <= direct).all()
    assert any((g.mirrored["HKS"][0] < g.errors["HKS"][0]).any() for g in outcome.groups)


def test_points_are_sampled_by_area_and_disparity_is_none_without_change(made):
    shape = made.testing.shapes[0]
    larger = replace(shape, mesh=lambda: Mesh(3 * shape.mesh().vertices + 1, shape.mesh().faces))
    assert comparison._disparity(truth_of(shape), truth_of(larger)) == pytest.approx(0, abs=1e-9)
    areas = vertex_areas(shape.mesh())
    draws = [comparison._sampled(shape, shape, None, (0, i)) for i in range(200)]
    assert all(len(np.unique(draw)) == 38 for draw in draws)
    large = areas > np.median(areas)
    # half of the vertices; without replacement a little less than their share of the area
    share = np.mean([large[draw].mean() for draw in draws])
    assert share == pytest.approx(areas[large].sum() / areas.sum(), abs=0.03)


def test_table2_needs_subjects_that_correspond(made):
    with pytest.raises(InputError, match="two subjects or more to train on and to test on; got 1"):
        table2.run(replace(made, training=made.training.of_subjects(["s0"])))
    shapes = made.testing.shapes
    foreign = tuple(replace(s, template="x") if s.subject == "s3" else s for s in shapes)
    with pytest.raises(InputError, match=r"No shapes of 's.' and 's.' correspond"):
        comparison.drawn_groups(replace(made, testing=replace(made.testing, shapes=foreign)))


def test_processor_time_of_a_resumed_training_is_that_of_all_its_steps():
    assert setting._cpu_seconds([(0, 5.0), (100, 7.0), (200, 9.0)]) == 4
    assert setting._cpu_seconds([(0, 5.0), (300, 5.5), (400, 7.5)]) == 8  # from step 200 on
    assert setting._cpu_seconds([(0, 5.0), (100, 7.0)]) == 2
    assert 0 <= setting._cpu_seconds([(0, time.process_time())]) < 1


def test_other_data_are_trained_on_anew(made, monkeypatch):
    monkeypatch.setattr("esd.learning.train.train", None)
    training = setting.paper_training("hks", quick=True)
    other = replace(made, training=made.testing)
    assert fingerprint(made.training) != fingerprint(made.testing)
    with pytest.raises(TypeError):
        trained(other, "EHKS", training)


def test_short_trainings_end_at_the_same_learning_rate():
    whole = PRESETS["paper-hks"]
    short = shortened(whole, 100)
    assert short.steps == 100
    assert short.decay**short.steps == pytest.approx(whole.decay**whole.steps)


def test_architecture_trains_every_network_of_the_grid(made, tmp_path, monkeypatch):
    assert len(architecture.grid("hks", depth=2, step=2)) == 946
    for kind, chosen in architecture.CHOSEN.items():
        assert chosen in architecture.grid(kind, depth=2, step=2)
    outcome = architecture.run(made)
    trials = {(t.kind, t.hidden, t.seed): t for t in outcome.trials}
    assert len(trials) == len(outcome.trials)
    for kind in ("gps", "hks", "wks"):
        for depth, step in ((1, 16), (2, 16), (3, 32)):
            for hidden in architecture.grid(kind, depth=depth, step=2 if kind == "gps" else step):
                assert (kind, hidden, 0) in trials
        of_depth = [t for t in outcome.trials if (t.kind, len(t.hidden), t.seed) == (kind, 2, 0)]
        lowest = architecture.best(outcome.trials, kind, depth=2)
        assert lowest.testing.loss_mean == min(t.testing.loss_mean for t in of_depth)
    assert drawn(architecture.figures(outcome), tmp_path) == {"architecture", "depth"}
    monkeypatch.setattr("esd.learning.architecture.train_many", None)
    assert architecture.run(made).trials == outcome.trials


def test_dimension_of_noise_is_that_of_its_neighbourhood(made, tmp_path):
    outcome = dimension.run(made)
    rows = {row[0]: row[1:] for row in outcome.report.tables[0].rows}
    assert rows["noise"][:2] == (5, 9)
    assert max(rows["HKS"]) < 10
    assert drawn(dimension.figures(outcome), tmp_path) == {"dimension"}


def test_concatenation_is_compared_with_its_parts(made, tmp_path):
    outcome = concatenation.run(made)
    assert [m.name for m in outcome.matched][3:] == ["GPS+HKS+WKS", "GPS+HKS+WKS, wide"]
    best = max(outcome.matched[:3], key=lambda m: m.counts.mean()).name
    assert outcome.report.tables[0].rows[3][7] == best
    assert drawn(concatenation.figures(outcome), tmp_path) == {"counts"}


def test_unit_area_removes_the_scale(made, tmp_path):
    outcome = scale.run(made)
    same, far = scale.FACTORS.index(1.0), scale.FACTORS.index(2.0)
    for name, shares in outcome.shares.items():
        if "unit area" in name or name.startswith("GPS"):
            # rounding may turn a match or two of 384
            np.testing.assert_allclose(shares, shares[same], atol=0.6)
    assert outcome.shares["HKS, own size"][far] < 0.5 * outcome.shares["HKS, own size"][same]
    assert drawn(scale.figures(outcome), tmp_path) == {"scale"}


def test_transfer_is_a_matrix(made, tmp_path):
    def renamed(collection):
        return replace(collection, name="other")

    other = replace(made, training=renamed(made.testing), testing=renamed(made.training))
    outcome = transfer.run(made, other)
    assert outcome.collections == ("bent", "other")
    assert len(outcome.shares) == 3 * 3 * 2
    assert outcome.shares["hks", "bent", "bent"] == pytest.approx(
        100 * table1.run(made).matched[4].shares.mean()
    )
    assert drawn(transfer.figures(outcome), tmp_path) == {"transfer"}
    with pytest.raises(InputError, match="must have different names; got bent, bent"):
        transfer.run(made, made)


def test_reports_hold_tables_figures_and_how_they_were_made(made, tmp_path):
    table = Table("numbers", "Some numbers", ("a", "b"), ((1, 0.123456), ("x", None)))
    hidden = Table("more", "More", ("c",), ((2,),), shown=False)
    report = Report("Title", ("A finding.",), (table, hidden))
    facts = {"Command": "`esd`", **provenance([made])}
    write_report(report, tmp_path, facts=facts, figures=["picture"])
    text = (tmp_path / "report.md").read_text()
    for part in ("# Title", "A finding.", "| 1 | 0.1235 |", "| x |  |", "![picture](picture.png)"):
        assert part in text
    assert "4 shapes of s2, s3" in text
    assert "esd 0." in text
    assert "| c |" not in text
    with (tmp_path / "numbers.csv").open(newline="") as file:
        assert list(csv.reader(file)) == [["a", "b"], ["1", "0.123456"], ["x", ""]]
    assert json.dumps(provenance([made]))
