"""The nouns of a glTF file, in the project's units: millimetres, v upwards, quaternions wxyz."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from facewright.errors import ValueRangeError
from facewright.numeric.check import check_finite, check_indices, check_shape


@dataclass(frozen=True, eq=False)
class GltfMaterial:
    """A surface's look.

    Parameters
    ----------
    name : str
        Such as ``"skin"``.
    base_color_linear : tuple of 4 floats
        Linear red, green, blue, alpha in [0, 1]; multiplies texture and vertex colours.
    texture : ndarray of shape (H, W, 3), uint8, or None
        sRGB picture, first row on top.
    metallic, roughness : float
        In [0, 1].
    double_sided : bool
        Draw back faces too.
    """

    name: str
    base_color_linear: tuple[float, float, float, float] = (1.0, 1.0, 1.0, 1.0)
    texture: NDArray[np.uint8] | None = None
    metallic: float = 0.0
    roughness: float = 0.6
    double_sided: bool = False

    def __post_init__(self) -> None:
        if self.texture is not None:
            check_shape(f"texture of material {self.name!r}", self.texture, "H", "W", 3)
            if self.texture.dtype != np.uint8:
                raise ValueRangeError(f"texture must be uint8, got {self.texture.dtype}.")


@dataclass(frozen=True, eq=False)
class GltfMesh:
    """A mesh with morph targets; one material per triangle.

    Parameters
    ----------
    name : str
        Name of mesh and node.
    vertices : ndarray of shape (V, 3), millimetres
        Positions.
    faces : ndarray of shape (F, 3), int
        Triangles, counter-clockwise seen from outside.
    materials : tuple of GltfMaterial
        The looks that `face_materials` chooses from.
    face_materials : ndarray of shape (F,), int, or None
        Index into `materials`; all 0 where None.
    uv, uv_faces : ndarray of shape (U, 2) and (F, 3), or None
        Texture coordinates, v upwards, and their corners; `faces` where only `uv` is given.
    normals : ndarray of shape (V, 3), or None
        Unit normals.
    vertex_colors : ndarray of shape (V, 3), uint8, or None
        sRGB colours.
    morph_names : tuple of str
        Names of the B morph targets.
    morph_deltas : ndarray of shape (B, V, 3), millimetres, or None
        Displacements at weight one.
    morph_normals : ndarray of shape (B, V, 3), or None
        Change of the normals at weight one.
    weights : ndarray of shape (B,), or None
        Weights at rest.
    parent : int or None
        Index of an earlier mesh of the scene; this one goes along with its node.
    pivot : ndarray of shape (3,), millimetres, or None
        Origin of its node, about which it turns, in the coordinates of `vertices`; zero where None.
    """

    name: str
    vertices: NDArray[np.floating[Any]]
    faces: NDArray[np.integer[Any]]
    materials: tuple[GltfMaterial, ...] = ()
    face_materials: NDArray[np.integer[Any]] | None = None
    uv: NDArray[np.floating[Any]] | None = None
    uv_faces: NDArray[np.integer[Any]] | None = None
    normals: NDArray[np.floating[Any]] | None = None
    vertex_colors: NDArray[np.uint8] | None = None
    morph_names: tuple[str, ...] = ()
    morph_deltas: NDArray[np.floating[Any]] | None = None
    morph_normals: NDArray[np.floating[Any]] | None = None
    weights: NDArray[np.floating[Any]] | None = None
    parent: int | None = None
    pivot: NDArray[np.floating[Any]] | None = None

    def __post_init__(self) -> None:
        V = check_shape("vertices", self.vertices, "V", 3)["V"]
        F = check_shape("faces", self.faces, "F", 3)["F"]
        check_finite("vertices", self.vertices)
        check_indices("faces", self.faces, V)
        if self.face_materials is not None:
            check_shape("face_materials", self.face_materials, F)
            check_indices("face_materials", self.face_materials, max(1, len(self.materials)))
        if self.uv is not None:
            U = check_shape("uv", self.uv, "U", 2)["U"]
            corners = self.faces if self.uv_faces is None else self.uv_faces
            check_shape("uv_faces", corners, F, 3)
            check_indices("uv_faces", corners, U)
        for name in ("normals", "vertex_colors"):
            if getattr(self, name) is not None:
                check_shape(name, getattr(self, name), V, 3)
        B = len(self.morph_names)
        if (self.morph_deltas is None) != (B == 0):
            raise ValueRangeError(f"morph_deltas must be given with morph_names, got {B} names.")
        for name in ("morph_deltas", "morph_normals"):
            if getattr(self, name) is not None:
                check_shape(name, getattr(self, name), B, V, 3)
                check_finite(name, getattr(self, name))
        if self.weights is not None:
            check_shape("weights", self.weights, B)
        if self.pivot is not None:
            check_shape("pivot", self.pivot, 3)
            check_finite("pivot", self.pivot)


@dataclass(frozen=True, eq=False)
class GltfAnimation:
    """Motion of one mesh: morph weights, and rotation and translation of its node.

    Parameters
    ----------
    name : str
        Name of the clip.
    times : ndarray of shape (T,), seconds
        Strictly increasing, not negative; linear in between.
    mesh : int
        Index of the mesh in its scene.
    weights : ndarray of shape (T, B), or None
        Morph weights.
    rotation_wxyz : ndarray of shape (T, 4), or None
        Unit quaternions, parent (or scene) from mesh, about the mesh's pivot.
    translation : ndarray of shape (T, 3), millimetres, or None
        Of the mesh's pivot, from the parent's (or the scene's origin).
    """

    name: str
    times: NDArray[np.floating[Any]]
    mesh: int = 0
    weights: NDArray[np.floating[Any]] | None = None
    rotation_wxyz: NDArray[np.floating[Any]] | None = None
    translation: NDArray[np.floating[Any]] | None = None

    def __post_init__(self) -> None:
        T = check_shape("times", self.times, "T")["T"]
        check_finite("times", self.times)
        if not T or self.times[0] < 0 or (np.diff(self.times) <= 0).any():
            raise ValueRangeError(f"times must be strictly increasing from 0 or later, got {T} times that are not.")
        for name, columns in (("weights", "B"), ("rotation_wxyz", 4), ("translation", 3)):
            if getattr(self, name) is not None:
                check_shape(name, getattr(self, name), T, columns)
                check_finite(name, getattr(self, name))


@dataclass(frozen=True, eq=False)
class GltfScene:
    """All that a glTF file holds for this project.

    Parameters
    ----------
    meshes : tuple of GltfMesh
        The meshes of the scene, parents before their children.
    animations : tuple of GltfAnimation
        Clips; motions of several meshes with one name are one clip.
    copyright : str
        Licence and attribution line of the file.
    extras : mapping
        JSON values kept with the file.
    """

    meshes: tuple[GltfMesh, ...]
    animations: tuple[GltfAnimation, ...] = ()
    copyright: str = ""
    extras: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for index, mesh in enumerate(self.meshes):
            if mesh.parent is not None:
                check_indices("parent of a mesh", np.array([mesh.parent]), index)
        for animation in self.animations:
            check_indices("mesh of an animation", np.array([animation.mesh]), len(self.meshes))
            if animation.weights is not None:
                B = len(self.meshes[animation.mesh].morph_names)
                check_shape(f"weights of animation {animation.name!r}", animation.weights, len(animation.times), B)
