import numpy as np

from esd.experiments.counting import CorrectMatches
from esd.experiments.pictures import counts_figure, matches_figure
from esd.viewing.colours import UNMATCHED


def test_boxes_hold_counts_and_covered_area():
    right = (np.array([True, False, True]), np.array([True, True, True]))
    matched = [
        CorrectMatches(name, right, np.array([0.25, 0.75])) for name in ("GPS", "HKS", "WKS")
    ]
    left, covered = counts_figure(matched).axes
    assert [label.get_text() for label in left.get_xticklabels()] == ["GPS", "HKS", "WKS"]
    assert {tuple(line.get_ydata()) for line in left.lines if len(line.get_ydata()) == 2} >= {
        (2.5, 2.5)  # the median of two and three matches
    }
    assert (50.0, 50.0) in {tuple(line.get_ydata()) for line in covered.lines}


def test_what_is_wrong_is_grey_on_both_shapes(made, monkeypatch):
    shown = []
    monkeypatch.setattr(
        "esd.experiments.pictures.draw_mesh", lambda axes, mesh, colours, up: shown.append(colours)
    )
    pair = made.testing.shapes[0], made.testing.shapes[2]
    right = np.arange(384) < 100
    figure = matches_figure([(pair, {"all": np.ones(384, dtype=bool), "some": right})])
    assert [cell.get_suptitle() for cell in figure.subfigs] == ["all", "some"]
    assert len(shown) == 4
    for colours, count in zip(shown, (384, 384, 100, 100), strict=True):
        assert (colours != UNMATCHED).any(axis=1).sum() == count
