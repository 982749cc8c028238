"""What an experiment is run on, and the parts that several of them share."""

from __future__ import annotations

import platform
import time
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from esd import __version__
from esd.datasets.collection import Collection
from esd.learning.fit import fit
from esd.learning.model import Model, load_model, save_model
from esd.learning.presets import PRESETS, Training
from esd.learning.table import PointTable, point_table
from esd.spectral.cache import Cache, content_key

KINDS = ("gps", "hks", "wks")
"""The descriptors of the paper, in the order of its tables."""

_QUICK_STEPS = 1000
_PACKAGES = ("numpy", "scipy", "torch")


@dataclass(frozen=True, slots=True, eq=False)
class Setting:
    """What an experiment is run on, and how.

    Parameters
    ----------
    training, testing
        Shapes of different subjects.
    folder
        Where finished parts are saved, from which an interrupted experiment resumes.
    seed
        Of all that is random.
    quick
        Whether a coarse answer in a minute or two will do.
    cache
        Where spectra are looked up and kept.
    progress
        `progress(what, total)` is a context that gives a function to be called with the number of
        things done since the last call.
    """

    training: Collection
    testing: Collection
    folder: Path
    seed: int
    quick: bool
    cache: Cache | None
    progress: Callable[[str, int], AbstractContextManager[Callable[[int], None]]]

    @property
    def store(self) -> Cache:
        """The finished parts, by the content they were computed from."""
        return Cache(self.folder / "parts", 10**12)


@lru_cache(maxsize=8)
def fingerprint(collection: Collection) -> str:
    """A key of all meshes and correspondences of a collection."""
    arrays = []
    for shape in collection.shapes:
        mesh = shape.mesh()
        arrays += [mesh.vertices, mesh.faces, shape.correspondence()]
    return content_key("collection", *arrays, names=[shape.name for shape in collection.shapes])


def paper_training(kind: str, *, quick: bool) -> Training:
    """The paper's training of the embedding of a descriptor; a short one to be quick.

    A short training passes through the learning rates of the whole one.
    """
    training = PRESETS[f"paper-{kind}"]
    return shortened(training, _QUICK_STEPS) if quick else training


def shortened(training: Training, steps: int) -> Training:
    """The training in fewer steps, from the same first learning rate to the same last one."""
    return replace(training, steps=steps, decay=training.decay ** (training.steps / steps))


def trained(
    setting: Setting, name: str, training: Training, *, validation: Collection | None = None
) -> Model:
    """A model trained on the shapes to train on, kept in the folder and trained only once.

    Its card says how much processor time the training took, without the descriptors.

    Parameters
    ----------
    validation
        See `esd.learning.train.train`.
    """
    data = [fingerprint(each) for each in (setting.training, validation) if each is not None]
    key = content_key(name, data=data, training=asdict(training), seed=setting.seed)
    key = key[: len(name) + 13]
    folder = setting.folder / "models" / key
    if folder.exists():
        return replace(load_model(folder), name=name)
    folder.parent.mkdir(exist_ok=True)
    with setting.progress(f"training {name}", training.steps) as advance:
        marks = [(0, time.process_time())]

        def restart() -> None:
            marks[:] = [(0, time.process_time())]

        def record(step: int) -> None:
            advance(step - marks[-1][0])
            marks.append((step, time.process_time()))

        model = fit(
            setting.training,
            training,
            name=name,
            seed=setting.seed,
            validation=validation,
            checkpoint=folder.with_name(f"{key}.checkpoint"),
            cache=setting.cache,
            on_shape=restart,
            on_progress=lambda state: record(state.step),
        )
    model = replace(model, card={**model.card, "training_cpu_seconds": _cpu_seconds(marks)})
    save_model(model, folder)
    return model


def _cpu_seconds(marks: Sequence[tuple[int, float]]) -> float:
    """Processor time of a whole training, of which this run may have done the last steps only.

    Parameters
    ----------
    marks
        Steps done and processor time at the start of this run and at each of its reports.
    """
    if len(marks) == 1:
        return time.process_time() - marks[0][1]  # a training without steps
    (first, start), (last, end) = marks[1 if len(marks) > 2 else 0], marks[-1]
    return (end - start) / (last - first) * last


def descriptor_table(setting: Setting, collection: Collection, training: Training) -> PointTable:
    """Descriptors of a collection as a training takes them, but for the standardisation."""
    with setting.progress(f"descriptors of {collection.name}", len(collection.shapes)) as advance:
        return point_table(
            collection, training.recipe, cache=setting.cache, on_shape=lambda: advance(1)
        )


def provenance(settings: Sequence[Setting]) -> dict[str, str]:
    """Data and versions behind an experiment, for its report."""
    facts = {}
    for setting in settings:
        name = setting.training.name
        for what, part in (("trained", setting.training), ("tested", setting.testing)):
            subjects = ", ".join(part.subjects)
            facts[f"{name}, {what} on"] = f"{len(part.shapes)} shapes of {subjects}"
    facts["Versions"] = ", ".join(
        [f"Python {platform.python_version()}", f"esd {__version__}", *map(_version, _PACKAGES)]
    )
    return facts


def _version(package: str) -> str:
    try:
        return f"{package} {version(package)}"
    except PackageNotFoundError:
        return f"no {package}"
