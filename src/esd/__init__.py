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
    from esd.datasets.open import open_collection as open_collection
    from esd.learning.model import Model as Model
    from esd.learning.model import load_model as load_model
    from esd.matching.correspondence import Correspondence as Correspondence
    from esd.matching.correspondence import load_map as load_map
    from esd.matching.correspondence import save_map as save_map
    from esd.matching.match import match as match
    from esd.mesh.convert import as_mesh as as_mesh
    from esd.mesh.convert import with_attributes as with_attributes
    from esd.mesh.io.meshes import read_mesh as read_mesh
    from esd.mesh.io.meshes import write_mesh as write_mesh
    from esd.mesh.mesh import Mesh as Mesh
    from esd.mesh.repair.repair import diagnose as diagnose
    from esd.mesh.repair.repair import repair as repair
    from esd.viewing.page import view as view

__version__ = "0.2.0.dev0"

_HOMES = {
    "Correspondence": "esd.matching.correspondence",
    "InputError": "esd.common",
    "Mesh": "esd.mesh.mesh",
    "Model": "esd.learning.model",
    "as_mesh": "esd.mesh.convert",
    "diagnose": "esd.mesh.repair.repair",
    "load_map": "esd.matching.correspondence",
    "load_model": "esd.learning.model",
    "match": "esd.matching.match",
    "open_collection": "esd.datasets.open",
    "read_mesh": "esd.mesh.io.meshes",
    "repair": "esd.mesh.repair.repair",
    "save_map": "esd.matching.correspondence",
    "view": "esd.viewing.page",
    "with_attributes": "esd.mesh.convert",
    "write_mesh": "esd.mesh.io.meshes",
}

__all__ = sorted([*_HOMES, "__version__"])


def __getattr__(name: str) -> object:
    """Import a public name when it is first used, which keeps the start of programs short."""
    if name not in _HOMES:
        raise AttributeError(f"module 'esd' has no attribute '{name}'")
    return getattr(import_module(_HOMES[name]), name)
