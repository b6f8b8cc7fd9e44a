"""ICT-FaceKit (light) as a Face: parts, triangles, mirror map, masks, landmarks and the 46 blendshapes."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from facewright.errors import FileFormatError, StoreError
from facewright.faces.blendshape_names import BLENDSHAPE_NAMES
from facewright.faces.face import Face
from facewright.faces.ict_annotations import IctAnnotator, ict_landmarks
from facewright.mesh.topology import Topology

ICT_LICENCE = "MIT, ICT-FaceKit, Copyright (c) 2020 USC Institute for Creative Technologies"
N_VERTICES = 26719
N_POLYGONS = 26384
N_IDENTITIES = 100

# Vertex ranges of the model's geometries, from the table in ICT-FaceKit's README.
PART_STARTS: dict[str, int] = {
    "face": 0,
    "head_and_neck": 9409,
    "mouth_socket": 11248,
    "eye_socket_left": 13294,
    "eye_socket_right": 13678,
    "gums_and_tongue": 14062,
    "teeth": 17039,
    "eyeball_left": 21451,
    "eyeball_right": 23021,
    "lacrimal_left": 24591,
    "lacrimal_right": 24795,
    "eye_blend_left": 24999,
    "eye_blend_right": 25023,
    "eye_occlusion_left": 25047,
    "eye_occlusion_right": 25199,
    "eyelashes_left": 25351,
    "eyelashes_right": 26035,
}
GAZE_DOWN_RADIANS = np.deg2rad(26.0)  # as far as the lids of eyeLookDown go
N_SKIN = PART_STARTS["mouth_socket"]

COMPACT_KEYS = {
    "vertices": (N_VERTICES, 3),
    "faces": (N_POLYGONS, 4),
    "uv": (None, 2),
    "uv_faces": (N_POLYGONS, 4),
    "identity_modes": (N_IDENTITIES, N_VERTICES, 3),
    "expression_deltas": (None, N_VERTICES, 3),
    "expression_names": (None,),
}


def part_ranges() -> dict[str, tuple[int, int]]:
    """Return the half-open vertex range of each of the 17 parts, in order."""
    stops = [*list(PART_STARTS.values())[1:], N_VERTICES]
    return {name: (start, stop) for (name, start), stop in zip(PART_STARTS.items(), stops)}


def read_ict_compact(path: Path) -> Face:
    """Read the compact ``.npz`` of ICT-FaceKit and return it as a Face.

    Raises
    ------
    StoreError
        If the file cannot be opened.
    FileFormatError
        If it is truncated, corrupt, or not the compact ICT-FaceKit.
    """
    return ict_face(read_compact_arrays(path))


def read_compact_arrays(path: Path) -> dict[str, NDArray]:
    """Read and check the arrays of the compact file; nothing is ever unpickled."""
    arrays: dict[str, NDArray] = {}
    try:
        opened = np.load(path, allow_pickle=False)
        if not isinstance(opened, np.lib.npyio.NpzFile):
            raise ValueError("a single array, not an archive of arrays")
        with opened as archive:
            missing = sorted(COMPACT_KEYS.keys() - set(archive.files))
            if missing:
                raise FileFormatError(f"{path} must be a compact ICT-FaceKit file, but lacks {', '.join(missing)}.")
            for key, expected in COMPACT_KEYS.items():
                array = archive[key]
                if len(array.shape) != len(expected) or any(
                    size not in (None, found) for size, found in zip(expected, array.shape)
                ):
                    raise FileFormatError(f"{path}: {key} must have shape {expected}, got {array.shape}.")
                arrays[key] = array
    except FileFormatError:
        raise
    except FileNotFoundError as error:
        raise StoreError(f"{path} must be an existing file.") from error
    except (ValueError, EOFError, KeyError, zipfile.BadZipFile, OSError) as error:
        raise FileFormatError(f"{path} must be a compact ICT-FaceKit .npz file, got {error}.") from error
    return arrays


def ict_face(arrays: Mapping[str, NDArray]) -> Face:
    """Build the Face from the compact arrays (millimetres, ICT-FaceKit's vertex order)."""
    mean = np.asarray(arrays["vertices"], dtype=np.float32)
    quads = np.asarray(arrays["faces"], dtype=np.int32)
    mirror = mirror_map(mean)
    # Of exactly symmetric positions, so that both halves of the face split alike.
    diagonal = shorter_diagonals(0.5 * (mean + mean[mirror] * np.array([-1, 1, 1], np.float32)), quads)
    faces, parts = triangulate(quads, diagonal), part_ranges()
    deltas = blendshape_deltas(arrays["expression_names"], arrays["expression_deltas"])
    _turn_eyeballs_down(mean, deltas[-1], parts)
    landmarks = ict_landmarks()
    masks = IctAnnotator(mean, deltas, faces, quads, parts, landmarks, mirror).masks()
    topology = Topology(
        name="ict",
        n_vertices=len(mean),
        faces=faces,
        quads=quads,
        uv=np.asarray(arrays["uv"], dtype=np.float32),
        uv_faces=triangulate(np.asarray(arrays["uv_faces"], dtype=np.int32), diagonal),
        parts=parts,
        masks=masks,
        landmarks=landmarks,
        mirror=mirror,
    )
    return Face(
        name="ict",
        topology=topology,
        mean_shape=mean,
        identity_basis=np.asarray(arrays["identity_modes"], dtype=np.float32),
        blendshape_names=BLENDSHAPE_NAMES,
        blendshape_deltas=deltas,
        rigid_parts={
            "teeth_upper": "skull",
            "teeth_lower": "jaw",
            "eyeball_left": "eye",
            "eyeball_right": "eye",
        },
        licence=ICT_LICENCE,
    )


def blendshape_deltas(names: NDArray, deltas: NDArray) -> NDArray[np.float32]:
    """Pick the 46 blendshapes among ICT's shapes; ``eyesLookDown`` is the sum of both eyes' gaze down."""
    where = {str(name): i for i, name in enumerate(names)}
    missing = [name for name in (*BLENDSHAPE_NAMES[:-1], "eyeLookDown_L", "eyeLookDown_R") if name not in where]
    if missing:
        raise FileFormatError(f"ICT-FaceKit must have the expression shapes {', '.join(missing)}.")
    picked = [deltas[where[name]] for name in BLENDSHAPE_NAMES[:-1]]
    picked.append(deltas[where["eyeLookDown_L"]] + deltas[where["eyeLookDown_R"]])
    return np.stack(picked).astype(np.float32)


def _turn_eyeballs_down(mean: NDArray, delta: NDArray, parts: Mapping[str, tuple[int, int]]) -> None:
    """Turn the eyeballs with ``eyesLookDown``, in place: ICT-FaceKit's gaze shapes move the lids only."""
    c, s = np.cos(GAZE_DOWN_RADIANS), np.sin(GAZE_DOWN_RADIANS)
    turn = np.array([[1, 0, 0], [0, c, -s], [0, s, c]])  # about x: forward (z) goes down (-y)
    for name in ("eyeball_left", "eyeball_right"):
        ball = slice(*parts[name])
        arms = mean[ball].astype(np.float64)
        arms = arms - 0.5 * (arms.min(axis=0) + arms.max(axis=0))
        delta[ball] = arms @ turn.T - arms


def shorter_diagonals(vertices: NDArray, quads: NDArray[np.int32]) -> NDArray[np.bool_]:
    """Tell for each quad whether to split it along vertices 1-3 rather than 0-2, the shorter way."""
    points = np.asarray(vertices, dtype=np.float64)
    full = quads[:, 3] >= 0
    d02 = np.linalg.norm(points[quads[:, 0]] - points[quads[:, 2]], axis=1)
    d13 = np.linalg.norm(points[quads[:, 1]] - points[quads[:, 3]], axis=1)
    return full & (d13 < d02)


def triangulate(polygons: NDArray[np.int32], along_13: NDArray[np.bool_]) -> NDArray[np.int32]:
    """Split quads into triangles, two rows for each quad in its place, one for a polygon padded with -1."""
    a, b, c, d = polygons.T
    first = np.where(along_13[:, None], np.stack([a, b, d], axis=1), np.stack([a, b, c], axis=1))
    second = np.where(along_13[:, None], np.stack([b, c, d], axis=1), np.stack([a, c, d], axis=1))
    both = np.stack([first, second], axis=1)
    keep = np.stack([np.ones(len(polygons), dtype=bool), d >= 0], axis=1)
    return np.ascontiguousarray(both[keep], dtype=np.int32)


def mirror_map(vertices: NDArray) -> NDArray[np.int32]:
    """Match each vertex with its mirror image across x = 0, within the same or the opposite part: an involution."""
    from scipy.optimize import linear_sum_assignment
    from scipy.spatial import cKDTree

    points = np.asarray(vertices, dtype=np.float64)
    mirror = np.full(len(points), -1, dtype=np.int32)
    ranges = part_ranges()
    for name, (start, stop) in ranges.items():
        if name.endswith("_right"):
            continue  # filled in with its left counterpart
        start2, stop2 = ranges[name.replace("_left", "_right")]
        image = points[start:stop] * [-1.0, 1.0, 1.0]
        other = points[start2:stop2]
        there = cKDTree(other).query(image)[1]
        back = cKDTree(image).query(other)[1]
        mutual = back[there] == np.arange(stop - start)
        mirror[start:stop][mutual] = there[mutual] + start2
        # Coinciding or nearly symmetric vertices are few: pair what is left at least total distance.
        left = np.flatnonzero(~mutual)
        free = np.setdiff1d(np.arange(stop2 - start2), there[mutual])
        if left.size:
            cost = np.linalg.norm(image[left, None] - other[None, free], axis=2)
            if start == start2:
                cost = cost + cost.T
            rows, columns = linear_sum_assignment(cost)
            mirror[start + left[rows]] = start2 + free[columns]
        if start != start2:
            mirror[mirror[start:stop]] = np.arange(start, stop)
    return mirror
