"""Motion of an exported rig: weights over time, the head's turns, and pieces such as eyeballs that turn alone."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from facewright.io.gltf import GltfMesh


@dataclass(frozen=True, eq=False)
class TurningPiece:
    """A rigid piece of the rig that turns about a point of its own, as a child of the head.

    Parameters
    ----------
    name : str
        Name of its node.
    vertices : ndarray of shape (N,), int
        Its vertices; triangles of these alone are its triangles. Shapes do not move it.
    centre : ndarray of shape (3,), millimetres
        The point, where the rig stands neutral.
    rotation_wxyz : ndarray of shape (T, 4)
        Turn relative to the head at the clip's times, from where it stands in the neutral.
    """

    name: str
    vertices: NDArray[np.integer[Any]]
    centre: NDArray[np.floating[Any]]
    rotation_wxyz: NDArray[np.floating[Any]]


@dataclass(frozen=True, eq=False)
class RigClip:
    """A motion of the rig.

    Parameters
    ----------
    name : str
        Name of the clip.
    times : ndarray of shape (T,), seconds
        Strictly increasing.
    weights : ndarray of shape (T, B)
        Weights of the rig's own shapes.
    rotation_wxyz : ndarray of shape (T, 4), optional
        Turn of the head.
    translation : ndarray of shape (T, 3), millimetres, optional
        Where the head goes.
    pieces : tuple of TurningPiece
        What turns by itself; glTF only.
    curves : mapping of str to ndarray of shape (T,)
        Weights that programs look for under these names; glTF gets shapes for them that move nothing.
    """

    name: str
    times: NDArray[np.floating[Any]]
    weights: NDArray[np.floating[Any]]
    rotation_wxyz: NDArray[np.floating[Any]] | None = None
    translation: NDArray[np.floating[Any]] | None = None
    pieces: tuple[TurningPiece, ...] = ()
    curves: Mapping[str, NDArray[np.floating[Any]]] = field(default_factory=dict)


def split_pieces(mesh: GltfMesh, pieces: tuple[TurningPiece, ...]) -> tuple[GltfMesh, ...]:
    """Return the mesh without the pieces' triangles, all vertices kept, and each piece as a child without shapes."""
    parts = []
    for piece in pieces:
        number = np.full(len(mesh.vertices), -1)
        number[piece.vertices] = np.arange(len(piece.vertices))
        own = (number[mesh.faces] >= 0).all(axis=1)
        part = _with_triangles(mesh, own)
        mesh = _with_triangles(mesh, ~own)
        part = replace(
            part,
            name=piece.name,
            faces=number[part.faces].astype(np.int32),
            vertices=mesh.vertices[piece.vertices],
            normals=None if mesh.normals is None else mesh.normals[piece.vertices],
            vertex_colors=None if mesh.vertex_colors is None else mesh.vertex_colors[piece.vertices],
            morph_names=(),
            morph_deltas=None,
            morph_normals=None,
            weights=None,
            parent=0,
            pivot=piece.centre,
        )
        parts.append(part)
    return (mesh, *parts)


def _with_triangles(mesh: GltfMesh, kept: NDArray[np.bool_]) -> GltfMesh:
    """Return the mesh with some of its triangles."""
    uv_faces = mesh.faces if mesh.uv is not None and mesh.uv_faces is None else mesh.uv_faces
    return replace(
        mesh,
        faces=mesh.faces[kept],
        uv_faces=None if uv_faces is None else uv_faces[kept],
        face_materials=None if mesh.face_materials is None else mesh.face_materials[kept],
    )
