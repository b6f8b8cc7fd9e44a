"""Sheets of one subject: what was captured and how the meshes lie on it, all expressions, and blendshapes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from facewright.apps.paint_person import portrait_painter
from facewright.apps.scan_pictures import depth_picture, error_colours, mesh_picture
from facewright.camera.pinhole import Intrinsics, RigidMotion
from facewright.errors import ValueRangeError
from facewright.faces.appearance import visible_faces
from facewright.faces.blendshape_names import BLENDSHAPE_NAMES
from facewright.faces.face import Face
from facewright.imaging.contact_sheet import contact_sheet
from facewright.imaging.overlay import crop_around, draw_points
from facewright.numeric.check import check_shape
from facewright.warehouse.subject import Subject

SHOWN_EXPRESSIONS = ("neutral", "mouth_stretch", "smile", "lip_puckerer", "cheek_blowing", "eyes_closed")
"""Expressions whose captures are shown, where the subject has them."""
SHOWN_BLENDSHAPES = (
    "browDown_L",
    "browInnerUp_L",
    "cheekPuff_L",
    "eyeBlink_L",
    "eyeBlink_R",
    "eyesLookDown",
    "jawOpen",
    "jawLeft",
    "noseSneer_L",
    "mouthFrown_L",
    "mouthFunnel",
    "mouthPucker",
    "mouthRollLower",
    "mouthSmile_L",
    "mouthUpperUp_R",
)
MOST_ERROR_MM = 3.0


def capture_row(
    face: Face,
    subject: Subject,
    expression: str,
    raw_depth: NDArray[np.floating] | None = None,
    *,
    size: int = 480,
) -> list[NDArray[np.uint8]]:
    """Draw one expression as it was captured and fitted.

    Parameters
    ----------
    face : Face
        Whose topology the subject has.
    subject : Subject
        With records (`ProcessOptions.keep_records`).
    expression : str
        One that the subject has.
    raw_depth : ndarray of shape (H, W), millimetres, optional
        The reference frame's depth as the camera gave it.
    size : int
        Side of each picture, pixels.

    Returns
    -------
    list of ndarray of shape (size, size, 3), uint8
        Picture with landmarks, raw depth if given, fused depth, mesh, mesh over the picture, and the mesh coloured by
        its distance from the fused depth along the optical axis: blue 0, red from 3 mm, grey where there is no depth.

    Raises
    ------
    ValueRangeError
        If the subject lacks the expression or its records.
    """
    if expression not in subject.expressions:
        raise ValueRangeError(
            f"expression must be one of {', '.join(subject.expressions)} of subject {subject.name!r}, "
            f"got {expression!r}."
        )
    i = subject.expressions.index(expression)
    if subject.color is None or subject.depth is None or subject.intrinsics is None or subject.landmarks is None:
        raise ValueRangeError(f"subject {subject.name!r} must hold its records: depth, pictures and landmarks.")
    assert subject.camera_from_model is not None
    check_shape("mesh", subject.meshes[i], face.topology.n_vertices, 3)
    pose = subject.camera_from_model[i]
    posed = RigidMotion(pose[:3, :3], pose[:3, 3]).apply(subject.meshes[i].astype(np.float64))
    intrinsics = Intrinsics(*(float(v) for v in subject.intrinsics[i]))
    region = face.topology.masks["face_region"]
    shown, origin, zoom = crop_around(subject.color[i], intrinsics.project(posed[region]), margin=0.06, height=size)
    camera = Intrinsics(
        intrinsics.focal_x * zoom,
        intrinsics.focal_y * zoom,
        (intrinsics.centre_x + 0.5 - origin[0]) * zoom - 0.5,
        (intrinsics.centre_y + 0.5 - origin[1]) * zoom - 0.5,
    )
    marked = draw_points(shown, (subject.landmarks[i] + 0.5 - origin) * zoom - 0.5, radius=2.5)
    depths = [raw_depth, subject.depth[i]] if raw_depth is not None else [subject.depth[i]]
    frame = (size, size)
    topology = replace(face.topology, faces=visible_faces(face))
    mesh = mesh_picture(posed, topology, camera, frame)
    over = mesh_picture(posed, topology, camera, frame, background=shown)
    colours = error_colours(_distances(posed, subject.depth[i], intrinsics), MOST_ERROR_MM)
    return [
        marked,
        *(depth_picture(depth, intrinsics, camera, frame) for depth in depths),
        mesh,
        (0.5 * shown + 0.5 * over).astype(np.uint8),
        mesh_picture(posed, topology, camera, frame, colours),
    ]


def _distances(posed: NDArray[np.float64], depth: NDArray[np.floating], intrinsics: Intrinsics) -> NDArray[np.float64]:
    """Return how far each vertex is from the depth at its pixel, mm; NaN where there is none or much else before it."""
    pixels = np.rint(intrinsics.project(posed)).astype(int)
    inside = ((pixels >= 0) & (pixels < [depth.shape[1], depth.shape[0]])).all(axis=1)
    column, row = np.where(inside[:, None], pixels, 0).T
    z = np.where(inside, depth[row, column], 0.0)
    distance = np.abs(posed[:, 2] - z)
    distance[(z <= 0) | (distance > 5 * MOST_ERROR_MM)] = np.nan
    return distance


def subject_sheets(
    face: Face,
    subject: Subject,
    raw_depths: Mapping[str, NDArray[np.floating]] | None = None,
    *,
    size: int = 400,
) -> dict[str, NDArray[np.uint8]]:
    """Draw a subject.

    Parameters
    ----------
    face : Face
        Whose topology the subject has.
    subject : Subject
        The person.
    raw_depths : mapping of str to ndarray of shape (H, W), millimetres, optional
        Depth of reference frames as the camera gave it, by expression.
    size : int
        Side of the pictures of captures, pixels.

    Returns
    -------
    dict of str to ndarray of uint8
        ``"captures"`` (where the subject has its records), ``"expressions"`` and ``"blendshapes"`` (where it has
        some): portraits with all parts of the face.
    """
    sheets: dict[str, NDArray[np.uint8]] = {}
    raw = raw_depths or {}
    if subject.color is not None and subject.depth is not None:
        names = [name for name in SHOWN_EXPRESSIONS if name in subject.expressions]
        nothing = None if not raw else np.zeros(subject.depth.shape[1:], np.float32)
        rows = [capture_row(face, subject, name, raw.get(name, nothing), size=size) for name in names]
        kinds = [
            "landmarks",
            *(["raw depth"] if raw else []),
            "fused depth",
            "mesh",
            "over the picture",
            "error 0-3 mm",
        ]
        captions = [f"{name}: {kind}" for name in names for kind in kinds]
        pictures = [picture for row in rows for picture in row]
        sheets["captures"] = contact_sheet(pictures, captions, columns=len(kinds))
    portrait = portrait_painter(face.topology, face, (384, 320), yaw_degrees=15.0, seed=1)
    sheets["expressions"] = contact_sheet(
        [portrait(mesh) for mesh in subject.meshes], list(subject.expressions), columns=5
    )
    if subject.blendshapes is not None:
        shapes = [portrait(subject.blendshapes[1 + BLENDSHAPE_NAMES.index(name)]) for name in SHOWN_BLENDSHAPES]
        sheets["blendshapes"] = contact_sheet(shapes, list(SHOWN_BLENDSHAPES), columns=5)
    return sheets
