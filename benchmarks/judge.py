"""The weights by which candidate maps are judged: fitted, and tried by cross-validation.

    python benchmarks/judge.py collect DATA evidence.csv
    python benchmarks/judge.py collect DATA evidence.csv --sets smal_r --model MODEL --shapes A B C
    python benchmarks/judge.py fit evidence.csv
    python benchmarks/judge.py calibrate DATA matches.csv
    python benchmarks/judge.py calibrate DATA unseen.csv --unseen

`collect` matches pairs of development shapes, each rotated at random: people, animals, heads and
skulls, and pairs of different classes, of which nothing is right. The evidence for each candidate
is a row of the file, with the mean geodesic error of its map over √area, times 100, and the share
of it that is right, within 5 % of the geodesic diameter; `final` is the refined map of the one that
was chosen. Pairs that the file has are not measured again. `fit` prints the weights of
`esd.matching.judge`, and what they choose where each pair is left out in turn, in five parts.

`calibrate` matches other pairs of the same shapes, or with `--unseen` of the others, and writes
what the confidence is computed from at some vertices of each, and whether they are right. It prints
the constants of `esd.matching.confidence` that fit these, each set counting the same, and by them
and by those that there are, for each set: matches by confidence, and verdicts.
"""

from __future__ import annotations

import argparse
import csv
from dataclasses import fields
from itertools import pairwise, product
from pathlib import Path

import numpy as np
from measure import row, rows_in, table
from scipy.optimize import minimize

from esd.common import BoolArray, FloatArray, IntArray
from esd.learning.model import Model, load_model
from esd.matching import choice as choosing
from esd.matching import confidence as trust
from esd.matching import match as matching
from esd.matching.choice import chosen, elastic
from esd.matching.confidence import _FAILED, _GOOD, _JUDGED, _OFFSET
from esd.matching.judge import Evidence
from esd.matching.match import match_features, prepared, working_features
from esd.nearest import nearest
from esd.spectral.cache import default_cache
from real import SETS, Shape, errors_along, known_points, pairs_of, rotated, ruler

POINTS = 400
PAIRS = {
    "smal_r": 20,
    "tosca_r": 10,
    "faust_r": 12,
    "heads": 8,
    "skulls": 6,
    "endocasts": 2,
}  # and their pairs
DEVELOPMENT = {"smal_r": 24, "faust_r": 60, "skulls": 20}  # the first shapes by name, else all
ACROSS = "different classes"
NAMES = tuple(field.name for field in fields(Evidence))
COLUMNS = ("set", "source", "target", "model", "candidate", "error", "right", *NAMES)
REGULARISATION, FOLDS = 3.0, 5
EQUALITY = 0.5  # of the sets in the weights: 0 if each pair counts the same, 1 if each set does


def shapes_of(data: Path, name: str) -> list[Shape]:
    shapes = SETS[name](data / name)
    return [rotated(shape) for shape in shapes[: DEVELOPMENT.get(name)]]


def across(data: Path) -> list[tuple[Shape, Shape]]:
    """Pairs of different classes; both SMAL_r and TOSCA_r have animals on four legs."""
    some = {}
    for name in PAIRS:
        shapes = shapes_of(data, name)
        some[name] = shapes[0], shapes[len(shapes) // 2]
    return [
        (some[a][i % 2], some[b][(i // 2) % 2])
        for i, (a, b) in enumerate(product(some, some))
        if a < b and {a, b} != {"smal_r", "tosca_r"}
    ]


def errors(source: Shape, target: Shape, index: IntArray) -> tuple[float, float]:
    """Mean error of a map between the files' vertices, and the share that is right."""
    scale = ruler(target)
    known = known_points(source, target, POINTS)
    image = index[source.index[known]]
    along = errors_along(target, image, known)[image >= 0]
    return 100 * float(along.mean()) / scale.root, float((along < 0.05 * scale.diameter).mean())


def rows_of(name: str, source: Shape, target: Shape, model: Model) -> list[dict[str, object]]:
    """A row for each candidate, and one for the refined map."""
    cache = default_cache()
    here, there = (
        working_features(prepared(each.mesh), model=model, cache=cache) for each in (source, target)
    )
    choice = elastic(chosen(here, there))
    found = match_features(here, there, model=model, mirror="no", cache=cache)
    maps = [("final", choice.evidence, found.target_index)]
    for candidate, evidence in choice.computed:
        index = nearest(*candidate.forward)[0][here.vertex_index]
        maps.append((candidate.name, evidence, there.original_index[index]))
    rows = []
    for candidate, evidence, index in maps:
        error, right = (50.0, 0.0) if name == ACROSS else errors(source, target, index)
        values = {each: getattr(evidence, each) for each in NAMES}
        rows.append({"candidate": candidate, "error": error, "right": right} | values)
    return rows


def collect(options: argparse.Namespace) -> None:
    choosing._SURE = 2.0  # all candidates of all pairs
    is_new = not options.file.exists()
    known = set()
    if not is_new:
        with options.file.open(newline="") as file:
            known = {tuple(each[key] for key in COLUMNS[:4]) for each in csv.DictReader(file)}
    model = load_model(options.model)
    jobs = []
    for name in options.sets or [*PAIRS, ACROSS]:
        if name == ACROSS:
            jobs += [(name, *pair) for pair in across(options.data)]
            continue
        shapes = shapes_of(options.data, name)
        if options.shapes:
            shapes = [shape for shape in shapes if shape.name in options.shapes]
        jobs += [(name, *pair) for pair in pairs_of(shapes, PAIRS[name], options.seed)]
    with options.file.open("a", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS)
        if is_new:
            writer.writeheader()
        for name, source, target in jobs:
            head = dict(zip(COLUMNS, (name, source.name, target.name, options.model), strict=False))
            if tuple(head.values()) not in known:
                writer.writerows(head | each for each in rows_of(name, source, target, model))
                file.flush()


def compared(
    x: FloatArray, error: FloatArray, pair: IntArray, importance: FloatArray
) -> FloatArray:
    """Weights that give the better of two candidates for one pair the smaller cost."""
    differences, weights = [], []
    for each in np.unique(pair):
        of_pair = np.flatnonzero(pair == each)
        for a, b in product(of_pair, of_pair):
            if error[a] < 0.98 * error[b]:
                differences.append(x[b] - x[a])
                weights.append(importance[a] * min(np.log(error[b] / error[a]), 1.5))
    difference, weight = np.array(differences), np.array(weights)

    def loss(c: FloatArray) -> tuple[float, FloatArray]:
        z = difference @ c
        slope = -(difference * (weight / (1 + np.exp(z)))[:, None]).sum(axis=0)
        value = (weight * np.logaddexp(0, -z)).sum() + REGULARISATION * (c @ c)
        return value, slope + 2 * REGULARISATION * c

    return minimize(loss, np.zeros(x.shape[1]), jac=True).x


def predicted(x: FloatArray, right: FloatArray, weight: FloatArray) -> FloatArray:
    """Weights, and a constant, of the logit of the share that is right, by ridge regression."""
    share = np.clip(right, 0.01, 0.99)
    y = np.log(share / (1 - share))
    rows = np.hstack([x, np.ones((len(x), 1))])
    normal = (rows * weight[:, None]).T @ rows + REGULARISATION * np.diag([*np.ones(x.shape[1]), 0])
    return np.linalg.solve(normal, (rows * weight[:, None]).T @ y)


def fit(options: argparse.Namespace) -> None:
    with options.file.open(newline="") as file:
        rows = list(csv.DictReader(file))
    x = np.array([Evidence(*(float(each[name]) for name in NAMES)).vector() for each in rows])
    finite = np.isfinite(x).all(axis=1)
    rows, x = [rows[i] for i in np.flatnonzero(finite)], x[finite]
    mean, deviation = x.mean(axis=0), x.std(axis=0)
    z = (x - mean) / deviation
    error, right = (np.array([float(each[key]) for each in rows]) for key in ("error", "right"))
    keys = [tuple(each[key] for key in COLUMNS[:4]) for each in rows]
    number = {key: i for i, key in enumerate(dict.fromkeys(keys))}
    pair = np.array([number[key] for key in keys])
    is_final = np.array([each["candidate"] == "final" for each in rows])
    apart = np.array([each["set"] == ACROSS for each in rows])
    weight = np.where(is_final, 3.0, 1.0) * np.where(apart, 2.0, 1.0)
    ranked = ~is_final & ~apart
    # sets of few pairs would be outvoted by animals
    kinds = np.array([each["set"] for each in rows])
    importance = np.array([np.count_nonzero(kinds[ranked] == kind) for kind in kinds])
    importance = (ranked.sum() / np.maximum(importance, 1) / len(PAIRS)) ** EQUALITY

    def weights_of(rows: BoolArray) -> FloatArray:
        return compared(z[rows], error[rows], pair[rows], importance[rows])

    costs, expected = np.zeros(len(rows)), np.zeros(len(rows))
    for fold in range(FOLDS):
        out = pair % FOLDS == fold
        costs[out] = z[out] @ weights_of(~out & ranked)
        *c, constant = predicted(z[~out], right[~out], weight[~out])
        expected[out] = 1 / (1 + np.exp(-(z[out] @ np.array(c) + constant)))
    print("cost:", *(weights_of(ranked) / deviation).round(3))
    *a, constant = predicted(z, right, weight)
    a = np.array(a) / deviation
    print("accuracy:", *a.round(3), "constant:", round(constant - a @ mean, 3))
    names = list(dict.fromkeys(each["candidate"] for each in rows if each["candidate"] != "final"))
    table("shapes", "pairs", *names, "chosen", "best")
    for kind in dict.fromkeys((each["set"], each["model"]) for each in rows):
        of_kind = np.array([(each["set"], each["model"]) == kind for each in rows]) & ~is_final
        picked, best = [], []
        for each in np.unique(pair[of_kind]):
            of_pair = np.flatnonzero(of_kind & (pair == each))
            picked.append(error[of_pair[costs[of_pair].argmin()]])
            best.append(error[of_pair].min())
        by_name = []
        for name in names:
            least: dict[int, float] = {}  # of several of one name
            for i in np.flatnonzero(of_kind):
                if rows[i]["candidate"] == name:
                    least[pair[i]] = min(error[i], least.get(pair[i], np.inf))
            by_name.append(f"{np.mean(list(least.values())):.2f}" if least else "")
        row(
            " ".join(kind),
            len(picked),
            *by_name,
            *(f"{np.mean(values):.2f}" for values in (picked, best)),
        )
    print()
    table("expected", "maps", "right: mean", "least", "2nd percentile", "most")
    limits = (0, 0.3, 0.6, 0.8, 0.9, 0.94, 0.97, 1.01)
    for low, high in pairwise(limits):
        there = right[is_final & (expected >= low) & (expected < high)]
        if len(there):
            values = there.mean(), there.min(), np.quantile(there, 0.02), there.max()
            row(f"{low} to {high}", len(there), *(f"{value:.2f}" for value in values))


MATCH_COLUMNS = ("set", "source", "target", "astray", "longest", "accuracy", "right")
BOUNDS = (0, 0.5, 0.8, 0.9, 0.95, 1.01)  # of the confidences in the tables


def matches_of(name: str, source: Shape, target: Shape, model: Model) -> FloatArray:
    """What speaks for some matches of a pair, its accuracy, and whether each is right, (p, 4)."""
    cache = default_cache()
    here, there = (
        working_features(prepared(each.mesh), model=model, cache=cache) for each in (source, target)
    )
    seen = []
    plain = matching.confidence

    def recorded(mesh, other, index, back, *, accuracy=None):
        seen.append((trust.evidence(mesh, other, index, back), accuracy))
        return plain(mesh, other, index, back, accuracy=accuracy)

    matching.confidence = recorded
    try:
        found = match_features(here, there, model=model, mirror="no", cache=cache)
    finally:
        matching.confidence = plain
    if not seen:
        return np.zeros((0, 4))  # as parts
    values, accuracy = seen[-1]
    generator = np.random.default_rng(0)
    if name == ACROSS:
        vertices = generator.choice(len(source.mesh.vertices), POINTS)
        right = np.zeros(POINTS)
    else:
        scale = ruler(target)
        known = known_points(source, target, POINTS)
        vertices = source.index[known]
        along = errors_along(target, found.target_index[vertices], known)
        right = (found.target_index[vertices] >= 0) & (along < 0.05 * scale.diameter)
    at = here.vertex_index[vertices]
    rows = np.column_stack([values[at], np.full(len(at), accuracy), right])
    return rows[(at >= 0) & np.isfinite(rows).all(axis=1)]


def calibrate(options: argparse.Namespace) -> None:
    model = load_model(options.model)
    known = {tuple(each.values())[:3] for each in rows_in(options.file, MATCH_COLUMNS)}
    jobs = []
    for name in options.sets or [*PAIRS, ACROSS]:
        if name == ACROSS:
            jobs += [] if options.unseen else [(name, *pair) for pair in across(options.data)]
            continue
        shapes = [rotated(shape) for shape in SETS[name](options.data / name)]
        count = DEVELOPMENT.get(name, len(shapes))
        shapes = shapes[count:] if options.unseen else shapes[:count]
        jobs += [(name, *pair) for pair in pairs_of(shapes, options.pairs, options.seed)]
    with options.file.open("a", newline="") as file:
        writer = csv.writer(file)
        for name, source, target in jobs:
            if (name, source.name, target.name) not in known:
                rows = matches_of(name, source, target, model)
                writer.writerows([name, source.name, target.name, *each] for each in rows.tolist())
                file.flush()
    rows = rows_in(options.file, MATCH_COLUMNS)
    values = np.array([[float(each[key]) for key in MATCH_COLUMNS[3:]] for each in rows])
    sets = np.array([each["set"] for each in rows])
    pair = np.unique([f"{each['source']} {each['target']}" for each in rows], return_inverse=True)[
        1
    ]
    bounded = np.clip(values[:, 2], 0.02, 0.995)
    x = np.column_stack(
        [np.ones(len(values)), np.log(values[:, :2] + _OFFSET), np.log(bounded / (1 - bounded))]
    )
    right = values[:, 3]
    weight = np.zeros(len(rows))
    for name in np.unique(sets):
        weight[sets == name] = 1000 / np.count_nonzero(sets == name)

    def loss(c: FloatArray) -> tuple[float, FloatArray]:
        z = x @ c
        value = weight @ (np.logaddexp(0, z) - right * z)
        return value, x.T @ (weight * (1 / (1 + np.exp(-z)) - right))

    fitted = minimize(loss, np.array(_JUDGED), jac=True).x
    print("confidence:", *fitted.round(3))
    for title, constants in (("as it is", np.array(_JUDGED)), ("as fitted here", fitted)):
        found = 1 / (1 + np.exp(-(x @ constants)))
        print(f"\n{title}\n")
        bins = [f"{low:g} to {min(high, 1):g}" for low, high in pairwise(BOUNDS)]
        table(
            "set", "pairs", "confidence", "right", *bins, "good, least right", "doubtful", "failed"
        )
        for name in dict.fromkeys(sets):
            of_set = sets == name
            cells = []
            for low, high in pairwise(BOUNDS):
                there = of_set & (found >= low) & (found < high)
                share = there.sum() / of_set.sum()
                cells.append(f"{right[there].mean():.2f} ({share:.0%})" if there.any() else "")
            numbers = np.unique(pair[of_set])
            expected = np.array([found[pair == each].mean() for each in numbers])
            true = np.array([right[pair == each].mean() for each in numbers])
            is_good, is_failed = expected >= _GOOD, expected < _FAILED
            for there in (is_good, ~is_good & ~is_failed, is_failed):
                some = true[there]
                ends = f" ({some.min():.2f} to {some.max():.2f})" if len(some) else ""
                cells.append(f"{len(some)}{ends}")
            means = found[of_set].mean(), right[of_set].mean()
            row(name, len(numbers), *(f"{mean:.3f}" for mean in means), *cells)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    commands = parser.add_subparsers(required=True)
    collecting = commands.add_parser("collect")
    collecting.add_argument("data", type=Path)
    collecting.add_argument("file", type=Path)
    collecting.add_argument("--sets", nargs="*", choices=[*PAIRS, ACROSS])
    collecting.add_argument("--shapes", nargs="*", help="names, of all that are for development")
    collecting.add_argument("--model", default="default")
    collecting.add_argument("--seed", type=int, default=7)
    collecting.set_defaults(run=collect)
    fitting = commands.add_parser("fit")
    fitting.add_argument("file", type=Path)
    fitting.set_defaults(run=fit)
    calibrating = commands.add_parser("calibrate")
    calibrating.add_argument("data", type=Path)
    calibrating.add_argument("file", type=Path)
    calibrating.add_argument("--sets", nargs="*", choices=[*PAIRS, ACROSS])
    calibrating.add_argument("--unseen", action="store_true", help="shapes not for development")
    calibrating.add_argument("--pairs", type=int, default=12, help="of each set")
    calibrating.add_argument("--model", default="default")
    calibrating.add_argument("--seed", type=int, default=11)
    calibrating.set_defaults(run=calibrate)
    options = parser.parse_args()
    options.run(options)


if __name__ == "__main__":
    main()
