"""Point-to-point correspondence between deformable 3D shapes, learned on a laptop.

import esd
match = esd.match("source.ply", "target.ply")
match.target_index[i]  # the target vertex of source vertex i
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from esd.common import InputError as InputError
    from esd.datasets.collection import Collection as Collection
    from esd.datasets.open import open_collection as open_collection
    from esd.descriptors.gps import gps as gps
    from esd.descriptors.hks import hks as hks
    from esd.descriptors.wks import wks as wks
    from esd.evaluation.protocol import evaluate as evaluate
    from esd.learning.fit import fit
    from esd.learning.model import Model as Model
    from esd.learning.model import load_model as load_model
    from esd.learning.model import save_model as save_model
    from esd.learning.presets import preset as preset
    from esd.matching.along import transfer as transfer
    from esd.matching.correspondence import Correspondence as Correspondence
    from esd.matching.correspondence import load_map as load_map
    from esd.matching.correspondence import save_map as save_map
    from esd.matching.match import match as match
    from esd.matching.refine import zoomout as zoomout
    from esd.mesh.convert import as_mesh as as_mesh
    from esd.mesh.convert import with_attributes as with_attributes
    from esd.mesh.geodesics import geodesic_distances as geodesic_distances
    from esd.mesh.io.meshes import read_mesh as read_mesh
    from esd.mesh.io.meshes import write_mesh as write_mesh
    from esd.mesh.mesh import Mesh as Mesh
    from esd.mesh.mesh import PointCloud as PointCloud
    from esd.mesh.repair.diagnose import diagnose as diagnose
    from esd.mesh.repair.repair import repair as repair
    from esd.parallel import Workers as Workers
    from esd.population.atlas import atlas as atlas
    from esd.population.shape_model import ShapeModel as ShapeModel
    from esd.population.shape_model import load_shape_model as load_shape_model
    from esd.population.shape_model import save_shape_model as save_shape_model
    from esd.registration.register import register as register
    from esd.registration.register import register_sequence as register_sequence
    from esd.spectral.spectrum import Spectrum as Spectrum
    from esd.spectral.spectrum import spectrum as spectrum
    from esd.viewing.page import view as view

    train = fit

__version__ = "0.2.0.dev0"

_HOMES = {
    "Collection": "esd.datasets.collection",
    "Correspondence": "esd.matching.correspondence",
    "InputError": "esd.common",
    "Mesh": "esd.mesh.mesh",
    "Model": "esd.learning.model",
    "PointCloud": "esd.mesh.mesh",
    "Spectrum": "esd.spectral.spectrum",
    "Workers": "esd.parallel",
    "ShapeModel": "esd.population.shape_model",
    "as_mesh": "esd.mesh.convert",
    "atlas": "esd.population.atlas",
    "diagnose": "esd.mesh.repair.diagnose",
    "evaluate": "esd.evaluation.protocol",
    "geodesic_distances": "esd.mesh.geodesics",
    "gps": "esd.descriptors.gps",
    "hks": "esd.descriptors.hks",
    "load_map": "esd.matching.correspondence",
    "load_model": "esd.learning.model",
    "load_shape_model": "esd.population.shape_model",
    "match": "esd.matching.match",
    "open_collection": "esd.datasets.open",
    "preset": "esd.learning.presets",
    "read_mesh": "esd.mesh.io.meshes",
    "register": "esd.registration.register",
    "register_sequence": "esd.registration.register",
    "repair": "esd.mesh.repair.repair",
    "save_map": "esd.matching.correspondence",
    "save_model": "esd.learning.model",
    "save_shape_model": "esd.population.shape_model",
    "spectrum": "esd.spectral.spectrum",
    "train": "esd.learning.fit:fit",
    "transfer": "esd.matching.along",
    "view": "esd.viewing.page",
    "with_attributes": "esd.mesh.convert",
    "wks": "esd.descriptors.wks",
    "write_mesh": "esd.mesh.io.meshes",
    "zoomout": "esd.matching.refine",
}

__all__ = sorted([*_HOMES, "__version__"])


def __getattr__(name: str) -> object:
    """Import a public name when it is first used, which keeps the start of programs short."""
    if name not in _HOMES:
        raise AttributeError(f"module 'esd' has no attribute '{name}'")
    module, _, known_there_as = _HOMES[name].partition(":")
    return getattr(import_module(module), known_there_as or name)


def __dir__() -> list[str]:
    return list(__all__)
