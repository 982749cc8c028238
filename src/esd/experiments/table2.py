"""The embedding beside other learned descriptors (table 2 and figures 7 and 8 of the paper)."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from itertools import product
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from esd.common import BoolArray, FloatArray, InputError, IntArray
from esd.datasets.collection import Collection, Shape
from esd.datasets.splits import sample_by_subject, split_by_subject
from esd.evaluation.errors import cumulative_curve, geodesic_errors
from esd.experiments.counting import NEAR, Embedded, embedder, models_key
from esd.experiments.paper import TABLE2
from esd.experiments.report import Report, Table
from esd.experiments.setting import Setting, fingerprint, shortened, trained
from esd.learning.model import Model, raw_model
from esd.learning.presets import PRESETS, Training
from esd.mesh.geodesics import geodesic_diameter, geodesic_graph
from esd.mesh.geometry import surface_area, vertex_areas
from esd.mesh.mesh import Mesh
from esd.nearest import nearest
from esd.spectral.cache import Arrays, content_key

RADII = np.linspace(0, 0.2, 81)
"""Of the curves, as shares of the target's geodesic diameter."""

LEARNED = {
    "OSD": "osd",
    "GCNN": "gcnn",
    "ACNN": "acnn",
    "EHKS": "paper-hks",
    "oriented": "oriented",
}
"""Presets by the names that they have in tables; the last is not in the paper."""

TRAINING_SUBJECTS, TESTING_SUBJECTS = 6, 4
"""Numbers of subjects in the paper's comparison."""

_PAIRS, _QUICK_PAIRS = 10, 5
_QUICK_POSES = 2
_QUICK_STEPS = {"osd": 40, "gcnn": 300, "acnn": 150, "paper-hks": 1000, "oriented": 300}
_QUICK_LOOKS = 5
_SHARE = 0.1  # of the vertices
_EXCLUDED = ("head", "hand", "foot")
_LANDMARKS = 40  # between which distances are compared
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
        return _within(self.errors[method])

    def curve(self, method: str) -> FloatArray:
        """Mean over pairs of the share of points within each of `RADII`."""
        return np.mean([cumulative_curve(e, RADII) for e in self.errors[method]], axis=0)


@dataclass(frozen=True, slots=True)
class Table2Outcome:
    """Groups from one subject alone to the most different two; and how the methods came about."""

    groups: tuple[Group, ...]
    models: Mapping[str, Model]
    report: Report


def run(setting: Setting) -> Table2Outcome:
    """Match pairs of ever more different subjects by nearest neighbours in each descriptor.

    As in the paper, ten pairs in each of four groups, all with sources of the testing subject with
    the smallest area: targets of the same subject, and of the others in the order of their
    disparity, which is measured. A tenth of the vertices is matched, drawn evenly over the
    surface, without head, hands and feet; nothing is rejected.

    Raises
    ------
    InputError
        If there are fewer than two subjects to train on or to test on.
    """
    if len(setting.training.subjects) < 2 or len(setting.testing.subjects) < 2:
        raise InputError(
            "The comparison needs two subjects or more to train on and to test on; got "
            f"{len(setting.training.subjects)} and {len(setting.testing.subjects)}."
        )
    seen, held = split_by_subject(
        setting.training, held_out=max(1, len(setting.training.subjects) // 3), seed=setting.seed
    )
    if setting.quick:
        seen, held = (sample_by_subject(part, _QUICK_POSES) for part in (seen, held))
    learning = replace(setting, training=seen)
    models = {"HKS": raw_model("hks")}
    for name, preset in LEARNED.items():
        training = _training(preset, quick=setting.quick)
        models[name] = trained(learning, name, training, validation=held)
    excluded = _excluded(setting)
    groups = _groups(setting, models, excluded)
    costs = _costs(setting, models)
    return Table2Outcome(groups, models, _report(groups, models, costs, seen, held, excluded))


def _training(preset: str, *, quick: bool) -> Training:
    """A preset on the given shapes alone, as all methods; in few steps to be quick."""
    training = replace(PRESETS[preset], remeshings=0)
    if not quick:
        return training
    short = shortened(training, _QUICK_STEPS[preset])
    return replace(short, validate_every=max(1, short.steps // _QUICK_LOOKS))


def _excluded(setting: Setting) -> BoolArray | None:
    """Which points of the template are of head, hands and feet; None where no parts are known."""
    for shape in (*setting.testing.shapes, *setting.training.shapes):
        if shape.parts is not None:
            return np.array([any(part in name for part in _EXCLUDED) for name in shape.parts()])
    return None


def _groups(
    setting: Setting, models: Mapping[str, Model], excluded: BoolArray | None
) -> tuple[Group, ...]:
    key = content_key(
        "compared",
        *(truth() for s in setting.testing.shapes if (truth := s.symmetric) is not None),
        np.zeros(0) if excluded is None else excluded,
        models=models_key(models),
        data=fingerprint(setting.testing),
        seed=setting.seed,
    )
    drawn = _drawn(setting)
    seen = embedder(setting, models)
    groups = []
    with setting.progress("matching", sum(map(len, drawn))) as went:
        for pairs in drawn:
            found: list[Arrays] = []
            for place, (source, target) in enumerate(pairs):

                def compute(
                    source: Shape = source, target: Shape = target, place: int = place
                ) -> Arrays:
                    seed = (setting.seed, place)
                    points = _sampled(source, target, excluded, seed)
                    return _errors(seen(source), seen(target), points)

                part = content_key(
                    "pair", key=key, source=source.name, target=target.name, place=place
                )
                found.append(setting.store.computed(part, compute))
                went(1)
            source, target = pairs[0]

            def show(source: Shape = source, target: Shape = target) -> Arrays:
                points = np.flatnonzero(_comparable(source, target, excluded))
                errors = _errors(seen(source), seen(target), points, limit=NEAR)
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


def _drawn(setting: Setting) -> list[tuple[tuple[Shape, Shape], ...]]:
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
    mesh = target.shape.mesh()
    graph = geodesic_graph(mesh)
    diameter = geodesic_diameter(mesh, graph=graph)
    vertices = source.index[points]
    predicted = [
        nearest(values[vertices], target.values[name])[0] for name, values in source.values.items()
    ]
    truths = [target.index[points]]
    if target.shape.symmetric is not None:
        truths.append(target.shape.symmetric()[points])
    errors = geodesic_errors(
        graph,
        np.concatenate(predicted),
        tuple(np.tile(truth, len(predicted)) for truth in truths),
        limit=limit * diameter,
    )
    result: Arrays = {"disparity": np.array(_disparity(source.shape, target.shape))}
    for prefix, error in zip(("", _MIRRORED), (errors[0], np.fmin.reduce(errors)), strict=True):
        split = np.split(error / diameter, len(predicted))
        result |= {f"{prefix}{name}": part for name, part in zip(source.values, split, strict=True)}
    return result


def _disparity(source: Shape, target: Shape) -> float:
    """Mean difference of the geodesic distances between 40 points, over their mean, in percent.

    Distances are over √area, as descriptors see shapes.
    """
    points = np.flatnonzero(_comparable(source, target, None))
    points = np.random.default_rng(0).permutation(points)[:_LANDMARKS]
    first, second = (
        _distances(shape.mesh(), shape.correspondence()[points]) for shape in (source, target)
    )
    known = np.isfinite(first) & np.isfinite(second)
    return 200 * float(np.abs(first - second)[known].sum() / (first + second)[known].sum())


def _distances(mesh: Mesh, vertices: IntArray) -> FloatArray:
    return geodesic_graph(mesh).distances(vertices)[:, vertices] / surface_area(mesh) ** 0.5


def _within(errors: Sequence[FloatArray]) -> FloatArray:
    return np.array([100 * float((error <= NEAR).mean()) for error in errors])


@dataclass(frozen=True, slots=True)
class _Cost:
    """Of describing one shape: processor time in seconds, and memory in MB (None: not known)."""

    seconds: float
    megabytes: float | None


def _costs(setting: Setting, models: Mapping[str, Model]) -> dict[str, _Cost]:
    """What each method takes to describe a shape, its spectrum included, in a fresh process."""
    mesh = setting.testing.shapes[0].mesh()
    costs = {}
    with setting.progress("measuring costs", len(models)) as went:
        for name, model in models.items():

            def compute(model: Model = model) -> Arrays:
                with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as fresh:
                    seconds, megabytes = fresh.submit(_described_cost, model, mesh).result()
                return {"seconds": np.array(seconds), "megabytes": np.array(megabytes)}

            key = content_key("cost", mesh.vertices, model=models_key({name: model}))
            found = setting.store.computed(key, compute)
            memory = float(found["megabytes"])
            costs[name] = _Cost(float(found["seconds"]), memory if memory > 0 else None)
            went(1)
    return costs


def _described_cost(model: Model, mesh: Mesh) -> tuple[float, float]:
    """Processor time in seconds, the less of two, and the largest memory of this process in MB."""
    seconds = []
    for _ in range(2):
        start = time.process_time()
        model.embed_mesh(mesh)
        seconds.append(time.process_time() - start)
    # not by `resource`, where a new process begins with the memory of the one that started it
    status = Path("/proc/self/status")
    if not status.is_file():
        return min(seconds), 0.0  # known on Linux alone
    peak = status.read_text().split("VmHWM:")[1].split()[0]
    return min(seconds), int(peak) / 1000


def _report(
    groups: Sequence[Group],
    models: Mapping[str, Model],
    costs: Mapping[str, _Cost],
    seen: Collection,
    held: Collection,
    excluded: BoolArray | None,
) -> Report:
    points = int(np.mean([len(errors) for group in groups for errors in group.errors["HKS"]]))
    without = (
        "No parts of the body are known of these shapes, so that nothing is excluded"
        if excluded is None
        else f"Heads, hands and feet ({excluded.mean():.0%} of the points) are excluded"
    )
    tables = [
        _accuracy_table("table2", "Share of correct matches", groups, models, mirrored=False),
        TABLE2,
        _pairs_table(groups, models),
        _curves_table(groups, models),
        _costs_table(models, costs),
        _training_table(models),
    ]
    if groups[0].mirrored:
        caption = "The same where the mirror image of the true vertex counts as correct, too"
        tables.insert(1, _accuracy_table("mirrored", caption, groups, models, mirrored=True))
    return Report(
        "The embedding beside other learned descriptors (table 2)",
        (
            f"{len(groups[0].pairs)} pairs a group, {points} points a pair: a tenth of the "
            f"source's vertices that have a counterpart, drawn by area. {without}. Each is mapped "
            "to the nearest vertex in each descriptor; nothing is rejected or refined. A match is "
            "correct within 5 % of the geodesic diameter. The disparity of two shapes is the mean "
            f"difference of the geodesic distances between {_LANDMARKS} points, as a share of "
            "their mean, both for unit area; RSD is the standard deviation over pairs over the "
            "mean.",
            f"All methods were trained on the same {len(seen.shapes)} shapes of "
            f"{', '.join(seen.subjects)}, until the loss on {len(held.shapes)} shapes of "
            f"{', '.join(held.subjects)} had stopped falling or the preset's steps were done; the "
            "weights are those with the lowest. `oriented` is not in the paper: it is this "
            "package's default recipe, here without its remeshed copies of the training shapes.",
            _finding(groups, models, costs),
        ),
        tuple(tables),
    )


def _accuracy_table(
    name: str, caption: str, groups: Sequence[Group], models: Mapping[str, Model], *, mirrored: bool
) -> Table:
    rows = []
    for number, group in enumerate(groups, start=1):
        errors = group.mirrored if mirrored else group.errors
        shares = [_within(errors[method]) for method in models]
        cells = [cell for share in shares for cell in (float(share.mean()), _deviation(share))]
        rows.append((number, group.subjects, float(group.disparity.mean()), *cells))
    return Table(
        name,
        f"{caption}: means over pairs in percent, and RSD",
        (
            "group",
            "subjects",
            "disparity %",
            *(f"{method} {what}" for method in models for what in ("%", "RSD")),
        ),
        tuple(rows),
    )


def _deviation(shares: FloatArray) -> float | None:
    """Standard deviation over mean; None where there is none."""
    return float(np.std(shares, ddof=1) / shares.mean()) if shares.mean() > 0 else None


def _pairs_table(groups: Sequence[Group], models: Mapping[str, Model]) -> Table:
    rows = [
        (
            number,
            source.name,
            target.name,
            float(group.disparity[i]),
            len(group.errors["HKS"][i]),
            *(float(group.accuracies(method)[i]) for method in models),
        )
        for number, group in enumerate(groups, start=1)
        for i, (source, target) in enumerate(group.pairs)
    ]
    header = ("group", "source", "target", "disparity %", "points", *(f"{m} %" for m in models))
    return Table("pairs", "Share of correct matches of each pair", header, tuple(rows), shown=False)


def _curves_table(groups: Sequence[Group], models: Mapping[str, Model]) -> Table:
    rows = []
    for number, group in enumerate(groups, start=1):
        curves = [100 * group.curve(method) for method in models]
        rows += [
            (number, float(100 * radius), *(float(curve[i]) for curve in curves))
            for i, radius in enumerate(RADII)
        ]
    return Table(
        "curves",
        "Share of points within an error in percent of the diameter",
        ("group", "error %", *(f"{method} %" for method in models)),
        tuple(rows),
        shown=False,
    )


def _costs_table(models: Mapping[str, Model], costs: Mapping[str, _Cost]) -> Table:
    rows = []
    for name, model in models.items():
        curve = training_curve(model)
        best = min(curve, key=lambda look: look[2])[0] if curve else None
        seconds = model.card.get("training_cpu_seconds")
        rows.append(
            (
                name,
                costs[name].seconds,
                costs[name].seconds / costs["EHKS"].seconds,
                costs[name].megabytes,
                seconds,
                None if seconds is None else seconds / models["EHKS"].card["training_cpu_seconds"],
                model.card.get("steps_done"),
                best,
                sum(layer.weight.size + layer.bias.size for layer in model.layers),
            )
        )
    return Table(
        "costs",
        "Processor time to describe one shape, spectrum included, with the largest memory of a "
        "fresh process that does so, and to train, without descriptors and patches",
        (
            "method",
            "a shape, s",
            "over EHKS",
            "memory, MB",
            "training, s",
            "over EHKS",
            "steps",
            "best at step",
            "weights",
        ),
        tuple(rows),
    )


def training_curve(model: Model) -> tuple[tuple[int, float, float], ...]:
    """Step, training loss and validation loss at each look of a model's training."""
    return tuple((step, seen, held) for step, seen, held in model.card.get("curve", ()))


def _training_table(models: Mapping[str, Model]) -> Table:
    rows = [(name, *look) for name, model in models.items() for look in training_curve(model)]
    return Table(
        "training",
        "Mean loss of a pair in training, since the look before, and in validation",
        ("method", "step", "training loss", "validation loss"),
        tuple(rows),
        shown=False,
    )


def _finding(
    groups: Sequence[Group], models: Mapping[str, Model], costs: Mapping[str, _Cost]
) -> str:
    """What became of the paper's claims, a line each."""
    names = [name for name in models if f"{name} %" in TABLE2.header]
    columns = [TABLE2.header.index(f"{name} %") for name in names]
    ours = np.array([[group.accuracies(name).mean() for name in names] for group in groups])
    theirs = np.array([[row[i] for i in columns] for row in TABLE2.rows], dtype=float)
    lines = []
    for what, shares in (("Here", ours), ("In the paper, on Dyna", theirs)):
        for number, row in enumerate(shares, start=1):
            order = np.argsort(-row, kind="stable")
            ranked = ", ".join(f"{names[i]} {row[i]:.1f} %" for i in order)
            lines.append(f"- {what}, group {number}: {ranked}.")
    own = names.index("EHKS")
    for what, row in (("Here", ours[-1]), ("In the paper", theirs[-1])):
        others = np.delete(row, own)
        best = int(np.argmax(others))
        rival = [name for name in names if name != "EHKS"][best]
        lines.append(
            f"- {what}, for the most different subjects, EHKS has "
            f"{row[own] / max(others[best], 1e-9):.2f} times the share of {rival}, the best of the "
            "others."
        )
    steady = sum(
        min(names, key=lambda name: _deviation(group.accuracies(name)) or np.inf) == "EHKS"
        for group in groups
    )
    lines.append(
        f"- EHKS has the smallest RSD in {steady} of {len(groups)} groups, in the paper "
        "in all four."
    )
    shape, training = costs["EHKS"].seconds, models["EHKS"].card["training_cpu_seconds"]
    lines += [
        f"- {name} takes {costs[name].seconds / shape:.2f} times as long as EHKS to describe a "
        f"shape, and {models[name].card['training_cpu_seconds'] / training:.2f} times to train."
        for name in names
        if name not in ("HKS", "EHKS")
    ]
    return "\n".join(lines)
