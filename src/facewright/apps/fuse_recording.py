"""One recording of a depth camera becomes one smooth depth map with its quality, and on request a mesh."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from facewright.errors import MissingExtraError, NoFaceError, ValueRangeError
from facewright.numeric.check import check_choice

if TYPE_CHECKING:
    from facewright.capture.fused_depth import FusedDepth
    from facewright.faces.face import Face
    from facewright.fitting.scan import ScanFit
    from facewright.landmarks.detector import LandmarkDetector
    from facewright.landmarks.points import Landmarks
    from facewright.warehouse.expression_record import LoadedRecording

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class FuseRecordingRequest:
    """What to fuse and where to write.

    Parameters
    ----------
    recording : Path
        File or folder, see `facewright.capture.recording.open_recording`.
    out : Path
        Folder for the results; made where it does not exist.
    quarter_turns : int, optional
        Counter-clockwise turns of every frame; by default as the recording's camera file says, and phones' recordings
        are turned upright if the detector is there.
    engine : {"numba", "open3d"}
        Of the fusion, see `facewright.capture.fusion.FusionOptions`.
    mesh : bool
        Fit the template to the fused depth; needs landmarks.
    face : str
        The template, see `facewright.faces.load_face`.
    frame : {"scan", "model"}
        Where the mesh lies: on the fused points, in the camera's frame, or upright in model space.
    detect : bool
        Let the detector find the face; by the depth alone where False (landmarks in a file are used anyway).
    task_file : Path, optional
        See `facewright.landmarks.detector.open_detector`.
    """

    recording: Path
    out: Path
    quarter_turns: int | None = None
    engine: str = "numba"
    mesh: bool = False
    face: str = "builtin"
    frame: str = "scan"
    detect: bool = True
    task_file: Path | None = None

    def __post_init__(self) -> None:
        check_choice("engine", self.engine, ("numba", "open3d"))
        check_choice("frame", self.frame, ("scan", "model"))
        if self.quarter_turns is not None and self.quarter_turns not in range(4):
            raise ValueRangeError(f"quarter_turns must be in [0, 3], got {self.quarter_turns}.")


@dataclass(frozen=True, eq=False)
class FuseRecordingResult:
    """A fused recording and what was written.

    Parameters
    ----------
    fused : FusedDepth
        Depth, picture, motion and report.
    landmarks : Landmarks or None
        74 points of the reference frame's picture, where there are any.
    facts : dict
        What ``report.json`` holds.
    fit : ScanFit or None
        The fitted skin, if a mesh was asked for.
    vertices : ndarray of shape (V, 3), float64, millimetres, or None
        All parts of the fitted face, in model space.
    paths : dict of str to Path
        ``depth``, ``camera``, ``color``, ``report``, ``points``, ``picture``, and with a mesh ``mesh``, ``errors``.
    """

    fused: FusedDepth
    landmarks: Landmarks | None
    facts: dict[str, Any]
    fit: ScanFit | None = None
    vertices: NDArray[np.float64] | None = None
    paths: dict[str, Path] = field(default_factory=dict)


def fuse_recording(
    request: FuseRecordingRequest, progress: Progress | None = None, detector: LandmarkDetector | None = None
) -> FuseRecordingResult:
    """Fuse one recording and write the depth map, how good it is, and on request the template fitted to it.

    Parameters
    ----------
    request : FuseRecordingRequest
        Recording, folder and options.
    progress : callable, optional
        Called with stage, done, total.
    detector : LandmarkDetector, optional
        In place of the default one.

    Returns
    -------
    FuseRecordingResult
        And the files: ``depth.png`` (16 bit), ``camera.json``, ``color.png``, ``report.json``, ``points.ply``,
        ``fusion.png``, and with a mesh ``face.obj`` and ``fit.png``; all of them or none.

    Raises
    ------
    NoFaceError
        If no face is found, there are no landmarks for the mesh, or the fit is none of a face.
    DegenerateError
        If the frames do not lie on one surface.
    ValueRangeError, FileFormatError, StoreError
        If recording or landmarks are damaged, or the results cannot be written.
    MissingExtraError
        If the engine is not installed, or a mesh needs a detector that is not.
    """
    from facewright.apps.fused_files import write_fitted, write_fused, write_json
    from facewright.capture.fusion import FusionOptions
    from facewright.faces.load import load_face
    from facewright.io.atomic import write_set_atomically

    FusionOptions(engine=request.engine)  # before the work: tells at once what is not installed
    face = load_face(request.face) if request.mesh else None
    _check_out(request)
    with write_set_atomically(request.out) as folder, ExitStack() as stack:
        found, why_none = _open_detector(request, detector, stack)
        if request.mesh and found is None and not _has_points(request.recording):
            raise _no_landmarks(request, why_none)
        fused, raw, landmarks, facts = _fuse(request, found, why_none, progress)
        fit = vertices = None
        if face is not None:
            if landmarks is None:
                raise _no_landmarks(request, why_none)
            fit, vertices = _fit(face, fused, landmarks, progress)
            facts["mesh"] = _mesh_facts(request, face, fit)
        if progress is not None:
            progress("writing", 0, 1)
        names = write_fused(folder, raw, fused, landmarks)
        if face is not None and fit is not None and vertices is not None:
            on_scan = request.frame == "scan"
            names |= write_fitted(folder, request.recording.name, face, fused, fit, vertices, on_scan)
        names["report"] = write_json(folder / "report.json", facts)
        if progress is not None:
            progress("writing", 1, 1)
    return FuseRecordingResult(
        fused, landmarks, facts, fit, vertices, {key: request.out / name for key, name in names.items()}
    )


def _check_out(request: FuseRecordingRequest) -> None:
    """Refuse to write among the files of a recording: its camera file would be lost."""
    out = request.out
    foreign = (out / "camera.json").exists() and not (out / "report.json").exists()
    if foreign or out.resolve() == request.recording.resolve():
        raise ValueRangeError(f"out must be a folder of its own, got {out}, which holds a recording.")


def _has_points(recording: Path) -> bool:
    """Tell whether landmarks lie beside a recording."""
    from facewright.capture.captures import find_sidecar

    return recording.exists() and find_sidecar(recording) is not None


def _open_detector(
    request: FuseRecordingRequest, detector: LandmarkDetector | None, stack: ExitStack
) -> tuple[LandmarkDetector | None, str]:
    """Return the detector, or None and why there is none; where a file holds all points, none is needed."""
    from facewright.landmarks.detector import open_detector
    from facewright.warehouse.expression_record import needs_detector

    if not request.detect:
        return None, "the detector was not to be asked"
    if detector is not None:
        return detector, ""
    if request.recording.exists() and not needs_detector({"": request.recording}):
        return None, ""
    try:
        return stack.enter_context(open_detector(request.task_file)), ""
    except MissingExtraError as error:
        return None, str(error).rstrip(".")


def _no_landmarks(request: FuseRecordingRequest, why: str) -> NoFaceError:
    return NoFaceError(
        f"a mesh needs landmarks of {request.recording}, got none{': ' + why if why else ''}; put a "
        "landmarks-FRAME.json beside the recording, or leave the mesh out."
    )


def _fuse(
    request: FuseRecordingRequest, detector: LandmarkDetector | None, why_none: str, progress: Progress | None
) -> tuple[FusedDepth, NDArray[np.float32], Landmarks | None, dict[str, Any]]:
    """Return the fused and the raw depth, the landmarks if there are any, and the facts for the report."""
    from facewright.warehouse.expression_record import LoadedRecording, StageClock, read_record

    if progress is not None:
        progress("opening", 0, 1)
    loaded = LoadedRecording(request.recording, request.quarter_turns)
    if progress is not None:
        progress("opening", 1, 1)
    marked = _has_points(request.recording)
    if marked and request.quarter_turns is not None:
        _check_turn_of_points(request)
    if not marked and detector is None:
        fused, facts = _fuse_by_depth(request, loaded, why_none, progress)
        return fused, loaded.frame(fused.reference).depth, None, facts
    source: Future[LoadedRecording] = Future()
    source.set_result(loaded)
    record = read_record(
        request.recording.stem, request.recording, detector, StageClock(), source, request.engine, progress
    )
    landmarks = record.landmarks if record.landmarks.present.any() else None
    return record.fused, record.raw_depth, landmarks, _facts(request, record.fused, record.facts, landmarks)


def _check_turn_of_points(request: FuseRecordingRequest) -> None:
    from facewright.capture.camera_file import read_camera_file

    noted = read_camera_file(request.recording).quarter_turns or 0
    if request.quarter_turns != noted:
        raise ValueRangeError(
            f"quarter_turns must be {noted} or left out, got {request.quarter_turns}: landmarks beside "
            f"{request.recording} were marked in frames turned so."
        )


def _fuse_by_depth(
    request: FuseRecordingRequest, loaded: LoadedRecording, why: str, progress: Progress | None
) -> tuple[FusedDepth, dict[str, Any]]:
    """Fuse without landmarks: the face is the nearest thing of a head's size."""
    from facewright.capture.fusion import FusionOptions, fuse

    fused = fuse(loaded, options=FusionOptions(engine=request.engine), progress=progress)
    recording = loaded.recording
    told = f"The face was found by the depth alone: {why}" + (
        "." if loaded.turn_given else "; if heads lie on their side, give the turn."
    )
    facts = {
        "kind": recording.kind,
        "quarter_turns": recording.quarter_turns,
        "warnings": [told, *recording.warnings, *fused.report.warnings],
        "landmarks": "none",
    }
    return fused, _facts(request, fused, facts, None)


def _facts(
    request: FuseRecordingRequest, fused: FusedDepth, known: dict[str, Any], landmarks: Landmarks | None
) -> dict[str, Any]:
    """Return what ``report.json`` holds."""
    from facewright.warehouse.provenance import plain

    facts: dict[str, Any] = plain(
        {
            "format": "facewright fused recording",
            "version": 1,
            "recording": str(request.recording),
            "kind": known["kind"],
            "quarter_turns": known["quarter_turns"],
            "engine": request.engine,
            "reference_frame": fused.reference,
            "rectangle": list(fused.rectangle),
            "fusion": fused.report.to_dict(),
            "landmarks": {
                "from": known["landmarks"],
                "scheme": "fw74",
                "found": 0 if landmarks is None else int(landmarks.present.sum()),
                "points": None if landmarks is None else landmarks.points,
            },
            "warnings": known["warnings"],
        }
    )
    return facts


def _fit(
    face: Face, fused: FusedDepth, landmarks: Landmarks, progress: Progress | None
) -> tuple[ScanFit, NDArray[np.float64]]:
    """Return the fitted skin, and all parts of the face."""
    from facewright.faces.attach_parts import parts_attacher
    from facewright.fitting.depth_target import depth_target
    from facewright.fitting.scan import ScanFitter

    target = depth_target(fused.depth, fused.intrinsics, landmarks)
    fit = ScanFitter(face).fit_neutral(target, progress)
    return fit, parts_attacher(face).neutral(fit.vertices)


def _mesh_facts(request: FuseRecordingRequest, face: Face, fit: ScanFit) -> dict[str, Any]:
    from facewright.warehouse.provenance import plain

    pose = fit.target_from_model
    facts: dict[str, Any] = plain(
        {
            "face": face.name,
            "topology": face.topology.fingerprint,
            "frame": request.frame,
            "residuals": fit.report,
            "identity_coefficients": fit.coefficients,
            "camera_from_model": {"rotation": pose.rotation, "translation": pose.translation},
        }
    )
    return facts
