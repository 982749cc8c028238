"""Maps of many pairs of shapes, with the features of each computed only once."""

from __future__ import annotations

import csv
import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from esd.common import InputError, existing_file, is_file, reason
from esd.learning.model import Model
from esd.matching.adapt import check_adaptation
from esd.matching.correspondence import check_map_path, save_map
from esd.matching.features import Features
from esd.matching.landmarks import paired_landmarks
from esd.matching.match import Mirror, check_copies, match_features, prepared, working_features
from esd.mesh.io.landmarks import read_landmarks
from esd.mesh.mesh import Mesh, PointCloud
from esd.mesh.repair.repair import usable_part
from esd.mesh.surface import SurfacePoints
from esd.parallel import EVERY_CORE, Workers, outcomes, shared_folder
from esd.spectral.cache import default_cache
from esd.spectral.coarse import MeshCopy
from esd.spectral.spectrum import Spectrum

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
    failure
        None if the map was written.
    """

    pair: PairOfFiles
    matched: int = 0
    coverage: float = 0.0
    verdict: str | None = None
    expected_accuracy: float | None = None
    failure: str | None = None


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
        with path.open(newline="", encoding="utf-8-sig") as file:
            rows = csv.DictReader(file, skipinitialspace=True)
            if not {"source", "target"} <= set(rows.fieldnames or ()):
                raise InputError(f"'{path}' must have the columns source,target (and output).")
            listed = [
                [
                    (row.get(key) or "").strip()
                    for key in ("source", "target", "output", *LANDMARK_COLUMNS)
                ]
                for row in rows
            ]
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
    adapt: bool = False,
    one_to_one: bool = False,
    reject: bool = False,
    min_confidence: float = 0.0,
    everything: bool = False,
    coarse: int | None = None,
    full: bool = False,
    workers: Workers = EVERY_CORE,
    on_step: Callable[[], None] = lambda: None,
) -> Iterator[MatchedPair]:
    """Match pairs of files in several processes and write their maps, as by `match`.

    First the features of each shape are computed, once, and kept on disk; then the pairs are
    matched. Pairs that fail do not abort the batch.

    Parameters
    ----------
    candidates, mirror, adapt
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
    """
    check_copies(one_to_one=one_to_one, coarse=coarse, full=full)
    if adapt:
        check_adaptation(model)
    full = full or one_to_one
    threshold = model.threshold() if reject else np.inf
    files = list(dict.fromkeys(file for pair in pairs for file in (pair.source, pair.target)))
    with shared_folder(workers) as folder:
        places = {file: folder / str(number) for number, file in enumerate(files)}
        first = partial(
            _save_features_of,
            places=places,
            model=model,
            everything=everything,
            coarse=coarse,
            full=full,
            refine=refine,
        )
        failures = {}
        for computed in outcomes(first, files, workers=workers):
            if computed.failure:
                failures[computed.job] = computed.failure_of(computed.job)
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
            places=places,
            model=model,
            refine=refine,
            candidates=candidates,
            mirror=mirror,
            adapt=adapt,
            one_to_one=one_to_one,
            threshold=threshold,
            min_confidence=min_confidence,
        )
        for matched in outcomes(work, sound, workers=workers):
            on_step()
            yield matched.result or MatchedPair(matched.job, failure=matched.failure)


def _save_features_of(
    file: Path,
    *,
    places: dict[Path, Path],
    model: Model,
    everything: bool,
    coarse: int | None,
    full: bool,
    refine: bool | None,
) -> None:
    """Compute the features of a shape, and write them to its folder."""
    shape = prepared(file, everything=everything, coarse=coarse, full=full)
    save_features(
        working_features(
            shape, model=model, refine=refine, coarse=coarse, full=full, cache=default_cache()
        ),
        places[file],
    )


def _match(
    pair: PairOfFiles,
    *,
    places: dict[Path, Path],
    model: Model,
    refine: bool | None,
    candidates: Sequence[str] | None,
    mirror: Mirror,
    adapt: bool,
    one_to_one: bool,
    threshold: float,
    min_confidence: float,
) -> MatchedPair:
    source, target = load_features(places[pair.source]), load_features(places[pair.target])
    landmarks = None
    if pair.landmarks is not None:
        read = [
            read_landmarks(file, usable_part(mesh))
            for file, mesh in zip(pair.landmarks, (pair.source, pair.target), strict=True)
        ]
        _, landmarks = paired_landmarks(*read)
    found = (
        match_features(
            source,
            target,
            model=model,
            refine=refine,
            candidates=candidates,
            landmarks=landmarks,
            mirror=mirror,
            adapt=adapt,
            cache=default_cache(),
            one_to_one=one_to_one,
        )
        .rejecting(threshold)
        .confident(min_confidence)
    )
    save_map(found, pair.output)
    judged = found.judgement
    return MatchedPair(
        pair,
        int(found.is_matched().sum()),
        found.coverage(len(target.vertex_index)),
        judged.verdict if judged else None,
        judged.expected_accuracy if judged else None,
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
        "zero_modes": np.array(spectrum.zero_modes),
        "values": features.values,
        "embedded": features.embedded,
        "is_turned": np.array(features.is_turned),
        "vertex_index": features.vertex_index,
        "original_index": features.original_index,
        "filling": np.array(features.filling),
        "lost": np.array(features.lost),
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


def load_features(folder: Path) -> Features:
    """What `save_features` wrote; arrays are mapped, so that processes share them."""
    arrays = {
        path.stem: np.load(path, mmap_mode="r", allow_pickle=False) for path in folder.glob("*.npy")
    }
    shape: Mesh | PointCloud = PointCloud(arrays["vertices"])
    if "faces" in arrays:
        shape = Mesh(arrays["vertices"], arrays["faces"])
    copy = None
    if isinstance(shape, Mesh) and "face" in arrays:
        points = SurfacePoints(arrays["face"], arrays["barycentric"])
        copy = MeshCopy(shape, arrays["dense"], points)
    spectrum = Spectrum(
        arrays["eigenvalues"], arrays["eigenvectors"], arrays["mass"], int(arrays["zero_modes"])
    )
    return Features(
        shape,
        arrays["positions"],
        spectrum,
        arrays["values"],
        arrays["embedded"],
        bool(arrays["is_turned"]),
        arrays["vertex_index"],
        arrays["original_index"],
        int(arrays["filling"]),
        float(arrays["lost"]),
        copy,
    )
