"""The built-in face: a control cage of 599 vertices with measured displacements, subdivided when it is loaded."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Mapping
from importlib import resources

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from facewright.errors import FileFormatError
from facewright.faces.blendshape_names import BLENDSHAPE_NAMES
from facewright.faces.builtin_atlas import build_atlas
from facewright.faces.builtin_mesh import ControlMesh, build_control_mesh
from facewright.faces.builtin_parts import (
    EYE_SEGMENTS,
    IRIS_RINGS,
    PUPIL_RINGS,
    Part,
    build_rigid_parts,
    handle_weights,
)
from facewright.faces.face import Face
from facewright.mesh.topology import Topology

BUILTIN_LICENCE = (
    "Apache-2.0; shape figures measured on ICT-FaceKit, MIT, Copyright (c) 2020 USC Institute for Creative Technologies"
)
_MIRROR_X = np.array([-1.0, 1.0, 1.0])


def load_builtin_face() -> Face:
    """Build the face that comes with the package.

    Its shape is a linear function of a table of control points: the cage of skin and mouth cavity, subdivided twice by
    Catmull-Clark (once where nobody looks), and four handles for each eyeball and each row of teeth.

    Returns
    -------
    Face
        About 6,900 vertices, 60 identity modes, 46 blendshapes, mm.

    Raises
    ------
    FileFormatError
        If the package's data file is damaged.
    """
    data = _read()
    n_cage = len(data["cage_mirror"])
    control = build_control_mesh(
        data["cage_faces"], n_cage, data["cage_is_fine"], data["cage_part"], data["cage_mirror"]
    )
    rigid = build_rigid_parts()
    points_from_controls = _full_matrix(control, rigid)
    parts, mirror = _layout(control, rigid)
    mean = points_from_controls @ data["mean"].astype(np.float64)
    mean = 0.5 * (mean + mean[mirror] * _MIRROR_X)
    topology = _topology(data, control, rigid, parts, mirror, mean)
    names = [str(name) for name in data["expression_names"]]
    order = [names.index(name) for name in BLENDSHAPE_NAMES]
    return Face(
        name="builtin",
        topology=topology,
        mean_shape=mean.astype(np.float32),
        identity_basis=_expand(points_from_controls, _table(data, "identity")),
        blendshape_names=BLENDSHAPE_NAMES,
        blendshape_deltas=_expand(points_from_controls, _table(data, "expression")[order]),
        rigid_parts={"teeth_upper": "skull", "teeth_lower": "jaw", "eyeball_left": "eye", "eyeball_right": "eye"},
        licence=BUILTIN_LICENCE,
    )


def _read() -> dict[str, NDArray]:
    content = (resources.files("facewright.faces") / "data" / "builtin_face.npz").read_bytes()
    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as archive:
            return {key: archive[key] for key in archive.files}
    except (ValueError, EOFError, KeyError, zipfile.BadZipFile) as error:
        raise FileFormatError(f"builtin_face.npz must be the built-in face's data, got {error}.") from error


def _table(data: Mapping[str, NDArray], name: str) -> NDArray[np.float64]:
    """Undo the rounding to 16 bits: displacement tables (N, controls, 3) in mm."""
    return data[f"{name}_values"] * data[f"{name}_step"][:, None, None]


def _full_matrix(control: ControlMesh, rigid: Mapping[str, Part]) -> sparse.csr_matrix:
    """Stack the cage's subdivision and the rigid parts' handle weights: (V, controls)."""
    blocks = [sparse.csr_matrix(handle_weights(k, part.vertices)) for k, part in enumerate(rigid.values())]
    return sparse.block_diag([control.matrix, *blocks], format="csr")


def _expand(matrix: sparse.csr_matrix, tables: NDArray[np.float64]) -> NDArray[np.float32]:
    """Apply the matrix to every table: (N, V, 3)."""
    n, controls, _ = tables.shape
    flat = matrix @ tables.transpose(1, 0, 2).reshape(controls, n * 3)
    return np.ascontiguousarray(flat.reshape(-1, n, 3).transpose(1, 0, 2), dtype=np.float32)


def _layout(control: ControlMesh, rigid: Mapping[str, Part]) -> tuple[dict[str, tuple[int, int]], NDArray[np.int32]]:
    """Return the vertex range of each part and the mirror map of all vertices."""
    parts, stop = dict(control.parts), len(control.mirror)
    for name, part in rigid.items():
        parts[name] = (stop, stop + len(part.vertices))
        stop += len(part.vertices)
    mirror = [control.mirror]
    for name, part in rigid.items():
        other = name.replace("left", "#").replace("right", "left").replace("#", "right")
        mirror.append(part.mirror + parts[other][0])
    return parts, np.concatenate(mirror).astype(np.int32)


def _topology(
    data: Mapping[str, NDArray],
    control: ControlMesh,
    rigid: Mapping[str, Part],
    parts: dict[str, tuple[int, int]],
    mirror: NDArray[np.int32],
    mean: NDArray[np.float64],
) -> Topology:
    quads = [control.quads]
    for name, part in rigid.items():
        quads.append(np.where(part.quads >= 0, part.quads + parts[name][0], -1).astype(np.int32))
    all_quads = np.concatenate(quads)
    uv, uv_quads = build_atlas(data, control, rigid, mean)
    along_13 = shorter_diagonals(mean, all_quads, np.minimum(np.arange(len(mirror)), mirror))
    return Topology(
        name="builtin",
        n_vertices=len(mean),
        faces=split_quads(all_quads, along_13),
        quads=all_quads,
        uv=uv.astype(np.float32),
        uv_faces=split_quads(uv_quads, along_13),
        parts=parts,
        masks=_masks(data, parts),
        landmarks={k[10:]: v.astype(np.int32) for k, v in data.items() if k.startswith("landmarks_")},
        mirror=mirror,
    )


def _masks(data: Mapping[str, NDArray], parts: Mapping[str, tuple[int, int]]) -> dict[str, NDArray[np.int32]]:
    masks = {k[5:]: v.astype(np.int32) for k, v in data.items() if k.startswith("mask_")}
    for side in ("left", "right"):
        start = parts[f"eyeball_{side}"][0]
        for name, rings in (("pupil", PUPIL_RINGS), ("iris", IRIS_RINGS)):
            masks[f"{name}_{side}"] = np.arange(start, start + 1 + rings * EYE_SEGMENTS, dtype=np.int32)
    return masks


def shorter_diagonals(
    points: NDArray[np.float64], quads: NDArray[np.int32], key: NDArray[np.integer]
) -> NDArray[np.bool_]:
    """Tell which quads to split along corners 1-3: the clearly shorter way, else through the corner of smallest key.

    With a key that mirror images share, both halves of the face split alike.
    """
    d02 = np.linalg.norm(points[quads[:, 0]] - points[quads[:, 2]], axis=1)
    d13 = np.linalg.norm(points[quads[:, 1]] - points[quads[:, 3]], axis=1)
    keys = key[quads]
    first = np.where(np.abs(d13 - d02) < 1e-4, keys[:, [1, 3]].min(axis=1) < keys[:, [0, 2]].min(axis=1), d13 < d02)
    return (quads[:, 3] >= 0) & first


def split_quads(quads: NDArray[np.int32], along_13: NDArray[np.bool_]) -> NDArray[np.int32]:
    """Split quads into triangles in place (one row for a triangle padded with -1)."""
    a, b, c, d = quads.T
    first = np.where(along_13[:, None], np.stack([a, b, d], axis=1), np.stack([a, b, c], axis=1))
    second = np.where(along_13[:, None], np.stack([b, c, d], axis=1), np.stack([a, c, d], axis=1))
    keep = np.stack([np.ones(len(quads), dtype=bool), d >= 0], axis=1)
    return np.ascontiguousarray(np.stack([first, second], axis=1)[keep], dtype=np.int32)
