"""Reading and writing meshes, under the module's former name; see `esd.mesh.io.meshes`."""

from esd.mesh.io.meshes import FORMATS, read_arrays, read_mesh, write_mesh

__all__ = ["FORMATS", "read_arrays", "read_mesh", "write_mesh"]
