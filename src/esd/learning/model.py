"""Trained embeddings: as data, as a folder, and at work without torch."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from safetensors import SafetensorError
from safetensors.numpy import load_file, save

from esd.common import (
    FloatArray,
    InputError,
    check_can_be_made,
    is_count,
    is_positive,
    whole_folder,
)
from esd.descriptors.recipe import (
    DESCRIPTOR_KINDS,
    Recipe,
    recipe_spectrum,
    single_recipe,
    spectrum_descriptors,
)
from esd.learning.device import usable_device
from esd.learning.diffusion import DiffusionNetwork, Surface, diffusion_network, surface_of
from esd.learning.gcnn import GeodesicPatches
from esd.learning.patches import Patches, convolution, patch_operator, patches_from_json
from esd.mesh.mesh import Mesh, PointCloud
from esd.mesh.topology import oriented_outward
from esd.spectral.cache import Cache
from esd.spectral.laplacian import SparseMatrix
from esd.spectral.spectrum import Spectrum

_FORMAT = 1
_LARGEST_FILE = 2**30
_LARGEST_CONFIG = 2**26
_ROWS = 2**14  # embedded at a time, for the memory that dense meshes take
# of a model folder, and the one that macOS leaves in any
_FILES = frozenset({"config.json", "model.safetensors", "README.md", ".DS_Store"})
_DIFFUSION = "diffusion."  # before the names of the weights of such a network
_BUNDLED = Path(__file__).parent / "models"
ALIASES = {"default": "oriented"}
"""Other names of bundled models."""


@dataclass(frozen=True, slots=True, eq=False)
class Layer:
    """A fully connected layer or a convolution, float32.

    Parameters
    ----------
    weight
        (outputs, inputs), or of a convolution (outputs, bins, bins, inputs), see
        `esd.learning.patches.convolution`.
    bias : (outputs,)
    """

    weight: npt.NDArray[np.float32]
    bias: npt.NDArray[np.float32]


@dataclass(frozen=True, slots=True, eq=False)
class Model:
    """An embedding of descriptors, in which Euclidean distance tells how well points match.

    Parameters
    ----------
    name
        What to call it in tables.
    recipe
        The descriptors it takes.
    mean, deviation : (recipe.width,) float64
        Subtracted from the descriptors, and what they are then divided by.
    layers
        Applied in turn with ReLU between them. None for a raw descriptor.
    margin
        C of the contrastive loss, in squared units of the embedding; None where there was none.
    limit
        Largest absolute value of a standardised descriptor, at which others are cut off; None for
        no limit. It keeps a mesh unlike the training's from leading far astray.
    unit_length
        Whether the embedding lies on the unit sphere.
    patches
        Of the surface, over which convolutions go; None where no layer is one.
    diffusion
        The network of models that see the surface, in place of layers or beside them: then the
        embedding is that of both side by side. None for other models.
    card
        What it was trained on, how, and how it did: plain data.
    device
        Where embeddings, and the nearest of them, are computed: `cpu` by numpy, any other by torch,
        equal to rounding. It is no part of the model's files.
    """

    name: str
    recipe: Recipe
    mean: FloatArray
    deviation: FloatArray
    layers: tuple[Layer, ...] = ()
    margin: float | None = None
    limit: float | None = None
    unit_length: bool = False
    patches: Patches | None = None
    diffusion: DiffusionNetwork | None = None
    card: Mapping[str, Any] = field(default_factory=dict)
    device: str = "cpu"

    def __repr__(self) -> str:
        parts = ", ".join(f"{part.kind} ({part.count})" for part in self.recipe.descriptors)
        return f"<Model '{self.name}' of {parts}>"

    @property
    def is_oriented(self) -> bool:
        """Whether it tells left from right: its recipe has chirality."""
        return any(part.kind in ("chirality", "parts") for part in self.recipe.descriptors)

    @property
    def is_pointwise(self) -> bool:
        """Whether the embedding of a point depends on no other point's descriptors."""
        return self.patches is None and self.diffusion is None

    @property
    def mirrors(self) -> bool:
        """Whether the descriptors of a mirror image follow from a shape's, see `reflected`."""
        return self.patches is None and not self.recipe.is_of_parts

    def operator(
        self, shape: Mesh | PointCloud, spectrum: Spectrum, *, cache: Cache | None = None
    ) -> SparseMatrix | Surface | None:
        """What `embed` takes beside the descriptors of all vertices of a shape; often nothing."""
        if self.patches is not None:
            return patch_operator(self.patches, shape, cache=cache)
        if self.diffusion is not None and isinstance(shape, Mesh):
            return surface_of(oriented_outward(shape), spectrum)
        return None

    def threshold(self) -> float:
        """Squared distance beyond which the paper rejects a match: C / 2.

        Raises
        ------
        InputError
            If the model has no margin.
        """
        if self.margin is None:
            raise InputError(f"'{self.name}' has no margin, and so no threshold to reject by.")
        return self.margin / 2

    def embed(
        self, values: FloatArray, operator: SparseMatrix | Surface | None = None
    ) -> FloatArray:
        """Embedding (n, outputs) of descriptors (n, recipe.width), in their precision.

        Parameters
        ----------
        operator
            The `operator` of the shape whose vertices the descriptors are of, all of them, for
            models that are not pointwise.

        Raises
        ------
        InputError
            If the descriptors are not as wide as those of the recipe, or there is no operator
            where one is needed.
        """
        if values.ndim != 2 or values.shape[1] != self.recipe.width:
            raise InputError(
                f"The model takes descriptors of shape (n, {self.recipe.width}); "
                f"got {values.shape}."
            )
        if not self.is_pointwise and operator is None:
            raise InputError(
                f"'{self.name}' embeds all vertices of a shape together, see `embed_mesh`."
            )
        values = values.astype(np.result_type(values, np.float32), copy=False)
        mean, deviation = (
            each.astype(values.dtype, copy=False) for each in (self.mean, self.deviation)
        )
        rows = _ROWS if self.patches is None else max(len(values), 1)
        layered, features, lost = [], [], []
        for start in range(0, max(len(values), 1), rows):
            part = values[start : start + rows]
            part = standardised(part, mean, deviation, limit=self.limit)
            if self.layers or self.diffusion is None:
                layered.append(self._after_layers(part, operator))
            if self.diffusion is not None:
                features.append(self.diffusion.features(np.nan_to_num(part)))
                lost.append(np.isnan(part).any(axis=1))
        results = [np.concatenate(layered)] if layered else []
        if self.diffusion is not None and isinstance(operator, Surface):
            results.append(self.diffusion.diffused(np.concatenate(features), operator))
            results[-1][np.concatenate(lost)] = np.nan
        if self.unit_length:
            for result in results:
                result /= np.sqrt(len(results)) * np.linalg.norm(result, axis=1, keepdims=True)
        return np.hstack(results) if len(results) > 1 else results[0]

    def _after_layers(
        self, values: FloatArray, operator: SparseMatrix | Surface | None
    ) -> FloatArray:
        """Standardised descriptors (n, width) after all layers, (n, outputs)."""
        if self.device != "cpu" and self.patches is None:
            from esd.learning.network import propagated

            layers = [(layer.weight, layer.bias) for layer in self.layers]
            return propagated(values, layers, device=self.device)
        for i, layer in enumerate(self.layers):
            values = np.maximum(values, 0) if i else values
            if layer.weight.ndim == 2:
                weight = layer.weight.T.astype(values.dtype, copy=False)
                values = values @ weight + layer.bias.astype(values.dtype, copy=False)
            else:
                turned = isinstance(self.patches, GeodesicPatches)
                values = convolution(operator, values, layer.weight, turned=turned) + layer.bias
        return values

    def embed_mesh(self, mesh: Mesh | PointCloud, *, cache: Cache | None = None) -> FloatArray:
        """Embedding (n, outputs) of the vertices of a mesh; NaN at vertices without a face."""
        return self.embed_spectrum(
            mesh, recipe_spectrum(self.recipe, mesh, cache=cache), cache=cache
        )

    def embed_spectrum(
        self, mesh: Mesh | PointCloud, spectrum: Spectrum, *, cache: Cache | None = None
    ) -> FloatArray:
        """Embedding (n, outputs) of the vertices of a mesh, from its `recipe_spectrum`."""
        values = spectrum_descriptors(self.recipe, mesh, spectrum, cache=cache)
        return self.embed(values, self.operator(mesh, spectrum, cache=cache))


def with_diffusion(model: Model, other: Model) -> Model:
    """A fully connected model with the network of another of equal descriptors beside its layers.

    The other's standardisation becomes part of its first layer; descriptors are cut off where those
    of the model are.

    Raises
    ------
    InputError
        If the other has no such network, or the models differ in kind.
    """
    if other.diffusion is None or not model.layers or not model.is_pointwise:
        raise InputError(
            f"'{model.name}' and '{other.name}' cannot be joined: one must have layers "
            "alone, the other a network that diffuses features."
        )
    if model.recipe.to_json() != other.recipe.to_json() or model.unit_length != other.unit_length:
        raise InputError(
            f"'{model.name}' and '{other.name}' cannot be joined: they differ in their "
            "descriptors, or in whether embeddings have unit length."
        )
    weights = dict(other.diffusion.weights)
    first = weights["first.weight"].astype(np.float64) / other.deviation
    bias = weights["first.bias"] + first @ (model.mean - other.mean)
    weights["first.weight"] = (first * model.deviation).astype(np.float32)
    weights["first.bias"] = bias.astype(np.float32)
    return replace(model, diffusion=diffusion_network(weights, inputs=model.recipe.width))


def standardised(
    values: FloatArray, mean: FloatArray, deviation: FloatArray, *, limit: float | None
) -> FloatArray:
    """Descriptors (n, width) less their mean, in deviations, (width,) each, cut off at a limit."""
    result = values - mean
    result /= deviation
    return result if limit is None else np.clip(result, -limit, limit, out=result)


def raw_model(kind: str) -> Model:
    """The model that leaves a descriptor as it is.

    Raises
    ------
    InputError
        If there is no such descriptor.
    """
    recipe = single_recipe(kind)
    return Model(kind, recipe, np.zeros(recipe.width), np.ones(recipe.width))


def bundled_models() -> tuple[str, ...]:
    """Names of the models that ship with the package."""
    return tuple(sorted(path.parent.name for path in _BUNDLED.glob("*/config.json")))


def load_model(model: str | os.PathLike[str], *, device: str = "cpu") -> Model:
    """The model in a folder, a bundled one by its name, or a raw descriptor by its name.

    Nothing in the folder is executed or unpickled.

    Parameters
    ----------
    device
        Where it computes: `cpu`, `cuda`, or `auto` for a GPU where there is one.

    Raises
    ------
    InputError
        If there is no such model or device, or its files are damaged or do not fit each other.
    """
    device = usable_device(device)
    folder = Path(model)
    if not folder.exists():
        if str(model) in DESCRIPTOR_KINDS:
            return replace(raw_model(str(model)), device=device)
        name = ALIASES.get(str(model), str(model))
        folder = _BUNDLED / name if Path(name).name == name else folder
    if not (folder / "config.json").is_file():
        known = ", ".join([*ALIASES, *bundled_models(), *DESCRIPTOR_KINDS])
        raise InputError(f"There is no model '{model}': expected a model folder or one of {known}.")
    config = _read_config(folder / "config.json")
    weights = _read_weights(folder / "model.safetensors")
    try:
        loaded = _model_of(config, weights, folder, device)
    except KeyError as error:
        raise InputError(f"The model '{folder}' lacks {error}.") from error
    except InputError as error:
        raise InputError(f"'{folder / 'config.json'}': {error}") from error
    _check_fit(loaded, config["layers"], folder)
    # mean, deviation, two arrays a layer, and those of a network in place of layers
    held = 2 + 2 * len(loaded.layers)
    held += 0 if loaded.diffusion is None else len(loaded.diffusion.weights)
    if len(weights) != held:
        raise InputError(
            f"'{folder / 'config.json'}': `layers` has {len(loaded.layers)} of them, and "
            f"'model.safetensors' others beyond: its files are of different models."
        )
    return loaded


def _model_of(
    config: Mapping[str, Any], weights: Mapping[str, Any], folder: Path, device: str
) -> Model:
    """The model of a configuration, each of whose values is checked, and its weights."""
    widths, patches = config["layers"], config.get("patches")
    if not isinstance(widths, list) or not widths or not all(map(is_count, widths)):
        raise InputError(f"`layers` must list the neurons of each layer; got {widths!r}.")
    margin, limit, unit_length = config["margin"], config.get("limit"), config.get("unit_length")
    for name, value in (("margin", margin), ("limit", limit)):
        if value is not None and not is_positive(value):
            raise InputError(f"`{name}` must be a positive number or null; got {value!r}.")
    if unit_length not in (True, False, None):
        raise InputError(f"`unit_length` must be true or false; got {unit_length!r}.")
    for name, value in (("recipe", config["recipe"]), ("card", config["card"])):
        if not isinstance(value, dict):
            raise InputError(f"`{name}` must be an object of names and values; got {value!r}.")
    recipe = Recipe.from_json(config["recipe"])
    diffusion = {
        name.removeprefix(_DIFFUSION): _single(array)
        for name, array in weights.items()
        if name.startswith(_DIFFUSION)
    }
    return Model(
        name=folder.resolve().name,
        recipe=recipe,
        mean=weights["mean"],
        deviation=weights["deviation"],
        layers=tuple(
            Layer(_single(weights[f"layer{i}.weight"]), _single(weights[f"layer{i}.bias"]))
            for i in range(len(widths) - 1)
        ),
        margin=margin,
        limit=limit,
        unit_length=bool(unit_length),
        patches=None if patches is None else patches_from_json(patches),
        diffusion=diffusion_network(diffusion, inputs=recipe.width) if diffusion else None,
        card=config["card"],
        device=device,
    )


def _single(array: npt.NDArray[Any]) -> npt.NDArray[np.float32]:
    """Weights as they compute, which a file may have rounded to 16 bits."""
    return array.astype(np.float32, copy=False)


def save_model(
    model: Model, folder: str | os.PathLike[str], *, half_precision: bool = False
) -> None:
    """Write a model folder whole, in place of a model that was there.

    Parameters
    ----------
    half_precision
        Whether weights are rounded to 16 bits, for half the room.

    Raises
    ------
    InputError
        If something else than a model is there, or it cannot be written.
    """
    folder = Path(folder)
    check_model_destination(folder)
    config = {
        "format": _FORMAT,
        "recipe": model.recipe.to_json(),
        "layers": layer_widths(model),
        "margin": model.margin,
        "limit": model.limit,
        "unit_length": model.unit_length,
        "patches": None if model.patches is None else asdict(model.patches),
        "card": dict(model.card),
    }
    arrays: dict[str, npt.NDArray[Any]] = {}
    for i, layer in enumerate(model.layers):
        arrays |= {f"layer{i}.weight": layer.weight, f"layer{i}.bias": layer.bias}
    if model.diffusion is not None:
        arrays |= {_DIFFUSION + name: array for name, array in model.diffusion.weights.items()}
    if half_precision:
        arrays = {name: array.astype(np.float16) for name, array in arrays.items()}
    arrays |= {"mean": model.mean, "deviation": model.deviation}
    weights = save({name: np.ascontiguousarray(array) for name, array in arrays.items()})
    with whole_folder(folder) as temporary:
        (temporary / "model.safetensors").write_bytes(weights)
        (temporary / "config.json").write_text(json.dumps(config, indent=2) + "\n")
        (temporary / "README.md").write_text(model_description(replace(model, name=folder.name)))


def check_model_destination(folder: Path) -> None:
    """Raise an `InputError` unless a model may be written there.

    A model is replaced as a whole folder, so a folder with any other file is refused.
    """
    check_can_be_made(folder)
    if not folder.exists():
        return
    held = {path.name for path in folder.iterdir()} if folder.is_dir() else set()
    if not folder.is_dir() or (held and not {"config.json", "model.safetensors"} <= held):
        raise InputError(f"'{folder}' exists and is no model; choose another name.")
    others = sorted(held - _FILES)
    if others:
        raise InputError(
            f"'{folder}' holds '{others[0]}', which is no file of a model and would be lost; move "
            "it, or choose another name."
        )


def layer_widths(model: Model) -> list[int]:
    """Numbers of neurons from input to output, (layers + 1,)."""
    return [model.recipe.width, *(len(layer.bias) for layer in model.layers)]


def _read_config(path: Path) -> dict[str, Any]:
    if path.stat().st_size > _LARGEST_CONFIG:
        raise InputError(f"'{path}' is larger than any model of this package has.")
    try:
        config = json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, OSError, RecursionError) as error:
        raise InputError(f"'{path}' is damaged: {error}.") from error
    if not isinstance(config, dict) or config.get("format") != _FORMAT:
        raise InputError(f"'{path}' is not of the model format {_FORMAT}; train the model again.")
    return config


def _read_weights(path: Path) -> dict[str, npt.NDArray[Any]]:
    if not path.is_file():
        raise InputError(f"There is no '{path}'.")
    if path.stat().st_size > _LARGEST_FILE:
        raise InputError(f"'{path}' is larger than any model of this package.")
    try:
        return load_file(path)
    except (SafetensorError, ValueError, OSError) as error:
        raise InputError(f"'{path}' is damaged: {error}.") from error


def _check_fit(model: Model, widths: Sequence[int], folder: Path) -> None:
    expected = [(model.recipe.width,)] * 2
    found = [model.mean.shape, model.deviation.shape]
    for layer, inputs, outputs in zip(model.layers, widths[:-1], widths[1:], strict=True):
        bins = model.patches.bins if model.patches and layer.weight.ndim > 2 else ()
        expected += [(outputs, *bins, inputs), (outputs,)]
        found += [layer.weight.shape, layer.bias.shape]
    if widths[0] != model.recipe.width or expected != found:
        raise InputError(
            f"The weights of '{folder}' do not fit its recipe of {model.recipe.width} descriptors: "
            "its files are of different models."
        )
    arrays = [model.mean, model.deviation, *(a for x in model.layers for a in (x.weight, x.bias))]
    if not all(array.dtype.kind == "f" and np.isfinite(array).all() for array in arrays):
        raise InputError(f"The weights of '{folder}' are not all finite: the training diverged.")
    if not (model.deviation > 0).all():
        raise InputError(f"The deviations of '{folder}' must be positive: its files are damaged.")


def model_description(model: Model) -> str:
    """The text of a model folder's `README.md`: descriptors, layers, training, and measurements.

    All else that the card holds, such as the names of the shapes, is in `config.json`.
    """
    parts = ", ".join(
        f"{'log ' if part.log else ''}{part.kind.upper()} ({part.count})"
        for part in model.recipe.descriptors
    )
    lines = [
        f"# {model.name}",
        "",
        "Embedding of spectral descriptors for point-to-point correspondence, by `esd`.",
        "",
        f"- Descriptors: {parts}, from {model.recipe.eigenpairs} eigenpairs",
        f"- {_layers_description(model)}",
        *_convolutions_description(model),
        *_training_description(model.card),
        *([f"- {model.card['note']}"] if "note" in model.card else []),
        *(f"- O{key[1:]}: {value}" for key, value in model.card.items() if key.startswith("on ")),
    ]
    return "\n".join(lines) + "\n"


def _layers_description(model: Model) -> str:
    layers = f"Layers: {' – '.join(map(str, layer_widths(model)))}"
    if model.diffusion is None:
        return layers
    weights = model.diffusion.weights
    network = (
        f"Network: {model.diffusion.block_count} blocks of {len(weights['0.time'])} features that "
        f"diffuse over the surface, {len(weights['out.bias'])} outputs"
    )
    return f"{layers}; {network.lower()}" if model.layers else network


def _training_description(card: Mapping[str, Any]) -> list[str]:
    """One line about the data and the steps of a training; none for a raw descriptor."""
    shapes, settings = card.get("shapes"), card.get("training")
    if not isinstance(shapes, list) or not isinstance(settings, Mapping):
        return []
    line = f"- Training: {len(shapes)} shapes of {card.get('data')}"
    if shapes:
        line += f" ({shapes[0]} … {shapes[-1]})"
    line += f", {card.get('steps_done')} steps"
    if loss := settings.get("loss"):
        line += f", loss {loss}"
    if held := card.get("validation_shapes"):
        line += f", validated on {len(held)} shapes"
    line += f", seed {card.get('seed')}"
    return [line + (f": `{card['command']}`" if "command" in card else "")]


def _convolutions_description(model: Model) -> list[str]:
    if model.patches is None:
        return []
    places = ", ".join(
        str(i) for i, layer in enumerate(model.layers, start=1) if layer.weight.ndim > 2
    )
    bins = " × ".join(map(str, model.patches.bins))
    return [f"- Convolutions: layers {places}, over {model.patches.kind} patches of {bins} bins"]
