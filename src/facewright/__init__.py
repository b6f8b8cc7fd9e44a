"""facewright: the open toolkit for 3D faces that move."""

__version__ = "0.1.0"
