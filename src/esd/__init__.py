"""Point-to-point correspondence between deformable 3D shapes, learned on a laptop."""

__version__ = "0.1.0.dev0"
