"""An animation made by hand as files: glTF with morph targets, a sequence of meshes, a table of coefficients."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from facewright.apps.pose_session import PoseSession
from facewright.apps.posed_character import ModelMesh, PosedCharacter
from facewright.errors import FileFormatError, StoreError, ValueRangeError
from facewright.io.atomic import write_atomically, write_set_atomically
from facewright.models.pose_keyframes import PoseKeyframes
from facewright.models.region_model import RegionModel
from facewright.numeric.check import check_choice

Progress = Callable[[str, int, int], None]

FORMATS = ("glb", "gltf", "obj", "ply", "csv")
MORPHS = ("coefficients", "baked")
#: What a baked animation may differ from the true one, mm.
BAKED_MM = 0.02

_MAX_FRAMES = 20_000
_LEARNED = 240  # frames that a baked animation's shapes are found in


@dataclass(frozen=True, eq=False)
class PoseExportRequest:
    """What to write.

    Parameters
    ----------
    out : Path
        A file, or for ``obj`` and ``ply`` a folder that takes ``frame_0001.obj`` and so on.
    format : {"glb", "gltf", "obj", "ply", "csv"}
    frames_per_second : float
    character : PosedCharacter, optional
        Whose meshes; the model's own where absent.
    kind : {"region", "holistic"}
        Which model's pose.
    morphs : {"coefficients", "baked"}
        Morph targets of glTF: one for each coefficient of the model, named after it; or as few as carry the animation
        within `BAKED_MM`.
    """

    out: Path
    format: str
    frames_per_second: float = 30.0
    character: PosedCharacter | None = None
    kind: str = "region"
    morphs: str = "baked"


@dataclass(frozen=True)
class PoseExportResult:
    """What was written.

    Parameters
    ----------
    path : Path
        File or folder.
    n_frames : int
    n_morphs : int
        Morph targets of a glTF; 0 else.
    error_mm : float
        How far vertices of a glTF lie from the pose at most; 0 for the other formats.
    """

    path: Path
    n_frames: int
    n_morphs: int = 0
    error_mm: float = 0.0


def export_pose(session: PoseSession, request: PoseExportRequest, progress: Progress | None = None) -> PoseExportResult:
    """Write a session's animation, or its present pose where there are no keyframes.

    Raises
    ------
    ValueRangeError
        If format, kind, morphs or rate are not what they can be, or the animation is too long.
    StoreError
        If it cannot be written.
    """
    check_choice("format", request.format, FORMATS)
    check_choice("kind", request.kind, session.kinds)
    check_choice("morphs", request.morphs, MORPHS)
    times = frame_times(session, request.frames_per_second)
    zeta = session.sample(times, request.kind)
    character: PosedCharacter = request.character or ModelMesh(session.models)
    if request.format == "csv":
        write_pose_csv(request.out, session.models[request.kind], times - times[0], zeta)
        return PoseExportResult(request.out, len(times))
    if request.format in ("obj", "ply"):
        return _write_meshes(request, character, zeta, progress)
    names = coefficient_names(session.models[request.kind])
    return _write_gltf(request, character, times - times[0], zeta, names, progress)


def frame_times(session: PoseSession, frames_per_second: float) -> NDArray[np.float64]:
    """Return the times (T,) of the animation's frames, seconds, from its first to its last keyframe.

    Raises
    ------
    ValueRangeError
        If the rate is not positive or there would be too many frames.
    """
    if not (np.isfinite(frames_per_second) and frames_per_second > 0):
        raise ValueRangeError(f"frames_per_second must be positive, got {frames_per_second}.")
    keys = session.keyframes
    if not len(keys):
        return np.zeros(1)
    length = keys.duration - float(keys.times[0])
    count = int(np.floor(length * frames_per_second + 1e-6)) + 1 if length * frames_per_second < 1e9 else 10**9
    if count > _MAX_FRAMES:
        raise ValueRangeError(f"an animation can have at most {_MAX_FRAMES} frames, got {count}: export it in parts.")
    return np.asarray(keys.times[0] + np.arange(count) / frames_per_second)


def write_pose_csv(path: Path, model: RegionModel, times: NDArray[np.float64], zeta: NDArray[np.float64]) -> None:
    """Write coefficients (T, P) as a table: a column ``time`` in seconds, then one for each coefficient by name.

    Raises
    ------
    StoreError
        If the file cannot be written.
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["time", *coefficient_names(model)])
    writer.writerows([repr(float(t)), *(repr(float(x)) for x in row)] for t, row in zip(times, zeta, strict=True))
    with write_atomically(path) as temporary:
        temporary.write_text(text.getvalue(), encoding="utf-8")


def read_pose_csv(path: Path, model: RegionModel) -> PoseKeyframes:
    """Read a table that `write_pose_csv` wrote as keyframes, one for each row.

    Raises
    ------
    StoreError
        If the file cannot be read.
    FileFormatError
        If it is no such table or names other coefficients than the model's.
    """
    try:
        rows = list(csv.reader(Path(path).read_text(encoding="utf-8-sig").splitlines()))
    except OSError as error:
        raise StoreError(f"{path} must be a readable file, got: {error.strerror or error}.") from error
    except (ValueError, csv.Error) as error:
        raise FileFormatError(f"{path} must be a CSV table in UTF-8, got: {error}.") from error
    expected = ["time", *coefficient_names(model)]
    if not rows or rows[0] != expected:
        raise FileFormatError(
            f"{path} must have the columns time and this model's {model.n_coefficients} coefficients, got others."
        )
    try:
        values = np.array(rows[1:], dtype=np.float64).reshape(-1, len(expected))
        return PoseKeyframes(values[:, 0], values[:, 1:])
    except ValueError as error:
        raise FileFormatError(f"{path} must hold a finite number in every cell, got other rows: {error}") from error


def coefficient_names(model: RegionModel) -> list[str]:
    """Return a name for each of the P coefficients that no other has."""
    names = []
    for region, group in zip(model.regions.names, model.coefficient_names, strict=True):
        names += [name if name.startswith(region) else f"{region}_{name}" for name in group]
    return names


def _write_meshes(
    request: PoseExportRequest, character: PosedCharacter, zeta: NDArray[np.float64], progress: Progress | None
) -> PoseExportResult:
    from facewright.io.obj import write_obj
    from facewright.io.ply import write_ply

    topology = character.topology
    out = np.empty_like(character.neutral)
    digits = max(4, len(str(len(zeta))))
    with write_set_atomically(request.out) as folder:
        for t, row in enumerate(zeta):
            character.pose(request.kind, row, out)
            place = folder / f"frame_{t + 1:0{digits}d}.{request.format}"
            if request.format == "obj":
                write_obj(place, out, topology.faces, uv=topology.uv, uv_faces=topology.uv_faces)
            else:
                write_ply(place, out, topology.faces)
            if progress is not None:
                progress("writing meshes", t + 1, len(zeta))
    return PoseExportResult(request.out, len(zeta))


def _write_gltf(
    request: PoseExportRequest,
    character: PosedCharacter,
    times: NDArray[np.float64],
    zeta: NDArray[np.float64],
    coefficients: list[str],
    progress: Progress | None,
) -> PoseExportResult:
    from facewright.apps.export import ExportRequest, RigClip, export_rig
    from facewright.models.blendshapes import BlendshapeRig

    if request.out.suffix.lower() != f".{request.format}":
        raise ValueRangeError(f"out must end in .{request.format}, got {request.out}.")
    if request.morphs == "baked":
        neutral, names, deltas, weights, error = _baked(request.kind, character, zeta)
    else:
        neutral, names, deltas, error = _linear(request, character, zeta, coefficients)
        weights = zeta
    clip = RigClip("pose", times, weights) if len(times) > 1 else None
    asked = ExportRequest(
        BlendshapeRig(neutral, names, deltas),
        character.topology,
        request.out,
        texture=character.texture,
        vertex_colors=character.colors,
        clip=clip,
        weights=weights[0],
        copyright=character.licence,
    )
    export_rig(asked, progress)
    return PoseExportResult(request.out, len(times), len(names), error)


def _baked(
    kind: str, character: PosedCharacter, zeta: NDArray[np.float64]
) -> tuple[NDArray[np.float32], tuple[str, ...], NDArray[np.float32], NDArray[np.float64], float]:
    """Return rest (V, 3), names, displacements (B, V, 3), weights (T, B), largest error: as few shapes as will do.

    Principal displacements of some frames; every frame is then projected on them.
    """
    rest = character.neutral
    seen = zeta[np.unique(np.linspace(0, len(zeta) - 1, min(len(zeta), _LEARNED)).round().astype(int))]
    moves = np.stack([_moved(kind, character, row).ravel() for row in seen]).astype(np.float64)
    values, vectors = np.linalg.eigh(moves @ moves.T)
    kept = values > 1e-12 * max(float(values[-1]), 1e-12)
    shapes = (vectors[:, kept].T @ moves)[::-1]
    shapes /= np.maximum(np.linalg.norm(shapes, axis=1, keepdims=True), 1e-12)
    B = next(b for b in range(len(shapes) + 1) if b == len(shapes) or _left(moves, shapes[:b]) <= 0.5 * BAKED_MM)
    weights, error = np.empty((len(zeta), B)), 0.0
    for row, weight in zip(zeta, weights, strict=True):
        move = _moved(kind, character, row).ravel().astype(np.float64)
        weight[:] = shapes[:B] @ move
        error = max(error, float(np.abs(move - weight @ shapes[:B]).max(initial=0.0)))
    size = np.maximum(np.abs(weights).max(axis=0), 1e-12)  # so that weights lie in [-1, 1]
    deltas = (shapes[:B] * size[:, None]).reshape(B, *rest.shape).astype(np.float32)
    return rest, tuple(f"pose_{b + 1:02d}" for b in range(B)), deltas, weights / size, error


def _moved(kind: str, character: PosedCharacter, row: NDArray[np.float64]) -> NDArray[np.float32]:
    out = np.empty_like(character.neutral)
    character.pose(kind, row, out)
    return out - character.neutral


def _left(moves: NDArray[np.float64], shapes: NDArray[np.float64]) -> float:
    return float(np.abs(moves - (moves @ shapes.T) @ shapes).max(initial=0.0))


def _linear(
    request: PoseExportRequest, character: PosedCharacter, zeta: NDArray[np.float64], names: list[str]
) -> tuple[NDArray[np.float32], tuple[str, ...], NDArray[np.float32], float]:
    """Return rest (V, 3), names, displacement of each coefficient (P, V, 3), and how far frames are from their sum."""
    P = zeta.shape[1]
    rest, out = np.empty_like(character.neutral), np.empty_like(character.neutral)
    character.pose(request.kind, np.zeros(P), rest)
    deltas = np.empty((P, *rest.shape), dtype=np.float32)
    for p, unit in enumerate(np.eye(P)):
        character.pose(request.kind, unit, deltas[p])
    deltas -= rest
    error = 0.0
    for row in zeta[:: max(1, len(zeta) // 50)]:
        character.pose(request.kind, row, out)
        summed = rest + np.tensordot(row.astype(np.float32), deltas, axes=1)
        error = max(error, float(np.linalg.norm(out - summed, axis=1).max()))
    return rest, tuple(names), deltas, error
