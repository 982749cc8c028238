"""Pairs of increasingly different subjects, and how several methods match them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from esd.common import BoolArray, FloatArray, InputError, IntArray
from esd.datasets.collection import Shape
from esd.evaluation.errors import NEAR, Truth, cumulative_curve, errors_on_target
from esd.experiments.counting import Embedded, embedder, models_key
from esd.experiments.setting import Setting, fingerprint
from esd.learning.model import Model
from esd.mesh.geodesics import geodesic_graph
from esd.mesh.geometry import surface_area, vertex_areas
from esd.mesh.mesh import Mesh
from esd.nearest import nearest
from esd.spectral.cache import Arrays, content_key

RADII = np.linspace(0, 0.2, 81)
"""Of the curves, as shares of the target's geodesic diameter."""

_PAIRS, _QUICK_PAIRS = 10, 5

_SHARE = 0.1  # of the vertices

LANDMARKS = 40  # between which distances are compared

_MIRRORED = "mirrored "


@dataclass(frozen=True, slots=True, eq=False)
class Group:
    """Pairs of the shapes of two subjects, and how each method matches them.

    Parameters
    ----------
    pairs
        Source and target.
    disparity : (pairs,)
        See `_disparity`.
    errors : for each method, for each pair (p,)
        Geodesic error at the sampled points over the target's geodesic diameter; infinite where it
        is larger than the last of `RADII`.
    mirrored
        The same to the nearer of the true vertex and its mirror image; empty where unknown.
    shown : for each method (points,)
        Which points of the template the first pair has right, among all that are not excluded.
    """

    pairs: tuple[tuple[Shape, Shape], ...]
    disparity: FloatArray
    errors: Mapping[str, tuple[FloatArray, ...]]
    mirrored: Mapping[str, tuple[FloatArray, ...]]
    shown: Mapping[str, BoolArray]

    @property
    def subjects(self) -> str:
        """Of the sources and of the targets."""
        source, target = self.pairs[0]
        return f"{source.subject}\\{target.subject}"

    def accuracies(self, method: str) -> FloatArray:
        """Share of the sampled points within 5 % of the diameter, in percent, (pairs,)."""
        return percent_right(self.errors[method])

    def curve(self, method: str) -> FloatArray:
        """Mean over pairs of the share of points within each of `RADII`."""
        return np.mean([cumulative_curve(e, RADII) for e in self.errors[method]], axis=0)


def matched_groups(
    setting: Setting, models: Mapping[str, Model], excluded: BoolArray | None
) -> tuple[Group, ...]:
    """Groups of pairs of unseen shapes, of one subject first, then by rising disparity.

    Pairs are kept as soon as they are measured.

    Parameters
    ----------
    excluded : (points,)
        Points of the template that are left out, if any are.
    """
    key = content_key(
        "compared",
        *(truth() for s in setting.testing.shapes if (truth := s.symmetric) is not None),
        np.zeros(0) if excluded is None else excluded,
        models=models_key(models),
        data=fingerprint(setting.testing),
        seed=setting.seed,
    )
    drawn = drawn_groups(setting)
    embedded = embedder(setting, models)
    groups = []
    with setting.progress("matching", sum(map(len, drawn))) as advance:
        for pairs in drawn:
            found: list[Arrays] = []
            for place, (source, target) in enumerate(pairs):

                def compute(
                    source: Shape = source, target: Shape = target, place: int = place
                ) -> Arrays:
                    seed = (setting.seed, place)
                    points = _sampled(source, target, excluded, seed)
                    return _errors(embedded(source), embedded(target), points)

                part = content_key(
                    "pair", key=key, source=source.name, target=target.name, place=place
                )
                found.append(setting.store.computed(part, compute))
                advance(1)
            source, target = pairs[0]

            def show(source: Shape = source, target: Shape = target) -> Arrays:
                points = np.flatnonzero(_comparable(source, target, excluded))
                errors = _errors(embedded(source), embedded(target), points, limit=NEAR)
                right = np.zeros((len(models), len(source.correspondence())), dtype=bool)
                right[:, points] = [errors[name] <= NEAR for name in models]
                return dict(zip(models, right, strict=True))

            part = content_key("shown", key=key, source=source.name, target=target.name)
            groups.append(
                Group(
                    pairs,
                    np.array([float(each["disparity"]) for each in found]),
                    {name: tuple(each[name] for each in found) for name in models},
                    {
                        name: tuple(each[_MIRRORED + name] for each in found)
                        for name in models
                        if target.symmetric is not None
                    },
                    setting.store.computed(part, show),
                )
            )
    return (groups[0], *sorted(groups[1:], key=lambda group: float(group.disparity.mean())))


def drawn_groups(setting: Setting) -> list[tuple[tuple[Shape, Shape], ...]]:
    """Pairs of each group, that of one subject first, the others in no order."""
    subjects = setting.testing.subjects
    shapes = {name: setting.testing.of_subjects([name]).shapes for name in subjects}
    areas = {
        name: np.mean([surface_area(shape.mesh()) for shape in of_one])
        for name, of_one in shapes.items()
    }
    source = min(subjects, key=lambda name: areas[name])
    generator = np.random.default_rng(setting.seed)
    groups = []
    for target in (source, *(name for name in subjects if name != source)):
        every = [
            (first, second)
            for first, second in product(shapes[source], shapes[target])
            if first.name != second.name and first.template == second.template
        ]
        if not every:
            raise InputError(f"No shapes of '{source}' and '{target}' correspond, or there is one.")
        order = generator.permutation(len(every))[: _QUICK_PAIRS if setting.quick else _PAIRS]
        groups.append(tuple(every[i] for i in order))
    return groups


def _comparable(source: Shape, target: Shape, excluded: BoolArray | None) -> BoolArray:
    both = (source.correspondence() >= 0) & (target.correspondence() >= 0)
    return both if excluded is None else both & ~excluded


def _sampled(
    source: Shape, target: Shape, excluded: BoolArray | None, seed: tuple[int, ...]
) -> IntArray:
    """Points of the template at a tenth of the source's vertices, drawn by their area."""
    points = np.flatnonzero(_comparable(source, target, excluded))
    vertices, first = np.unique(source.correspondence()[points], return_index=True)
    area = vertex_areas(source.mesh())[vertices]
    count = max(1, round(_SHARE * len(vertices)))
    chosen = np.random.default_rng(seed).choice(
        len(vertices), size=count, replace=False, p=area / area.sum()
    )
    return points[first[chosen]]


def _errors(
    source: Embedded,
    target: Embedded,
    points: IntArray,
    *,
    limit: float = RADII[-1],
) -> Arrays:
    """Errors (p,) of each method over the diameter, infinite beyond a limit; and the disparity."""
    truth = Truth(
        target.truth.mesh,
        target.truth.index[points],
        None if target.truth.symmetric is None else target.truth.symmetric[points],
    )
    vertices = source.truth.index[points]
    predicted = [
        nearest(values[vertices], target.values[name])[0] for name, values in source.values.items()
    ]
    errors = errors_on_target(truth, np.stack(predicted), limit=limit)
    result: Arrays = {"disparity": np.array(_disparity(source.truth, target.truth))}
    for i, name in enumerate(source.values):
        result[name] = errors.direct[i] / errors.diameter
        result[_MIRRORED + name] = errors.nearer[i] / errors.diameter
    return result


def _disparity(source: Truth, target: Truth) -> float:
    """Mean difference of the geodesic distances between 40 points, over their mean, in percent.

    Distances are over √area, as descriptors see shapes.
    """
    points = np.flatnonzero((source.index >= 0) & (target.index >= 0))
    points = np.random.default_rng(0).permutation(points)[:LANDMARKS]
    first, second = (_distances(shape.mesh, shape.index[points]) for shape in (source, target))
    known = np.isfinite(first) & np.isfinite(second)
    return 200 * float(np.abs(first - second)[known].sum() / (first + second)[known].sum())


def _distances(mesh: Mesh, vertices: IntArray) -> FloatArray:
    return geodesic_graph(mesh).distances(vertices)[:, vertices] / surface_area(mesh) ** 0.5


def percent_right(errors: Sequence[FloatArray]) -> FloatArray:
    """Share of the errors over the diameter that are at most 5 %, in percent, (pairs,)."""
    return np.array([100 * float((error <= NEAR).mean()) for error in errors])
