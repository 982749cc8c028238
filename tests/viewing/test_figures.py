import numpy as np
import pytest

from esd.common import InputError
from esd.evaluation.protocol import PairErrors
from esd.matching.correspondence import Correspondence
from esd.mesh.shapes import icosphere

figures = pytest.importorskip("esd.viewing.figures", reason="matplotlib is not installed")


def drawn(figure) -> np.ndarray:
    """The figure as pixels, (height, width, 3)."""
    figure.canvas.draw()
    return np.asarray(figure.canvas.buffer_rgba())[:, :, :3].astype(int)


@pytest.mark.parametrize("suffix", ["png", "pdf"])
def test_figures_are_written(tmp_path, suffix):
    sphere = icosphere(2)
    count = len(sphere.vertices)
    match = Correspondence(np.arange(count), np.zeros(count), np.ones(count))
    path = tmp_path / f"f.{suffix}"
    figures.save_figure(figures.match_figure(sphere, sphere, match), path)
    assert path.read_bytes()[:4] == {"png": b"\x89PNG", "pdf": b"%PDF"}[suffix]


def test_both_shapes_of_the_identity_look_alike():
    sphere = icosphere(3)
    count = len(sphere.vertices)
    match = Correspondence(np.arange(count), np.zeros(count), np.ones(count))
    picture = drawn(figures.match_figure(sphere, sphere, match))
    left, right = picture[100:, :400], picture[100:, 400:]
    painted = [side[np.ptp(side, axis=2) > 30] for side in (left, right)]
    assert len(painted[0]) > 10_000
    np.testing.assert_allclose(painted[0].mean(axis=0), painted[1].mean(axis=0), atol=3)


def test_values_are_drawn_on_the_side_where_they_are():
    sphere = icosphere(3)
    values = np.where(sphere.vertices[:, 0] > 0, 1.0, np.nan)  # grey on the left
    picture = drawn(figures.values_figure(sphere, {"half": values}, largest=2.0))
    coloured = np.ptp(picture, axis=2) > 60
    ball = coloured[:, :300]
    columns = np.flatnonzero(ball.any(axis=0))
    grey = (np.ptp(picture, axis=2) < 20) & (picture[:, :, 0] < 200)
    assert grey[200:400, : columns.min()].sum() > 1000
    assert ball.sum() > 1000


def test_curves_end_at_the_share_within_reach():
    errors = {"a": np.array([0.0, 0.1, 0.2, np.nan]), "b": np.zeros(4)}
    figure = figures.curves_figure(errors)
    ends = [line.get_ydata()[-1] for line in figure.axes[0].lines]
    assert ends == [75, 100]
    assert len({line.get_color() for line in figure.axes[0].lines}) == 2


def test_curves_of_models_are_means_over_pairs_with_both_normalisers():
    pairs = [
        PairErrors(
            source="a",
            target="b",
            errors=np.array(errors),
            symmetric_errors=None,
            confidence=np.ones(len(errors)),
            square_root_area=1.0,
            diameter=2.0,
            coverage=1.0,
            lone_confidence=np.zeros(0),
            lone_matched=np.zeros(0, dtype=bool),
        )
        for errors in ([0.0, 0.1], [0.3, 0.3, 0.5, np.nan])
    ]
    figure = figures.errors_figure({"m": pairs, "n": pairs[:1]})
    assert [axes.get_xlabel() for axes in figure.axes] == [
        "geodesic error / √area",
        "geodesic error / geodesic diameter",
    ]
    left, right = ([line.get_ydata() for line in axes.lines] for axes in figure.axes)
    assert (left[0][-1], right[0][-1]) == (50, 75)  # means of 100 and 0, and of 100 and 50
    assert right[1][50] == 100  # 0.1 is within 0.05 of the diameter
    labels = [line.get_label() for axes in figure.axes for line in axes.lines]
    assert labels == ["m (AUC 0.400)", "n (AUC 0.800)", "m (AUC 0.500)", "n (AUC 0.875)"]
    for axes, curves in zip(figure.axes, (left, right), strict=True):
        for line, curve in zip(axes.lines, curves, strict=True):  # the area is that of the curve
            area = float(line.get_label().split()[-1][:-1])
            assert curve.mean() / 100 == pytest.approx(area, abs=0.01)  # 201 radii


def test_what_cannot_be_drawn_is_refused():
    sphere = icosphere(1)
    with pytest.raises(InputError, match="`up` must be 'y' or 'z'; got 'x'"):
        figures.values_figure(sphere, {"a": np.zeros(42)}, up="x")
    with pytest.raises(InputError, match="no values to draw"):
        figures.values_figure(sphere, {})
    with pytest.raises(InputError, match=r"'a' must have shape \(42,\)"):
        figures.values_figure(sphere, {"a": np.zeros(3)})
    with pytest.raises(InputError, match="no errors to draw"):
        figures.curves_figure({})
    with pytest.raises(InputError, match="no errors to draw"):
        figures.errors_figure({})
