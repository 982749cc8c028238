"""Maps of many pairs of shapes, with the features of each computed only once."""

from __future__ import annotations

import csv
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from itertools import pairwise
from pathlib import Path

import numpy as np

from esd.common import FloatArray, InputError, existing_file, is_file, reason, table_rows
from esd.learning.model import Model
from esd.matching.adapt import check_adaptation
from esd.matching.collection import Pair, composed, cycle_miss, trusted_chains
from esd.matching.correspondence import check_map_path, save_map
from esd.matching.features import Features
from esd.matching.landmarks import paired_landmarks
from esd.matching.match import Mirror, check_copies, match_features, prepared, working_features
from esd.matching.parts import Scale
from esd.matching.points import with_surface
from esd.mesh.geometry import surface_area
from esd.mesh.io.landmarks import read_landmarks
from esd.mesh.mesh import Mesh, PointCloud
from esd.mesh.repair.repair import usable_part
from esd.mesh.surface import SurfacePoints
from esd.parallel import EVERY_CORE, Workers, outcomes, shared_folder
from esd.spectral.cache import default_cache
from esd.spectral.coarse import MeshCopy
from esd.spectral.spectrum import Spectrum

_LOADED = 8  # shapes that a process keeps, of a dozen files that are mapped into memory each

LANDMARK_COLUMNS = ("source_landmarks", "target_landmarks")
"""Of a file of pairs, where the shapes have landmarks."""


@dataclass(frozen=True, slots=True)
class PairOfFiles:
    """Two shapes, the file that their map goes to, and files of landmarks of both or neither."""

    source: Path
    target: Path
    output: Path
    landmarks: tuple[Path, Path] | None = None


@dataclass(frozen=True, slots=True)
class MatchedPair:
    """What became of a pair: figures of its map, or in words why there is none.

    Parameters
    ----------
    pair
        The files.
    matched
        Number of the source's vertices that have a match.
    coverage
        Share of the target's vertices that are matched.
    verdict, expected_accuracy
        See `esd.matching.confidence.Judgement`; None where the map was not judged.
    cost
        Of the candidate that was chosen, see `esd.matching.judge`; None where there was no choice.
    chain
        Shapes by way of which the map goes; none of a direct one.
    not_repaired
        What does harm in either shape and was not repaired, in words.
    failure
        None if the map was written.
    """

    pair: PairOfFiles
    matched: int = 0
    coverage: float = 0.0
    verdict: str | None = None
    expected_accuracy: float | None = None
    cost: float | None = None
    chain: tuple[str, ...] = ()
    not_repaired: str = ""
    failure: str | None = None


@dataclass(frozen=True, slots=True)
class CollectionReport:
    """What matching a collection as a whole gave.

    Parameters
    ----------
    miss_before, miss_after
        Mean distance over √area between images by way of a third shape and by the direct map, by
        the direct maps and by those that were kept, see `esd.matching.collection.cycle_miss`; None
        where no three maps close.
    tried, improved
        Number of maps by way of other shapes that were tried, and that were better.
    """

    miss_before: float | None
    miss_after: float | None
    tried: int
    improved: int

    def in_a_line(self) -> str:
        """The same in words."""
        line = f"{self.improved} of {self.tried} maps by way of other shapes were better"
        if self.miss_before is None or self.miss_after is None:
            return line
        return (
            f"{line}; maps a to c differ from those a to b to c by {self.miss_after:.1%} of √area "
            f"({self.miss_before:.1%} before)"
        )


def read_pairs_of_files(
    path: str | os.PathLike[str], *, folder: str | os.PathLike[str] = "."
) -> tuple[PairOfFiles, ...]:
    """Pairs in a CSV file with the columns `source,target` and, if wanted, `output`.

    Names are relative to the folder of that file. Files in the columns `source_landmarks` and
    `target_landmarks`, if there are any, hold landmarks of the shapes, paired by name.

    Parameters
    ----------
    folder
        Where maps go that have no output: to `SOURCE-TARGET.csv`.

    Raises
    ------
    InputError
        If the file is missing or not so, or two maps go to one file.
    """
    path = existing_file(path)
    try:
        columns, rows = table_rows(path.read_text(encoding="utf-8-sig"))
        if not {"source", "target"} <= columns:
            raise InputError(f"'{path}' must have the columns source,target (and output).")
        wanted = ("source", "target", "output", *LANDMARK_COLUMNS)
        listed = [[row.get(key, "") for key in wanted] for _, row in rows]
    except (csv.Error, UnicodeDecodeError) as error:
        raise InputError(f"'{path}' is no CSV file: {reason(error)}.") from error
    pairs = []
    for number, (source, target, output, *landmarks) in enumerate(listed, start=1):
        if not source or not target:
            raise InputError(f"'{path}', pair {number}: a source and a target are needed.")
        if "\0" in source + target + output + "".join(landmarks):
            raise InputError(f"'{path}', pair {number}: a name holds a character of code 0.")
        if any(landmarks) and not all(landmarks):
            raise InputError(f"'{path}', pair {number}: landmarks of both shapes, or none.")
        default = Path(folder) / f"{Path(source).stem}-{Path(target).stem}.csv"
        written = check_map_path(path.parent / output if output else default)
        files = (path.parent / landmarks[0], path.parent / landmarks[1]) if any(landmarks) else None
        missing = [file for file in files or () if not is_file(file)]
        if missing:
            raise InputError(f"'{path}', pair {number}: there is no file '{missing[0]}'.")
        pairs.append(PairOfFiles(path.parent / source, path.parent / target, written, files))
    if not pairs:
        raise InputError(f"'{path}' lists no pair.")
    outputs = [pair.output.resolve() for pair in pairs]
    if len(set(outputs)) < len(outputs):
        twice = next(output for output in outputs if outputs.count(output) > 1)
        raise InputError(f"'{path}' has several maps to '{twice}'; give them other outputs.")
    return tuple(pairs)


def match_files(
    pairs: tuple[PairOfFiles, ...],
    *,
    model: Model,
    refine: bool | None = None,
    candidates: Sequence[str] | None = None,
    mirror: Mirror = "auto",
    scale: Scale = "auto",
    adapt: bool = False,
    one_to_one: bool = False,
    reject: bool = False,
    min_confidence: float = 0.0,
    everything: bool = False,
    coarse: int | None = None,
    full: bool = False,
    workers: Workers = EVERY_CORE,
    on_step: Callable[[], None] = lambda: None,
    on_collection: Callable[[CollectionReport], None] | None = None,
) -> Iterator[MatchedPair]:
    """Match pairs of files in several processes and write their maps, as by `match`.

    First the features of each shape are computed, once, and kept on disk; then the pairs are
    matched. Pairs that fail do not abort the batch.

    Parameters
    ----------
    candidates, mirror, scale, adapt
        See `esd.matching.match.match`.
    reject
        Whether matches beyond the model's threshold are dropped.
    min_confidence
        Matches of less confidence are dropped.
    everything
        See `esd.mesh.repair.repair.repair`.
    coarse, full
        See `match`.
    workers
        What computes. Workers of a scheduler must see the meshes, the current folder
        and those of the maps under the same names.
    on_step
        Called after each shape and after each pair, to show progress.
    on_collection
        If given, the pairs are matched as a collection: where a chain of maps between other shapes
        is expected to be more accurate than the direct map, the map along it is refined, and
        replaces the direct one if the judge finds it better. Called with what that gave, before
        the first pair is returned.
    """
    check_copies(one_to_one=one_to_one, coarse=coarse, full=full)
    default_cache()  # a wrong limit is refused here, and not of each shape
    if adapt:
        check_adaptation(model)
    full = full or one_to_one
    threshold = model.threshold() if reject else np.inf
    files = list(dict.fromkeys(file for pair in pairs for file in (pair.source, pair.target)))
    with shared_folder(workers) as folder, ExitStack() as stack:
        stack.callback(_lately_loaded.cache_clear)  # before the folder is removed
        places = {file: folder / str(number) for number, file in enumerate(files)}
        first = partial(
            _save_features_of,
            model=model,
            everything=everything,
            coarse=coarse,
            full=full,
            refine=refine,
        )
        failures, left = {}, {}
        for computed in outcomes(first, places.items(), workers=workers):
            file, _ = computed.job
            if computed.failure:
                failures[file] = computed.failure_of(file)
            left[file] = computed.result or ""
            on_step()
        sound = []
        for pair in pairs:
            failure = failures.get(pair.source) or failures.get(pair.target)
            if failure:
                on_step()
                yield MatchedPair(pair, failure=failure)
            else:
                sound.append(pair)
        work = partial(
            _match,
            model=model,
            refine=refine,
            candidates=candidates,
            mirror=mirror,
            scale=scale,
            adapt=adapt,
            one_to_one=one_to_one,
            threshold=threshold,
            min_confidence=min_confidence,
        )
        direct = []
        jobs = (_Job(pair, (places[pair.source], places[pair.target])) for pair in sound)
        for matched in outcomes(work, jobs, workers=workers):
            on_step()
            found = matched.result or MatchedPair(matched.job.pair, failure=matched.failure)
            found = replace(found, not_repaired=_not_repaired(found.pair, left))
            if on_collection is None:
                yield found
            direct.append(found)
        if on_collection is not None:
            whole, report = _as_collection(direct, work, places, workers=workers)
            on_collection(report)
            yield from whole


@dataclass(frozen=True, slots=True)
class _Job:
    """A pair to be matched, or to be matched by way of other shapes.

    Parameters
    ----------
    places
        Where features are kept of the source, the shapes by way of which, and the target. A job
        has its own alone: all of a batch would go to the workers with each job.
    chain
        The shapes by way of which, both ends included; empty for a direct map.
    limit
        Cost of the direct map; a map by way of others that costs as much is dropped.
    """

    pair: PairOfFiles
    places: tuple[Path, ...]
    chain: tuple[Path, ...] = ()
    limit: float = np.inf


def _as_collection(
    direct: Sequence[MatchedPair],
    work: Callable[[_Job], MatchedPair | None],
    places: Mapping[Path, Path],
    *,
    workers: Workers,
) -> tuple[list[MatchedPair], CollectionReport]:
    """The direct maps, some of them replaced by better ones by way of other shapes."""
    files = list(places)
    number = {file: i for i, file in enumerate(files)}
    best: dict[Pair, MatchedPair] = {}
    for each in direct:
        if each.expected_accuracy is not None and each.pair.source != each.pair.target:
            best[number[each.pair.source], number[each.pair.target]] = each
    before = _cycle_miss(best, files, places)
    chains = trusted_chains({p: m.expected_accuracy or 0.0 for p, m in best.items()}, len(files))
    jobs = [
        _Job(
            best[pair].pair,
            tuple(places[files[i]] for i in chain),
            tuple(files[i] for i in chain),
            best[pair].cost or np.inf,
        )
        for pair, chain in chains.items()
        if pair in best and len(chain) > 2
    ]
    improved = 0
    for outcome in outcomes(work, jobs, workers=workers):
        if outcome.result is not None:
            pair = number[outcome.job.pair.source], number[outcome.job.pair.target]
            kept = best[pair].not_repaired
            best[pair] = replace(outcome.result, not_repaired=kept)
            improved += 1
    replaced = {each.pair: each for each in best.values()}
    after = _cycle_miss(best, files, places) if improved else before
    report = CollectionReport(before, after, len(jobs), improved)
    return [replaced.get(each.pair, each) for each in direct], report


def _cycle_miss(
    pairs: Iterable[Pair], files: Sequence[Path], places: Mapping[Path, Path]
) -> float | None:
    """See `esd.matching.collection.cycle_miss`, of the maps between some shapes."""
    maps = {
        (i, j): np.load(_kept_map(places[files[i]], places[files[j]]), mmap_mode="r")
        for i, j in pairs
    }
    positions: dict[int, FloatArray] = {}
    for i in {i for pair in maps for i in pair}:
        features = with_surface(load_features(places[files[i]]))
        assert isinstance(features.shape, Mesh)
        place = features.located(np.arange(len(features.vertex_index)))
        points = features.shape.vertices / np.sqrt(surface_area(features.shape))
        positions[i] = np.where((place >= 0)[:, None], points[place], np.nan)
    return cycle_miss(maps, positions)


def _kept_map(source: Path, target: Path) -> Path:
    """Where the map between two shapes is kept, without anything dropped."""
    return source.with_name(f"{source.name}-{target.name}.npy")


def _save_features_of(
    job: tuple[Path, Path],
    *,
    model: Model,
    everything: bool,
    coarse: int | None,
    full: bool,
    refine: bool | None,
) -> str:
    """Compute the features of a shape, write them to its folder, and say what is not repaired.

    The job is the file of the shape, and the folder.
    """
    file, place = job
    shape = prepared(file, everything=everything, coarse=coarse, full=full)
    save_features(
        working_features(
            shape, model=model, refine=refine, coarse=coarse, full=full, cache=default_cache()
        ),
        place,
    )
    return shape.not_repaired()


def _not_repaired(pair: PairOfFiles, left: Mapping[Path, str]) -> str:
    """What was not repaired in the shapes of a pair, in words."""
    ends = ("source", pair.source), ("target", pair.target)
    return "; ".join(f"{left[file]} in the {name}" for name, file in ends if left.get(file))


def _match(
    job: _Job,
    *,
    model: Model,
    refine: bool | None,
    candidates: Sequence[str] | None,
    mirror: Mirror,
    scale: Scale,
    adapt: bool,
    one_to_one: bool,
    threshold: float,
    min_confidence: float,
) -> MatchedPair | None:
    """What became of a pair; None if a map by way of other shapes is no better than the direct."""
    pair = job.pair
    ends = job.places[0], job.places[-1]
    source, target = (_lately_loaded(place) for place in ends)
    landmarks, by_way = None, None
    if job.chain:
        steps = [np.load(_kept_map(a, b)) for a, b in pairwise(job.places)]
        by_way = composed(steps)
    elif pair.landmarks is not None:
        read = [
            read_landmarks(file, usable_part(mesh))
            for file, mesh in zip(pair.landmarks, (pair.source, pair.target), strict=True)
        ]
        _, landmarks = paired_landmarks(*read)
    found = match_features(
        source,
        target,
        model=model,
        refine=refine,
        candidates=candidates,
        landmarks=landmarks,
        mirror=mirror if by_way is None else "no",
        scale=scale,
        adapt=adapt and by_way is None,
        by_way=by_way,
        cache=default_cache(),
        one_to_one=one_to_one,
    )
    judged = found.judgement
    cost = min(judged.costs.values()) if judged and judged.costs else None
    if by_way is not None and (cost is None or cost >= job.limit):
        return None
    np.save(_kept_map(*ends), found.target_index)
    found = found.rejecting(threshold).confident(min_confidence)
    save_map(found, pair.output)
    return MatchedPair(
        pair,
        int(found.is_matched().sum()),
        found.coverage(len(target.vertex_index)),
        judged.verdict if judged else None,
        judged.expected_accuracy if judged else None,
        cost,
        tuple(file.stem for file in job.chain[1:-1]),
    )


def save_features(features: Features, folder: Path) -> None:
    """Write to a new folder what `load_features` reads."""
    spectrum, copy = features.spectrum, features.copy
    arrays = {
        "vertices": features.shape.vertices,
        "positions": features.positions,
        "eigenvalues": spectrum.eigenvalues,
        "eigenvectors": spectrum.eigenvectors,
        "mass": spectrum.mass,
        "values": features.values,
        "embedded": features.embedded,
        "vertex_index": features.vertex_index,
        "original_index": features.original_index,
        # in one file: to open one takes a third of a millisecond
        "numbers": np.array(
            [spectrum.zero_modes, features.is_turned, features.filling, features.lost]
        ),
    }
    if isinstance(features.shape, Mesh):
        arrays["faces"] = features.shape.faces
    if copy is not None:
        arrays |= {
            "dense": copy.vertices,
            "face": copy.points.face,
            "barycentric": copy.points.weights,
        }
    folder.mkdir()
    for name, array in arrays.items():
        np.save(folder / f"{name}.npy", array, allow_pickle=False)


@lru_cache(maxsize=_LOADED)
def _lately_loaded(folder: Path) -> Features:
    """As `load_features`; pairs with a shape in common mostly follow each other."""
    return load_features(folder)


def load_features(folder: Path) -> Features:
    """What `save_features` wrote; arrays are mapped, so that processes share them."""
    arrays = {
        path.stem: np.load(path, mmap_mode="r", allow_pickle=False) for path in folder.glob("*.npy")
    }
    zero_modes, is_turned, filling, lost = arrays["numbers"].tolist()
    shape: Mesh | PointCloud = PointCloud(arrays["vertices"])
    if "faces" in arrays:
        shape = Mesh(arrays["vertices"], arrays["faces"])
    copy = None
    if isinstance(shape, Mesh) and "face" in arrays:
        points = SurfacePoints(arrays["face"], arrays["barycentric"])
        copy = MeshCopy(shape, arrays["dense"], points)
    spectrum = Spectrum(
        arrays["eigenvalues"], arrays["eigenvectors"], arrays["mass"], int(zero_modes)
    )
    return Features(
        shape,
        arrays["positions"],
        spectrum,
        arrays["values"],
        arrays["embedded"],
        bool(is_turned),
        arrays["vertex_index"],
        arrays["original_index"],
        int(filling),
        lost,
        copy,
    )
