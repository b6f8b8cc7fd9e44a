"""Performances as files: Live Link Face recordings and JSON in and out, animated glTF out."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from facewright.apps.performance_json import read_performance_json
from facewright.camera.rotation import FRONTAL, head_angles_from_rotation, rotation_from_head_angles
from facewright.errors import ValueRangeError
from facewright.faces.blendshape_names import BLENDSHAPE_NAMES, load_name_map
from facewright.io.live_link import CURVE_COLUMNS, SHAPE_COLUMNS, FaceCurves, read_face_curves, write_live_link
from facewright.models.performance import Performance
from facewright.numeric.rotation import quaternion_from_matrix

if TYPE_CHECKING:
    from facewright.apps.rig_clip import TurningPiece
    from facewright.faces.face import Face
    from facewright.models.blendshapes import BlendshapeRig

#: Turn of an eye, radians, at which ARKit's coefficient is one: slopes of a real recording (least squares, 4,030 rows).
LOOK_IN, LOOK_OUT, LOOK_UP, LOOK_DOWN = 0.55, 0.65, 0.44, 0.61
_SIDES = ("Right", "Left")  # the order of `Performance.gaze`
_EYE_ANGLES = ("RightEyeYaw", "RightEyePitch", "LeftEyeYaw", "LeftEyePitch")


#: A coefficient from which people see the shape.
_NOTICED = 0.05


def performance_from_curves(curves: FaceCurves) -> Performance:
    """Turn ARKit's 52 coefficients and angles into a performance of our 46 shapes.

    Coefficients map by ``arkit52`` (tongue and pupils have no counterpart). Gaze comes from the eyes' angles, or from
    ``EyeLookIn``, ``Out``, ``Up`` and ``Down`` where a table has no angles. Signs turn around: Live Link's yaw is
    positive to the subject's right and its pitch downwards, ours to the left and upwards; roll agrees (see
    `FaceCurves`). Untracked rows are neutral and face the camera; `facewright.apps.untracked_frames` fills them.
    """
    chart = load_name_map("arkit52")
    order = [_plain(name) for name in chart.names]
    columns = [order.index(_plain(name)) for name in SHAPE_COLUMNS]
    shapes = curves.values[:, : len(SHAPE_COLUMNS)]
    weights = np.clip(shapes @ chart.to_ours[:, columns].T, 0.0, 1.0)
    angles = np.rad2deg([-curves.column("HeadYaw"), -curves.column("HeadPitch"), curves.column("HeadRoll")])
    rotations = np.array([rotation_from_head_angles(*row) for row in angles.T]).reshape(-1, 3, 3)
    return Performance(
        times=curves.times,
        names=BLENDSHAPE_NAMES,
        weights=weights,
        rotations=rotations,
        translations=np.zeros((len(curves.times), 3)),
        gaze=_gaze_from_curves(curves),
        tracked=curves.tracked,
    )


def curves_from_performance(performance: Performance) -> FaceCurves:
    """Turn a performance of our 46 shapes into ARKit's 52 coefficients and nine angles, the inverse of the above.

    ``BrowInnerUp`` and ``CheekPuff`` are the means of both sides; ``EyeLookDown`` is the larger of the lids' look down
    and of the gaze. Untracked frames become untracked rows. Where the head is does not enter: the format has no place
    for it.

    Raises
    ------
    ValueRangeError
        If the performance is of other shapes than ours.
    """
    if set(performance.names) - set(BLENDSHAPE_NAMES):
        other = sorted(set(performance.names) - set(BLENDSHAPE_NAMES))[0]
        raise ValueRangeError(f"names must be of the {len(BLENDSHAPE_NAMES)} blendshapes, got {other!r}.")
    chart = load_name_map("arkit52")
    rows = [BLENDSHAPE_NAMES.index(name) for name in performance.names]
    shapes = performance.weights @ chart.from_ours[:, rows].T
    values = np.zeros((performance.n_frames, len(CURVE_COLUMNS)))
    plain = [_plain(name) for name in SHAPE_COLUMNS]
    for name, column in zip(chart.names, shapes.T):
        values[:, plain.index(_plain(name))] = column
    looks = eye_looks(performance.gaze)
    for side, (yaw, pitch) in zip(_SIDES, performance.gaze.transpose(1, 2, 0), strict=True):
        for way, look in looks[side].items():
            column = CURVE_COLUMNS.index(f"EyeLook{way}{side}")
            values[:, column] = np.maximum(values[:, column], look) if way == "Down" else look  # the lids look down too
        values[:, CURVE_COLUMNS.index(f"{side}EyeYaw")] = -yaw
        values[:, CURVE_COLUMNS.index(f"{side}EyePitch")] = -pitch
    values[:, : len(SHAPE_COLUMNS)] = np.clip(values[:, : len(SHAPE_COLUMNS)], 0.0, 1.0)
    head = np.deg2rad([head_angles_from_rotation(rotation) for rotation in performance.rotations]).reshape(-1, 3)
    for name, sign, column in zip(("HeadYaw", "HeadPitch", "HeadRoll"), (-1, -1, 1), head.T):
        values[:, CURVE_COLUMNS.index(name)] = sign * column
    values[~performance.tracked] = 0.0
    return FaceCurves(performance.times - performance.times[:1], values, performance.tracked)


class Recording(NamedTuple):
    """A performance from a file.

    Parameters
    ----------
    performance : Performance
        Rows that are not `tracked` mean nothing yet, see `facewright.apps.untracked_frames`.
    notes : tuple of str
        What was made of the file's oddities: one sentence each.
    cuts : ndarray of shape (T,), bool, or None
        Frames that begin another shot, where the file tells.
    """

    performance: Performance
    notes: tuple[str, ...]
    cuts: NDArray[np.bool_] | None = None


def read_performance(path: str | Path, *, frames_per_second: float | None = None) -> Recording:
    """Read what `facewright track` writes (CSV or JSON), or a Live Link Face, Audio2Face or similar CSV file.

    Parameters
    ----------
    path : str or Path
        ``.json``: of `facewright track`; any other: CSV.
    frames_per_second : float, optional
        For CSV, see `facewright.io.live_link.read_face_curves`.

    Raises
    ------
    StoreError, FileFormatError
        As `facewright.io.live_link.read_face_curves` and
        `facewright.apps.performance_json.read_performance_json`.
    """
    if Path(path).suffix.lower() == ".json":
        performance, cuts, said = read_performance_json(path)
        return Recording(performance, said, cuts)
    curves = read_face_curves(path, frames_per_second=frames_per_second)
    notes = list(curves.notes)
    tongue = float(curves.values[:, CURVE_COLUMNS.index("TongueOut")].max(initial=0.0))
    if tongue > _NOTICED:
        notes.append(f"TongueOut (up to {tongue:.2g}) has no counterpart among our shapes and is left out.")
    return Recording(performance_from_curves(curves), tuple(notes))


def write_performance_csv(path: str | Path, performance: Performance) -> None:
    """Write a performance as a Live Link Face recording, whole.

    Raises
    ------
    StoreError, ValueRangeError
        If the file cannot be written or the shapes are not ours.
    """
    write_live_link(path, curves_from_performance(performance))


def write_performance_glb(
    path: str | Path,
    performance: Performance,
    rig: BlendshapeRig,
    face: Face,
    *,
    places: bool = False,
    texture: NDArray[np.uint8] | None = None,
    vertex_colors: NDArray[np.uint8] | None = None,
    copyright: str = "",
) -> None:
    """Write a rig that plays a performance, as glTF: morph targets, and the turns of the head and of the eyeballs.

    The head's node turns; the eyeballs are nodes of their own below it, so that they keep their shape. ARKit's eight
    ``eyeLook`` weights are there too, for programs that look for them, of morph targets that move nothing.

    Parameters
    ----------
    path : str or Path
        Ends in .glb or .gltf.
    performance : Performance
        Frames of it that are not tracked play as they are.
    rig : BlendshapeRig
        Its shapes carry the performance's names.
    face : Face
        Of the rig. The eyes of one without eyeballs do not turn.
    places : bool
        Also move the head from its usual place (median) to where it is in each frame.
    texture, vertex_colors
        See `facewright.apps.export.ExportRequest`.
    copyright : str
        Licence line.

    Raises
    ------
    ValueRangeError
        If the rig lacks one of the shapes.
    StoreError
        If the file cannot be written.
    """
    from facewright.apps.export import ExportRequest, RigClip, export_rig

    missing = sorted(set(performance.names) - set(rig.names))
    if missing:
        raise ValueRangeError(f"rig must have the performance's shapes, got one without {missing[0]!r}.")
    weights = np.zeros((performance.n_frames, len(rig.names)))
    weights[:, [rig.names.index(name) for name in performance.names]] = performance.weights
    turns = _continuous(quaternion_from_matrix(FRONTAL @ performance.rotations))
    looks = {
        f"eyeLook{way}_{side[0]}": np.clip(values, 0.0, 1.0)
        for side, ways in eye_looks(performance.gaze).items()
        for way, values in ways.items()
    }
    moved = (performance.translations - np.median(performance.translations, axis=0)) @ FRONTAL.T
    clip = RigClip(
        "performance",
        performance.times - performance.times[0],
        weights,
        turns,
        moved if places else None,
        _turning_eyeballs(face, rig, performance.gaze),
        looks,
    )
    request: dict[str, Any] = {"texture": texture, "vertex_colors": vertex_colors, "copyright": copyright}
    export_rig(ExportRequest(rig, face.topology, Path(path), clip=clip, **request))


def _turning_eyeballs(face: Face, rig: BlendshapeRig, gaze: NDArray[np.float64]) -> tuple[TurningPiece, ...]:
    from facewright.apps.rig_clip import TurningPiece
    from facewright.fitting.gaze import SIDES, eyeball_frame, eyeball_of, gaze_of_axis, turn_of_gaze

    known = {*face.topology.parts, *face.topology.masks}
    pieces = []
    for k, side in enumerate(SIDES):
        if not {f"eyeball_{side}", f"iris_{side}"} <= known:
            continue
        centre, axis = eyeball_frame(face, side, rig.neutral)
        straight = turn_of_gaze(*gaze_of_axis(axis)).T
        turns = np.array([turn_of_gaze(yaw, pitch) @ straight for yaw, pitch in gaze[:, k]])
        ids = eyeball_of(face, side)
        pieces.append(TurningPiece(f"eyeball_{side}", ids, centre, _continuous(quaternion_from_matrix(turns))))
    return tuple(pieces)


def eye_looks(gaze: NDArray[np.float64]) -> dict[str, dict[str, NDArray[np.float64]]]:
    """Return ARKit's ``EyeLook`` coefficients of gaze (T, 2, 2), by side and way, each (T,), not clipped."""
    looks = {}
    for side, (yaw, pitch) in zip(_SIDES, gaze.transpose(1, 2, 0), strict=True):
        outward = yaw if side == "Left" else -yaw
        looks[side] = {
            "Out": outward / LOOK_OUT,
            "In": -outward / LOOK_IN,
            "Up": pitch / LOOK_UP,
            "Down": -pitch / LOOK_DOWN,
        }
    return looks


def _gaze_from_curves(curves: FaceCurves) -> NDArray[np.float64]:
    gaze = np.zeros((len(curves.times), 2, 2))
    has_angles = any(curves.column(name).any() for name in _EYE_ANGLES)
    for k, side in enumerate(_SIDES):
        if has_angles:
            gaze[:, k] = np.stack([-curves.column(f"{side}EyeYaw"), -curves.column(f"{side}EyePitch")], axis=1)
            continue
        outward = LOOK_OUT * curves.column(f"EyeLookOut{side}") - LOOK_IN * curves.column(f"EyeLookIn{side}")
        up = LOOK_UP * curves.column(f"EyeLookUp{side}") - LOOK_DOWN * curves.column(f"EyeLookDown{side}")
        gaze[:, k] = np.stack([outward if side == "Left" else -outward, up], axis=1)
    return gaze


def _continuous(quaternions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Choose signs so that neighbours are near: players interpolate between them."""
    steps = np.einsum("ij,ij->i", quaternions[:-1], quaternions[1:])
    signs = np.concatenate([[1.0], np.cumprod(np.where(steps < 0, -1.0, 1.0))])
    return quaternions * signs[:, None]


def _plain(name: str) -> str:
    return name.lower()
