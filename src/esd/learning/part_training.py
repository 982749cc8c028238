"""Training of a network that diffuses features, on whole shapes or on shapes whole and cut."""

from __future__ import annotations

import logging
import math
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from scipy import sparse

from esd.common import FloatArray, InputError, IntArray, whole_file
from esd.datasets.collection import Collection, Shape, repaired_shape
from esd.datasets.parts import PARTS, part_of
from esd.datasets.remeshing import with_remeshings
from esd.descriptors.recipe import Recipe, recipe_spectrum, spectrum_descriptors
from esd.learning.device import usable_device
from esd.learning.diffusion import diffusion_network, surface_of
from esd.learning.diffusion_torch import (
    DiffusionLayers,
    SurfaceTensors,
    seeded_layers,
    surface_tensors,
)
from esd.learning.losses import infonce_loss
from esd.learning.model import Model
from esd.learning.optimise import adam_with_moments, descend
from esd.learning.presets import Training
from esd.learning.run import Run, first_run
from esd.learning.train import Progress
from esd.mesh.geometry import surface_area
from esd.mesh.mesh import Mesh
from esd.mesh.topology import oriented_outward
from esd.parallel import THIS_PROCESS, Workers, outcomes, shared_folder
from esd.spectral.cache import Cache, content_key

_log = logging.getLogger(__name__)

_SUMMARY = ("files", "points", "count", "mean", "squares")  # of the parts of a shape
_VERSION = 1  # part of the keys of described parts; raised when they may change

_SPREAD = 0.05  # of the logarithm of a part's area, whose whole a user may know only roughly
_FEWEST_VERTICES = 0.1  # of the whole's, below which a part is left out
_PAIRS, _WHOLE_PAIRS = 2, 1  # in a step: of parts, and where all shapes are whole
_COMMON, _COMMON_SHARE = 300, 0.1  # points, and share of the template's, that a pair must share
_TRIES = 1000  # pairs drawn until one has so many
_NEAR = 0.03  # distance, in √area, below which points are no negatives of each other
_WEIGHT_DECAY = 1e-3
_LARGEST_NORM = 1.0  # of the gradient of all weights
_WARM_UP = 100  # steps in which the learning rate rises
_START_RATE = 0.5  # of the learning rate, where a training starts from a model
_LAST_RATE = 0.02  # of the learning rate, at the end of its cosine
_VALIDATION_PAIRS = 20
_LARGEST_SEED = 2**32 - 1


@dataclass(frozen=True, slots=True, eq=False)
class _Part:
    """A described part, or a whole shape, in a file.

    Parameters
    ----------
    path
        Of the file, see `_describe`.
    points : (p,)
        Its vertex at each point of its template; -1 where it has none.
    template
        Its name.
    """

    path: Path
    points: npt.NDArray[np.int32]
    template: str


@dataclass(frozen=True, slots=True, eq=False)
class _Parts:
    """All parts of a collection, and the moments of their descriptors, (width,) each."""

    parts: tuple[_Part, ...]
    mean: FloatArray
    deviation: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class _Pair:
    """Two parts, and points of the template that both have, (b,)."""

    source: _Part
    target: _Part
    points: IntArray


def train_on_parts(
    collection: Collection,
    training: Training,
    *,
    name: str = "model",
    seed: int = 0,
    validation: Collection | None = None,
    start: Model | None = None,
    checkpoint: str | os.PathLike[str] | None = None,
    device: str = "cpu",
    workers: Workers = THIS_PROCESS,
    cache: Cache | None = None,
    on_shape: Callable[[], None] = lambda: None,
    on_progress: Callable[[Progress], None] = lambda _: None,
) -> Model:
    """The embedding learned from the shapes of a collection, and parts of them if it is of parts.

    Each shape is taken whole, and so are its `training.remeshings`; with descriptors of parts, each
    is also cut in each way of `esd.datasets.parts.PARTS`. A step draws pairs of these, two of parts
    or one of whole shapes, of any shapes of one template, and lowers the InfoNCE of points that
    both of a pair have, where points near each other are no negatives. On one processor equal
    arguments and equal numbers of threads give equal weights, also when the training was
    interrupted and resumed from its checkpoint.

    The parts are described once, and lie in files, about 10 MB for one of 5,000 vertices, from
    which each step reads its own: beside the checkpoint in `CHECKPOINT.parts`, from which a
    resumed training takes them, or else in a temporary folder. They are removed at the end.

    Parameters
    ----------
    collection
        Of meshes with correspondences.
    training
        With `blocks`, and `hidden` two layers: the first of the descriptors, and the features that
        diffuse.
    name
        Of the model.
    validation
        Shapes of other subjects. Given these, the weights with the lowest loss on parts of them
        are kept, and training stops when it has not fallen at ten validations.
    start
        A model of the same descriptors and network from whose weights the training starts, at half
        the learning rate; its standardisation is kept.
    checkpoint
        A file from which an interrupted training resumes, and which is removed at its end.
    device
        Where the network is trained, see `usable_device`.
    workers
        What describes the parts; training itself runs in this process.
    cache
        Where spectra of whole shapes are looked up and kept.
    on_shape, on_progress
        Called after all parts of a shape are described, and after each step.

    Raises
    ------
    InputError
        If the training has no blocks, the start does not fit it, the collection is a store, shapes
        cannot be described, no two parts have enough points in common, the checkpoint belongs to
        another training, or torch has no such device.
    """
    if not training.blocks or len(training.hidden) != 2:
        raise InputError(
            "Training on surfaces takes presets with `blocks` and two layers in `hidden`, such as "
            "'surface' and 'partial'."
        )
    stores = [each.store for each in (collection, validation) if each is not None and each.store]
    if stores:
        raise InputError(
            f"'{stores[0]}' is a store, which holds descriptors and neither surfaces nor parts of "
            "them: train on the data set that it was made of."
        )
    if not 0 <= seed <= _LARGEST_SEED:
        raise InputError(f"`seed` must be from 0 to {_LARGEST_SEED}; got {seed}.")
    if start is not None:
        _check_start(start, training)
        training = replace(training, learning_rate=_START_RATE * training.learning_rate)
    place = torch.device(usable_device(device))
    path = None if checkpoint is None else Path(checkpoint)
    with _folder(path, workers) as folder:
        described = partial(
            _described,
            recipe=training.recipe,
            seed=seed,
            folder=folder,
            workers=workers,
            cache=cache,
            on_shape=on_shape,
        )
        data = described(with_remeshings(collection, training.remeshings, seed=seed))
        if start is not None:
            data = replace(data, mean=start.mean, deviation=start.deviation)
        elif not training.standardise:
            width = training.recipe.width
            data = replace(data, mean=np.zeros(width), deviation=np.ones(width))
        held: tuple[_Pair, ...] = ()
        if validation is not None:
            parts = described(validation).parts
            held = tuple(_draw(parts, training, _LARGEST_SEED, i) for i in range(_VALIDATION_PAIRS))
        run = _first_run(training, seed, place, start)
        identity = _identity(data, held, training, seed, start)
        _run_to_the_end(run, data, held, training, seed, path, identity, on_progress)
        weights = [*run.network.parameters()] if validation is None else run.best_weights
        with torch.no_grad():
            for parameter, best in zip(run.network.parameters(), weights, strict=True):
                parameter.copy_(best)
    return Model(
        name=name,
        recipe=training.recipe,
        mean=data.mean,
        deviation=data.deviation,
        limit=training.limit,
        unit_length=True,
        diffusion=diffusion_network(run.network.arrays(), inputs=training.recipe.width),
        card={
            **_card(collection, validation, training, seed, run, len(data.parts)),
            "start": None if start is None else start.name,
        },
    )


def can_start(start: Model, training: Training) -> bool:
    """Whether a training can start from a model: its descriptors and its network are the same."""
    wanted = seeded_layers(*_sizes(training), seed=0).arrays()
    weights = {} if start.diffusion is None else start.diffusion.weights
    shapes, needed = ({n: array.shape for n, array in each.items()} for each in (weights, wanted))
    return start.recipe.to_json() == training.recipe.to_json() and shapes == needed


def _check_start(start: Model, training: Training) -> None:
    """Raise an `InputError` unless a training can start from a model."""
    if not can_start(start, training):
        raise InputError(
            f"The training cannot start from '{start.name}': its descriptors or its layers differ "
            "from the preset's. Start from a model of the same preset."
        )


def _sizes(training: Training) -> tuple[int, int, int, int, int]:
    """Inputs, the two layers, outputs, and blocks of the network."""
    hidden, width = training.hidden
    return training.recipe.width, hidden, width, training.outputs, training.blocks


@contextmanager
def _folder(checkpoint: Path | None, workers: Workers) -> Iterator[Path]:
    """Where described parts lie; beside the checkpoint, it remains if the training fails."""
    if checkpoint is None:
        with shared_folder(workers) as folder:
            yield folder
        return
    folder = checkpoint.with_name(checkpoint.name + ".parts").resolve()
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"'{folder}' cannot be written to: {error.strerror}.") from error
    yield folder
    for file in folder.glob("part-*.npz"):
        file.unlink()
    if not any(folder.iterdir()):
        folder.rmdir()


def _described(
    collection: Collection,
    *,
    recipe: Recipe,
    seed: int,
    folder: Path,
    workers: Workers,
    cache: Cache | None,
    on_shape: Callable[[], None],
) -> _Parts:
    """All parts of a collection, described in files of a folder."""
    describe = partial(_describe, recipe=recipe, seed=seed, folder=folder, cache=cache)
    found: list[dict[str, npt.NDArray[Any]]] = [{}] * len(collection.shapes)
    for outcome in outcomes(describe, enumerate(collection.shapes), workers=workers):
        place, shape = outcome.job
        if outcome.result is None:
            raise InputError(outcome.failure_of(shape.name))
        found[place] = outcome.result
        on_shape()
    parts = tuple(
        _Part(folder / file, points, shape.template)
        for shape, each in zip(collection.shapes, found, strict=True)
        for file, points in zip(each["files"].tolist(), each["points"], strict=True)
    )
    # the moments of all from those of each part
    count, means, squares = (
        np.concatenate([each[key] for each in found]) for key in ("count", "mean", "squares")
    )
    mean = count @ means / count.sum()
    variance = (squares.sum(axis=0) + count @ (means - mean) ** 2) / count.sum()
    return _Parts(parts, mean, np.where(variance > 0, np.sqrt(variance), 1.0))


def _describe(
    job: tuple[int, Shape], *, recipe: Recipe, seed: int, folder: Path, cache: Cache | None
) -> dict[str, npt.NDArray[Any]]:
    """Write the parts of a shape to files of their own; their names, points, and moments.

    What was written before, by a training that was interrupted, is not computed again.
    """
    place, shape = job
    repaired, index, _ = repaired_shape(shape)
    mesh = repaired.shape
    if not isinstance(mesh, Mesh):
        raise InputError("It has no faces, and so no parts can be cut from it.")
    content = {"recipe": recipe.to_json(), "seed": [seed, place], "version": _VERSION}
    key = content_key("part", mesh.vertices, mesh.faces, index, **content)
    summary = folder / f"{key}.npz"
    if summary.exists():
        with np.load(summary) as archive:
            return dict(archive)
    generator = np.random.default_rng((seed, place))
    area = surface_area(mesh)
    done: dict[str, list[Any]] = {key: [] for key in _SUMMARY}
    for number, kind in enumerate(["whole", *(PARTS if recipe.is_of_parts else ())]):
        cut, spread = int(generator.integers(2**30)), generator.standard_normal()
        if kind == "whole":
            own, arrays = index, _arrays(mesh, recipe, 1.0, cache)
        else:
            try:
                made = part_of(mesh, kind, seed=cut)
                if len(made.mesh.vertices) < _FEWEST_VERTICES * len(mesh.vertices):
                    continue
                share = surface_area(made.mesh) / (area * np.exp(_SPREAD * spread))
                arrays = _arrays(made.mesh, recipe, share, None)
            except InputError as error:  # too little of it is left
                _log.info("'%s', %s, is left out: %s", shape.name, kind, error)
                continue
            own = np.where(index >= 0, made.vertex_index[index], -1)
        defined = np.isfinite(arrays["values"]).all(axis=1)
        values = arrays["values"][defined].astype(np.float64)
        done["files"].append(f"{key}-{number}.npz")
        done["points"].append(np.where((own >= 0) & defined[own], own, -1).astype(np.int32))
        done["count"].append(float(len(values)))
        done["mean"].append(values.mean(axis=0))
        done["squares"].append(values.var(axis=0) * len(values))
        _write(folder / done["files"][-1], arrays)
    result = {key: np.array(each) for key, each in done.items()}
    _write(summary, result)
    return result


def _write(path: Path, arrays: dict[str, npt.NDArray[Any]]) -> None:
    with whole_file(path) as temporary, temporary.open("wb") as file:
        np.savez(file, **arrays)  # type: ignore[arg-type]


def _arrays(
    part: Mesh, recipe: Recipe, share: float, cache: Cache | None
) -> dict[str, npt.NDArray[Any]]:
    """What a training takes of a part that has a share of the whole's area.

    Descriptors are rounded to 16 bits, far finer than they are known, for the room on the disk.
    """
    spectrum = recipe_spectrum(recipe, part, cache=cache).with_area(share)
    values = spectrum_descriptors(recipe, part, spectrum, single=True)
    surface = surface_of(oriented_outward(part), spectrum)
    gradient = surface.gradient.tocsr()
    unit = np.sqrt(share / surface_area(part))
    return {
        "values": values.astype(np.float16),
        "eigenvalues": surface.spectrum.eigenvalues.astype(np.float32),
        "eigenvectors": surface.spectrum.eigenvectors.astype(np.float32),
        "mass": surface.spectrum.mass.astype(np.float32),
        "slopes": gradient.data.astype(np.complex64),
        "columns": gradient.indices,
        "starts": gradient.indptr,
        "positions": (unit * part.vertices).astype(np.float32),
    }


def _draw(parts: tuple[_Part, ...], training: Training, seed: int, number: int) -> _Pair:
    """A pair of parts of one template that have points enough in common, of a seed and a number.

    The source may be any part, the target any other of its template, so that templates of few
    shapes are drawn as often as these are.
    """
    generator = np.random.default_rng((seed, number))
    templates = np.array([part.template for part in parts])
    for _ in range(_TRIES):
        source = parts[generator.integers(len(parts))]
        target = parts[generator.choice(np.flatnonzero(templates == source.template))]
        if source is target:
            continue
        common = np.flatnonzero((source.points >= 0) & (target.points >= 0))
        if len(common) > min(_COMMON, _COMMON_SHARE * len(source.points)):
            size = min(training.batch, len(common))
            return _Pair(source, target, generator.choice(common, size, replace=False))
    raise InputError(
        f"In {_TRIES} pairs of parts of the shapes, none had enough points of a template in common "
        "to learn from: are the correspondences of most points missing?"
    )


def _first_run(
    training: Training, seed: int, device: torch.device, start: Model | None
) -> Run[DiffusionLayers]:
    network = seeded_layers(*_sizes(training), seed=seed)
    if start is not None and start.diffusion is not None:
        weights = start.diffusion.weights.items()
        network.load_state_dict({name: torch.from_numpy(array.copy()) for name, array in weights})
    network = network.to(device)
    optimiser = adam_with_moments(network, rate=training.learning_rate, weight_decay=_WEIGHT_DECAY)
    return first_run(network, optimiser)


def _run_to_the_end(
    run: Run[DiffusionLayers],
    data: _Parts,
    held: tuple[_Pair, ...],
    training: Training,
    seed: int,
    checkpoint: Path | None,
    identity: str,
    on_progress: Callable[[Progress], None],
) -> None:
    """All steps from those that the checkpoint has, until the last or the validation's patience."""
    if checkpoint is not None and checkpoint.exists():
        run.resume(checkpoint, identity=identity)
    losses: list[float] = []
    while run.step < training.steps and not (held and run.is_exhausted(training.validate_every)):
        losses.append(_advance(run, data, training, seed))
        run.step += 1
        loss = None
        if run.step % training.validate_every == 0 or run.step == training.steps:
            loss = _validate(run, data, held, training) if held else None
            run.curve.append((run.step, float(np.mean(losses)), loss))
            losses = []
            if checkpoint is not None:
                run.save(checkpoint, identity=identity)
        latest = float(np.mean(losses)) if losses else run.curve[-1][1]
        on_progress(Progress(run.step, training.steps, latest, loss))
    if checkpoint is not None:
        checkpoint.unlink(missing_ok=True)


def _advance(run: Run[DiffusionLayers], data: _Parts, training: Training, seed: int) -> float:
    """One step; its loss."""
    device = run.network.out.weight.device
    dropout = torch.Generator(device).manual_seed(_LARGEST_SEED * run.step + seed)
    count = _PAIRS if training.recipe.is_of_parts else _WHOLE_PAIRS
    pairs = [_draw(data.parts, training, seed, count * run.step + i) for i in range(count)]
    losses = [_loss(run.network, data, pair, training, dropout) for pair in pairs]
    loss = torch.stack(losses).mean()
    fall = (1 + math.cos(math.pi * run.step / training.steps)) / 2
    rise = min(1.0, (run.step + 1) / _WARM_UP)
    rate = training.learning_rate * rise * (_LAST_RATE + (1 - _LAST_RATE) * fall)
    descend(run.optimiser, loss, rate=rate, largest_norm=_LARGEST_NORM)
    return float(loss.detach())


def _validate(
    run: Run[DiffusionLayers], data: _Parts, held: tuple[_Pair, ...], training: Training
) -> float:
    """The loss on the validation pairs; the weights are noted if they are the best so far."""
    with torch.no_grad():
        losses = [float(_loss(run.network, data, pair, training, None)) for pair in held]
    mean = float(np.mean(losses))
    run.note(mean)
    return mean


def _loss(
    network: DiffusionLayers,
    data: _Parts,
    pair: _Pair,
    training: Training,
    dropout: torch.Generator | None,
) -> torch.Tensor:
    """Mean loss of the points of a pair, some features dropped if there is a generator."""
    (source, positions), (target, _) = (
        _embedded(network, data, part, pair.points, training, dropout)
        for part in (pair.source, pair.target)
    )
    near = torch.cdist(positions, positions) < _NEAR
    near.fill_diagonal_(False)
    return infonce_loss(source, target, temperature=training.temperature, ignored=near).mean()


def _embedded(
    network: DiffusionLayers,
    data: _Parts,
    part: _Part,
    points: IntArray,
    training: Training,
    dropout: torch.Generator | None,
) -> tuple[torch.Tensor, torch.Tensor]:
    """Embedding (b, outputs) of some points of the template on a part, and their positions."""
    device = network.out.weight.device
    values, surface, positions = _read(part, data, training, device)
    vertices = torch.from_numpy(part.points[points].astype(np.int64)).to(device)
    features = network(values, surface, dropout)[vertices]
    return torch.nn.functional.normalize(features, dim=1), positions[vertices]


def _read(
    part: _Part, data: _Parts, training: Training, device: torch.device
) -> tuple[torch.Tensor, SurfaceTensors, torch.Tensor]:
    """Standardised descriptors of a part, its surface, and its vertices' positions in √area."""
    with np.load(part.path) as archive:
        arrays = dict(archive)
    count = len(arrays["mass"])
    gradient = sparse.csr_array(
        (arrays["slopes"], arrays["columns"], arrays["starts"]), shape=(count, count)
    )
    surface = surface_tensors(
        arrays["eigenvalues"],
        arrays["eigenvectors"],
        arrays["mass"],
        gradient,
        device=device,
    )
    mean, deviation = (
        torch.from_numpy(each.astype(np.float32)).to(device) for each in (data.mean, data.deviation)
    )
    values = (torch.from_numpy(arrays["values"]).to(device).float() - mean) / deviation
    if training.limit is not None:
        values = values.clamp(-training.limit, training.limit)
    return values.nan_to_num(), surface, torch.from_numpy(arrays["positions"]).to(device)


def _identity(
    data: _Parts,
    held: tuple[_Pair, ...],
    training: Training,
    seed: int,
    start: Model | None,
) -> str:
    """What a training depends on; a checkpoint is resumed only by the same."""
    # the names of the files have keys of all that is in them
    names = [part.path.name for part in data.parts]
    names += [part.path.name for pair in held for part in (pair.source, pair.target)]
    first = {} if start is None or start.diffusion is None else start.diffusion.weights
    return content_key(
        "training on parts 3",
        np.array(names),
        *(first[name] for name in sorted(first)),
        *(pair.points for pair in held),
        training=asdict(training),
        seed=seed,
    )


def _card(
    collection: Collection,
    validation: Collection | None,
    training: Training,
    seed: int,
    run: Run[DiffusionLayers],
    parts: int,
) -> dict[str, Any]:
    settings = asdict(training)
    del settings["recipe"]  # the model has it
    return {
        "data": collection.name + ", whole and cut" * training.recipe.is_of_parts,
        "shapes": [shape.name for shape in collection.shapes],
        "parts": parts,
        "validation_shapes": [shape.name for shape in validation.shapes] if validation else [],
        "validation_loss": run.best_loss if validation else None,
        "training": settings,
        "seed": seed,
        "steps_done": run.step,
        "curve": run.curve,
        "device": str(run.network.out.weight.device),
        "threads": torch.get_num_threads(),
        "torch": str(torch.__version__),
    }
