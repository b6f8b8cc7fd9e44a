"""Texture coordinates of the built-in face: the skin in one piece, small islands for mouth, eyes and teeth."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from facewright.faces.builtin_mesh import ControlMesh
from facewright.faces.builtin_parts import Part

SKIN_BOX = (0.005, 0.205, 0.79)  # left, bottom and side of the skin's square
PART_BOXES = {  # left, bottom, width, height
    "mouth_cavity": (0.81, 0.205, 0.18, 0.18),
    "eyeball_left": (0.81, 0.815, 0.18, 0.18),
    "eyeball_right": (0.81, 0.615, 0.18, 0.18),
    "teeth_upper": (0.005, 0.105, 0.985, 0.09),
    "teeth_lower": (0.005, 0.005, 0.985, 0.09),
}


def build_atlas(
    data: Mapping[str, NDArray], control: ControlMesh, rigid: Mapping[str, Part], mean: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Lay out all islands.

    Parameters
    ----------
    data : mapping of str to ndarray
        The face's tables: ``skin_uv``, ``skin_seam``, ``cavity_uv``.
    control : ControlMesh
        Skin and mouth cavity.
    rigid : mapping of str to Part
        Eyeballs and teeth.
    mean : ndarray of shape (V, 3), millimetres
        The mean, to tell the two sides of the seam.

    Returns
    -------
    uv : ndarray of shape (U, 2), float64
        Texture points in [0, 1], v upwards.
    uv_quads : ndarray of shape (Q, 4), int32
        Texture points of the corners of control and rigid quads, in that order; -1 pads a triangle.
    """
    left, bottom, side = SKIN_BOX
    skin = np.array([left, bottom]) + side * data["skin_uv"] / 65535.0
    n_skin = len(skin) - (len(data["skin_seam"]) - 1)

    corners = control.quads.astype(np.int64)
    in_cavity = (corners >= n_skin).any(axis=1) | data["cavity_quads"]
    real = corners >= 0
    count = real.sum(axis=1)
    x = np.where(real, mean[np.maximum(corners, 0), 0], 0.0).sum(axis=1) / count
    duplicate = np.arange(n_skin + 1)
    seam = data["skin_seam"][:-1].astype(np.int64)
    duplicate[seam] = n_skin + np.arange(len(seam))
    uv_quads = corners.copy()
    right = (x < 0) & ~in_cavity
    uv_quads[right] = np.where(corners[right] >= 0, duplicate[np.maximum(corners[right], 0)], -1)

    pieces, stop = [skin], len(skin)
    cavity_vertices = np.unique(corners[in_cavity][real[in_cavity]])
    local = np.searchsorted(cavity_vertices, np.maximum(corners[in_cavity], 0)) + stop
    uv_quads[in_cavity] = np.where(corners[in_cavity] >= 0, local, -1)
    pieces.append(_place(data["cavity_uv"] / 65535.0, "mouth_cavity"))
    stop += len(cavity_vertices)

    all_quads = [uv_quads]
    for name, part in rigid.items():
        uv, quads = _part_uv(part, name)
        all_quads.append(np.where(part.quads >= 0, quads + stop, -1))
        pieces.append(_place(uv, name))
        stop += len(uv)
    return np.concatenate(pieces), np.concatenate(all_quads).astype(np.int32)


def _place(uv: NDArray[np.float64], name: str) -> NDArray[np.float64]:
    left, bottom, width, height = PART_BOXES[name]
    return np.array([left, bottom]) + uv * np.array([width, height])


def _part_uv(part: Part, name: str) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return texture points and corners of a part: an eyeball cut at its back pole, a tube of teeth along its top."""
    return _eye_uv(part) if name.startswith("eyeball") else _teeth_uv(part, flip=name.endswith("upper"))


def _eye_uv(part: Part) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Give each triangle at the back pole a pole of its own, on the rim of the disc."""
    uv, quads = part.uv, part.quads.astype(np.int64)
    pole = len(uv) - 1
    fan = np.flatnonzero((quads == pole).any(axis=1))
    middle = uv[quads[fan, :3]].sum(axis=1) - uv[pole] - 1.0  # twice the middle of the two others, from the centre
    rim = 0.5 + 0.5 * middle / np.linalg.norm(middle, axis=1, keepdims=True)
    quads[fan] = np.where(quads[fan] == pole, (pole + np.arange(len(fan)))[:, None], quads[fan])
    return np.concatenate([uv[:pole], rim]), quads


def _teeth_uv(part: Part, flip: bool) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Unroll the tube: quads from its last row back to its first take copies of the first above the last."""
    uv, quads = part.uv, part.quads.astype(np.int64)
    last = uv[:, 1].max()
    first_row = np.flatnonzero(uv[:, 1] == 0.0)
    copy_of = np.arange(len(uv))
    copy_of[first_row] = len(uv) + np.arange(len(first_row))
    v = uv[quads, 1]
    closing = (v == 0.0).any(axis=1) & (v == last).any(axis=1)
    quads = np.where(closing[:, None] & (quads >= 0), copy_of[quads], quads)
    out = np.concatenate([uv, np.stack([uv[first_row, 0], np.full(len(first_row), last * 1.25)], axis=1)])
    out[:, 1] /= out[:, 1].max()
    if flip:
        out[:, 1] = 1.0 - out[:, 1]
    out[:, 0] = 0.02 + 0.96 * out[:, 0]
    return _cap_uv(part, out, quads)


def _cap_uv(
    part: Part, uv: NDArray[np.float64], quads: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Put each end of the tube (a quad and a triangle, listed last) on a small island beside the strip."""
    for rows, centre in (((-4, -3), 0.009), ((-2, -1), 0.991)):
        # the quad's corners go round the pentagon with one vertex left out, which is the triangle's middle
        quad, triangle = part.quads[rows[0]], part.quads[rows[1], :3]
        ring = [quad[0], quad[1], triangle[np.isin(triangle, quad, invert=True)][0], quad[2], quad[3]]
        turn = 2.0 * np.pi * np.arange(5) / 5
        island = np.stack([centre + 0.007 * np.cos(turn), 0.5 + 0.3 * np.sin(turn)], axis=1)
        place = {int(v): len(uv) + k for k, v in enumerate(ring)}
        for row in rows:
            quads[row] = [place.get(int(v), -1) for v in part.quads[row]]
        uv = np.concatenate([uv, island])
    return uv, quads
