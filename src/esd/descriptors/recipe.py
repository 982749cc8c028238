"""A recipe: which descriptors are computed and how. It is data, and part of every model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any, get_args

import numpy as np

from esd.common import FloatArray, InputError, is_count, is_positive
from esd.descriptors.chirality import Parity, gradient_products, neighbour_pairs
from esd.descriptors.geometry import geometry_vector
from esd.descriptors.gps import gps
from esd.descriptors.hks import hks
from esd.descriptors.part import PART_WIDTH, part_descriptors
from esd.descriptors.sihks import sihks
from esd.descriptors.wks import wks
from esd.mesh.geometry import surface_area
from esd.mesh.mesh import Mesh, PointCloud
from esd.mesh.topology import boundary_edges, oriented_outward
from esd.spectral.cache import Cache
from esd.spectral.dirichlet import dirichlet_spectrum
from esd.spectral.laplacian import LaplacianKind
from esd.spectral.spectrum import Spectrum, spectrum

_DESCRIPTORS = {"gps": gps, "hks": hks, "wks": wks, "sihks": sihks, "geometry": geometry_vector}
_PRODUCTS: dict[str, Parity] = {"chirality": "odd", "alignment": "even"}
_WIDTHS = {"gps": 25, "hks": 100, "wks": 100, "sihks": 19, "geometry": 150}

_PARTS = "parts"  # the kind of `part_descriptors`, which have a recipe of their own

_OPTIONS = {"sihks": {"time_unit"}, "geometry": {"largest"}}
_PRODUCT_OPTIONS = {"of", "columns", "reach", "times"}

DESCRIPTOR_KINDS = tuple(_DESCRIPTORS)
"""Names of the descriptors that have a value at each vertex and are used by name."""


@dataclass(frozen=True, slots=True)
class Descriptor:
    """One descriptor of a recipe.

    Parameters
    ----------
    kind
        One of `DESCRIPTOR_KINDS`, or one of the `gradient_products`: `chirality` (odd) or
        `alignment` (even), on the mesh `oriented_outward`; or `parts`, see
        `esd.descriptors.part.part_descriptors`.
    count
        Number of its components.
    log
        Whether its logarithm is taken; for positive descriptors.
    options
        Further keyword arguments of the descriptor's function, such as `time_unit`. Gradient
        products have instead: `of`, the kind of the descriptor whose logarithm they are taken of;
        `columns`, which of its components; `reach`, with how many of those after it each of these
        is multiplied; and `times`.
    """

    kind: str
    count: int
    log: bool = False
    options: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.kind not in (*_DESCRIPTORS, *_PRODUCTS, _PARTS):
            known = ", ".join((*_DESCRIPTORS, *_PRODUCTS, _PARTS))
            raise InputError(f"There is no descriptor '{self.kind}'; expected one of {known}.")
        if self.log and self.kind in ("gps", *_PRODUCTS, _PARTS):
            raise InputError(f"'{self.kind}' has negative components: it has no logarithm.")
        if not is_count(self.count) or not isinstance(self.log, bool):
            raise InputError(
                f"'{self.kind}' needs a `count` of one or more, and `log` true or false; got "
                f"{self.count!r} and {self.log!r}."
            )
        if not isinstance(self.options, Mapping):
            raise InputError(f"The options of '{self.kind}' must have names; got {self.options!r}.")
        if self.kind == _PARTS and self.count != PART_WIDTH:
            raise InputError(
                f"'{_PARTS}' has {PART_WIDTH} components; its `count` is {self.count}."
            )
        if self.kind in _PRODUCTS:
            self._check_product()
        elif not set(self.options) <= _OPTIONS.get(self.kind, set()) or not all(
            is_positive(value) for value in self.options.values()
        ):
            known = ", ".join(sorted(_OPTIONS.get(self.kind, ()))) or "none"
            raise InputError(
                f"'{self.kind}' has these options: {known}, of positive numbers; got "
                f"{dict(self.options)!r}."
            )

    def _check_product(self) -> None:
        """Refuse options of gradient products that are not as `gradient_recipe` makes them."""
        found = dict(self.options)
        columns: Any = found.get("columns")
        times: Any = found.get("times")
        width = _WIDTHS.get(str(found.get("of")), 0)
        is_sound = (
            set(found) == _PRODUCT_OPTIONS
            and found["of"] in _DESCRIPTORS
            and isinstance(columns, list | tuple)
            and all(type(column) is int and 0 <= column < width for column in columns)
            and is_count(found["reach"])
            and isinstance(times, list | tuple)
            and all(is_positive(time) for time in times)
        )
        if not is_sound:
            raise InputError(
                f"'{self.kind}' needs the options of (a descriptor), columns (of it), reach (one "
                f"or more) and times (positive); got {found!r}."
            )
        count = len(neighbour_pairs(len(columns), reach=found["reach"])) * len(times)
        if count != self.count:
            raise InputError(
                f"'{self.kind}' of {len(columns)} columns, reach {found['reach']} and "
                f"{len(times)} times has {count} components; its `count` is {self.count}."
            )


@dataclass(frozen=True, slots=True)
class Recipe:
    """Which descriptors are concatenated in the columns, and of which spectrum.

    Parameters
    ----------
    descriptors
        In the order of their columns.
    eigenpairs
        Number of eigenpairs, the constant ones included.
    laplacian
        Which Laplacian, see `esd.spectral.laplacian`.
    unit_area
        Whether the shape is scaled to unit area first, which makes all independent of its units.
    """

    descriptors: tuple[Descriptor, ...]
    eigenpairs: int = 300
    laplacian: LaplacianKind = "cotangent"
    unit_area: bool = True

    def __post_init__(self) -> None:
        if not self.descriptors:
            raise InputError("A descriptor recipe needs one descriptor or more; got none.")
        if self.is_of_parts and len(self.descriptors) > 1:
            raise InputError(f"'{_PARTS}' are all of a recipe: there are no others beside them.")
        kinds = get_args(LaplacianKind)
        if self.laplacian not in kinds:
            raise InputError(
                f"There is no Laplacian '{self.laplacian}'; expected one of {', '.join(kinds)}."
            )
        if not is_count(self.eigenpairs) or not isinstance(self.unit_area, bool):
            raise InputError(
                "A descriptor recipe needs `eigenpairs`, one or more, and `unit_area`, true or "
                f"false; got {self.eigenpairs!r} and {self.unit_area!r}."
            )

    @property
    def width(self) -> int:
        """Number of columns."""
        return sum(part.count for part in self.descriptors)

    @property
    def is_of_parts(self) -> bool:
        """Whether it is that of `esd.descriptors.part.part_descriptors`."""
        return any(part.kind == _PARTS for part in self.descriptors)

    def to_json(self) -> dict[str, Any]:
        """The recipe as plain data, from which `from_json` makes an equal one."""
        return asdict(self)

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Recipe:
        """The recipe of `to_json`.

        Raises
        ------
        InputError
            If the data describe none.
        """
        try:
            if not isinstance(data["descriptors"], list | tuple):
                raise TypeError("`descriptors` must be a list")
            parts = tuple(Descriptor(**part) for part in data["descriptors"])
            return cls(**{**data, "descriptors": parts})
        except (TypeError, KeyError) as error:
            raise InputError(f"This is no descriptor recipe: {error}.") from error


def single_recipe(kind: str, *, log: bool = False) -> Recipe:
    """The recipe of one descriptor with the paper's parameters.

    Raises
    ------
    InputError
        If there is no such descriptor, or it is made of another one.
    """
    if kind not in _WIDTHS:
        raise InputError(f"There is no descriptor '{kind}'; expected one of {', '.join(_WIDTHS)}.")
    return Recipe((Descriptor(kind, _WIDTHS[kind], log=log),))


def part_recipe() -> Recipe:
    """The recipe of `esd.descriptors.part.part_descriptors`."""
    return Recipe((Descriptor(_PARTS, PART_WIDTH),))


def gradient_recipe(
    kind: str, of: str, *, columns: Sequence[int], reach: int, times: Sequence[float]
) -> Descriptor:
    """The `chirality` or `alignment` of the logarithm of a descriptor, as part of a recipe."""
    count = len(neighbour_pairs(len(columns), reach=reach)) * len(times)
    options = {"of": of, "columns": list(columns), "reach": reach, "times": list(times)}
    return Descriptor(kind, count, options=options)


def descriptors(
    recipe: Recipe, shape: Mesh | PointCloud, *, cache: Cache | None = None
) -> FloatArray:
    """Values of a recipe's descriptors, (n, recipe.width); NaN at vertices without a face.

    Parameters
    ----------
    cache
        Where the spectrum is looked up and kept.

    Raises
    ------
    InputError
        If the mesh has too few vertices for the recipe.
    """
    spectrum = recipe_spectrum(recipe, shape, cache=cache)
    return spectrum_descriptors(recipe, shape, spectrum, cache=cache)


def recipe_spectrum(
    recipe: Recipe, shape: Mesh | PointCloud, *, cache: Cache | None = None
) -> Spectrum:
    """The spectrum of a shape that a recipe asks for."""
    found = spectrum(shape, recipe.eigenpairs, kind=recipe.laplacian, cache=cache)
    if recipe.unit_area:
        return found
    if isinstance(shape, PointCloud):
        raise InputError("The area of a point cloud is not known; take a recipe for unit area.")
    return found.with_area(surface_area(shape))


def spectrum_descriptors(
    recipe: Recipe,
    shape: Mesh | PointCloud,
    spectrum: Spectrum,
    *,
    single: bool = False,
    cache: Cache | None = None,
) -> FloatArray:
    """Values of a recipe's descriptors from the `recipe_spectrum` of a shape, (n, recipe.width).

    The spectrum of a part may have its share of the whole's area, see
    `esd.descriptors.part.part_descriptors`.

    Parameters
    ----------
    single
        Whether they are in 32 bits, which takes half the time and memory. They are computed in
        64 bits but for the diffusion of gradient products, which is off by 1e-5 at the most.
    cache
        Where the spectrum under Dirichlet conditions is looked up and kept, for parts.

    Raises
    ------
    InputError
        If the recipe has chirality, and the mesh no outside or the points no faces.
    """
    products = [part for part in recipe.descriptors if part.kind in (*_PRODUCTS, _PARTS)]
    if products and isinstance(shape, PointCloud):
        raise InputError(
            f"Points have no faces, which '{products[0].kind}' needs; take hks, wks or gps, or a "
            "model of these."
        )
    outward = oriented_outward(shape) if products and isinstance(shape, Mesh) else None
    if outward and recipe.is_of_parts:
        held = None
        if len(boundary_edges(outward)):
            held = dirichlet_spectrum(outward, recipe.eigenpairs, cache=cache)
            held = held.with_area(spectrum.area)
        described = part_descriptors(outward, spectrum, held)
        described[spectrum.mass == 0] = np.nan
        return described.astype(np.float32) if single else described
    fields = {
        of: _values(Descriptor(of, _WIDTHS[of], log=True), spectrum)
        for of in sorted({part.options["of"] for part in products})
    }
    dtype = np.float32 if single else np.float64
    diffusing = replace(spectrum, eigenvectors=spectrum.eigenvectors.astype(dtype, copy=False))
    # filled part by part: the largest array
    values = np.empty((len(spectrum.mass), recipe.width), dtype=dtype)
    end = 0
    for part in recipe.descriptors:
        start, end = end, end + part.count
        if outward and part.kind in _PRODUCTS:
            field = fields[part.options["of"]][:, part.options["columns"]]
            values[:, start:end] = _gradient_values(part, outward, diffusing, field)
        elif part.kind in fields and part == Descriptor(part.kind, _WIDTHS[part.kind], log=True):
            values[:, start:end] = fields[part.kind]
        else:
            values[:, start:end] = _values(part, spectrum)
    values[spectrum.mass == 0] = np.nan
    return values


def _values(part: Descriptor, spectrum: Spectrum) -> FloatArray:
    compute: Any = _DESCRIPTORS[part.kind]
    values: FloatArray = compute(spectrum, count=part.count, **part.options)
    return np.log(np.maximum(values, np.finfo(float).tiny)) if part.log else values


def _gradient_values(
    part: Descriptor, mesh: Mesh, spectrum: Spectrum, fields: FloatArray
) -> FloatArray:
    return gradient_products(
        mesh,
        spectrum,
        fields,
        pairs=neighbour_pairs(fields.shape[1], reach=part.options["reach"]),
        times=np.asarray(part.options["times"]),
        parity=_PRODUCTS[part.kind],
    )
