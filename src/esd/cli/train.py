"""`esd train`."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from esd.cli.options import DatasetArgument, ForceOption
from esd.cli.output import destination, tell
from esd.common import InputError

if TYPE_CHECKING:
    from esd.datasets.collection import Collection
    from esd.learning.model import Model
    from esd.learning.presets import Training

_JUDGED = 12  # maps by which a training without correspondences is judged


def train(
    dataset: DatasetArgument,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output", "-o", metavar="MODEL", help="Folder to write; by default named as PRESET."
        ),
    ] = None,
    preset: Annotated[
        str,
        typer.Option(help="{presets}. Only the first learns without correspondences."),
    ] = "oriented",
    include: Annotated[
        str | None, typer.Option(metavar="GLOB", help="Only shapes with such names.")
    ] = None,
    validation: Annotated[
        str | None,
        typer.Option(
            metavar="GLOB",
            help="Shapes held out of the training, on which the best weights are chosen.",
        ),
    ] = None,
    hold_out: Annotated[
        int, typer.Option(min=0, help="Instead: number of subjects held out, drawn by the seed.")
    ] = 0,
    seed: Annotated[int, typer.Option(min=0, help="Of all that is random.")] = 0,
    steps: Annotated[int | None, typer.Option(min=1, help="Instead of the preset's.")] = None,
    standardise: Annotated[
        bool, typer.Option(help="Standardise the descriptors over the training shapes.")
    ] = True,
    log: Annotated[bool, typer.Option(help="Take the logarithm of the descriptors.")] = False,
    device: Annotated[
        str, typer.Option(metavar="[cpu|cuda|auto]", help="Where the network is trained.")
    ] = "cpu",
    start: Annotated[
        str | None,
        typer.Option(
            metavar="MODEL",
            help="Model to start from; without correspondences, or of the preset 'surface' or "
            "'partial'. By default 'surface' starts from the network of the default model, and "
            "training without correspondences from that model where it maps the shapes better "
            "than descriptors do; 'none' for none.",
        ),
    ] = None,
    force: ForceOption = False,
) -> None:
    """Train a model on the shapes of DATASET; an interrupted training resumes when rerun.

    Where shapes of DATASET have no correspondences, it learns without: see the share of good maps
    that it prints at the end.
    """
    from dataclasses import replace

    from esd.datasets.open import open_collection
    from esd.datasets.splits import split_by_subject
    from esd.learning.model import check_model_destination, save_model
    from esd.learning.presets import preset as named_preset

    training = replace(named_preset(preset), standardise=standardise)
    if steps is not None:
        training = replace(training, steps=steps)
    if log:
        parts = tuple(replace(part, log=True) for part in training.recipe.descriptors)
        training = replace(training, recipe=replace(training.recipe, descriptors=parts))
    if validation and hold_out:
        raise typer.BadParameter("Give --validation or --hold-out, not both.")
    output = output or Path(preset)
    check_model_destination(output)
    destination(output, force=force, inputs=[dataset], is_folder=True)
    whole = open_collection(dataset)
    chosen = whole.including(include) if include else whole
    chosen = chosen.excluding_subjects(whole.testing_subjects)
    held = None
    if validation:
        held = whole.including(validation)
        chosen = chosen.excluding_subjects(held.subjects)
    elif hold_out:
        chosen, held = split_by_subject(chosen, held_out=hold_out, seed=seed)
    unregistered = () if chosen.store else chosen.unregistered()
    if unregistered and training.loss == "infonce" and not training.blocks:
        if device != "cpu":
            raise typer.BadParameter("Learning without correspondences runs on the CPU only.")
        model = _unsupervised(chosen, held, training, output, seed=seed, steps=steps, start=start)
    elif len(unregistered) == len(chosen.shapes):
        raise InputError(
            f"'{dataset}' has no correspondences, which the preset '{preset}' needs: add them as "
            "'corres/NAME.vts', or take the preset 'oriented', which learns without."
        )
    elif start is not None and not training.blocks:
        raise typer.BadParameter(
            "--start is for shapes without correspondences, and for the presets 'surface' and "
            "'partial'."
        )
    else:
        model = _supervised(chosen, held, training, output, seed=seed, start=start, device=device)
    save_model(model, output)
    tell(f"trained {model.card['steps_done']} steps on {len(chosen.shapes)} shapes: {output}")
    if "verdicts" in model.card:
        tell(_trust(model))


_NO_START = "none"


def _checkpoint(output: Path) -> Path:
    return output.with_name(output.name + ".checkpoint")


def _supervised(
    chosen: Collection,
    held: Collection | None,
    training: Training,
    output: Path,
    *,
    seed: int,
    start: str | None,
    device: str,
) -> Model:
    from esd.cli.progress import progress
    from esd.learning.fit import fit
    from esd.learning.model import load_model
    from esd.parallel import EVERY_CORE
    from esd.spectral.cache import default_cache

    first = None
    if start is None and training.blocks:
        first = _default_that_fits(training)
    elif start not in (None, _NO_START):
        first = load_model(start)
    with_copies = len(chosen.shapes) * (1 + training.remeshings)
    shapes = 0 if chosen.store else with_copies + (len(held.shapes) if held else 0)
    with (
        progress("describing", shapes) as described,
        progress("training", training.steps) as trained,
    ):
        return fit(
            chosen,
            training,
            name=output.name,
            seed=seed,
            validation=held,
            start=first,
            checkpoint=_checkpoint(output),
            device=device,
            workers=EVERY_CORE,
            cache=default_cache(),
            on_shape=lambda: described(1),
            on_progress=_since_last(trained),
        )


def _default_that_fits(training: Training) -> Model | None:
    """The default model, if a network that diffuses features can be trained from its weights."""
    from esd.learning.model import load_model
    from esd.learning.part_training import can_start
    from esd.matching.match import DEFAULT_MODEL

    default = load_model(DEFAULT_MODEL)
    # whose standardisation is kept
    return default if training.standardise and can_start(default, training) else None


def _unsupervised(
    chosen: Collection,
    held: Collection | None,
    training: Training,
    output: Path,
    *,
    seed: int,
    steps: int | None,
    start: str | None,
) -> Model:
    """A model learned without correspondences, with the verdicts on some of its maps."""
    from dataclasses import replace
    from functools import partial

    from esd.cli.progress import progress
    from esd.evaluation.trust import verdicts
    from esd.learning.model import load_model
    from esd.learning.unsupervised import Teaching, can_start, train_unsupervised
    from esd.matching.first_maps import first_maps, step_count
    from esd.matching.match import DEFAULT_MODEL
    from esd.parallel import EVERY_CORE
    from esd.spectral.cache import default_cache

    teaching = Teaching() if steps is None else replace(Teaching(), steps=steps)
    first, tried = None, None
    if start is None:
        default = load_model(DEFAULT_MODEL)
        tried = default if can_start(default, training) else None
    elif start != _NO_START:
        first = load_model(start)
    cache = default_cache()
    shapes = len(chosen.shapes) + (len(held.shapes) if held else 0)
    with (
        progress("describing", shapes) as described,
        progress("mapping", step_count(len(chosen.shapes)) if first is None else 0) as mapped,
        progress("training", teaching.steps) as advance,
    ):
        model = train_unsupervised(
            chosen,
            training,
            teaching=teaching,
            name=output.name,
            seed=seed,
            validation=held,
            start=first,
            first_maps=partial(
                first_maps,
                collection=chosen,
                recipe=training.recipe,
                start=tried,
                seed=seed,
                workers=EVERY_CORE,
                cache=cache,
                on_step=lambda: mapped(1),
            ),
            checkpoint=_checkpoint(output),
            workers=EVERY_CORE,
            cache=cache,
            on_shape=lambda: described(1),
            on_progress=_since_last(advance),
        )
    used = replace(chosen, shapes=tuple(chosen[name] for name in model.card["shapes"]))
    with progress("judging", min(_JUDGED, len(used.shapes))) as judged:
        found = verdicts(
            model,
            used,
            count=_JUDGED,
            seed=seed,
            workers=EVERY_CORE,
            cache=cache,
            on_pair=lambda: judged(1),
        )
    return replace(model, card={**model.card, "verdicts": dict(found)})


def _since_last(advance: Callable[[int], None]) -> Callable[[Any], None]:
    """What passes on how many steps were done since the last call."""
    done = 0

    def report(state: Any) -> None:
        nonlocal done
        advance(state.step - done)
        done = state.step

    return report


def _trust(model: Model) -> str:
    """How far a model that was trained without correspondences can be trusted, in lines."""
    found = model.card["verdicts"]
    counts = ", ".join(f"{number} {verdict}" for verdict, number in found.items())
    lines = [f"of {sum(found.values())} maps between training shapes: {counts}"]
    groups = model.card["groups"]
    alone = [group[0] for group in groups[1:] if len(group) == 1]
    if alone:
        lines.append(
            f"found no place among the others: {', '.join(alone)}; look whether they are of "
            "another class, mirrored, or damaged"
        )
    lines += [
        f"match each other but not the others, perhaps of another class: {', '.join(group)}"
        for group in groups[1:]
        if len(group) > 1
    ]
    lines += [f"left out: {name}: {why}" for name, why in model.card["left_out"].items()]
    return "\n".join(lines)
