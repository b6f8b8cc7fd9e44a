"""Write captures of simulated people to disk, to try the way from recordings to a database."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from facewright.apps.simulated_recording import SimulatedRecording, simulate_recording
from facewright.apps.simulated_subject import SimulatedCaptureSubject, simulate_capture_subject
from facewright.errors import StoreError, ValueRangeError
from facewright.faces.expressions import EXPRESSION_NAMES, expression_weights
from facewright.io.folder import write_folder_atomically
from facewright.landmarks.points import Landmarks
from facewright.numeric.check import check_choice

Progress = Callable[[str, int, int], None]

#: Error of points set by a careful person, standard deviation in pixels.
REFINED_NOISE_PX = 1.0
LANDMARK_CHOICES = ("none", "refined")
TRUTH_FILE = "truth.npz"


@dataclass(frozen=True)
class SimulateCapturesRequest:
    """What to simulate.

    Parameters
    ----------
    out : Path
        Folder of captures; subjects are added, none is overwritten.
    n_subjects : int
        People, called ``person-000`` and so on.
    face : str
        ``builtin``, ``ict`` or the path of a face's .npz file.
    n_frames : int
        Frames a recording.
    expressions : tuple of str
        Which of the 20 expressions.
    turn_degrees : float
        Turn of the head to each side.
    seed : int
        Each subject depends on it and on the subject's number alone.
    noise : bool
        Whether depth and colour are as noisy as a Kinect's.
    landmarks : str
        ``none``, or ``refined`` for a sidecar of points on the first frame as a careful person would set them.
    truth : bool
        Write ``truth.npz`` beside each subject's recordings: face, expressions (S,), acted weights (S, 46), meshes
        (S, V, 3), neutral (V, 3), blendshape_deltas (46, V, 3), camera_from_model (S, T, 3, 4).
    """

    out: Path
    n_subjects: int = 3
    face: str = "builtin"
    n_frames: int = 24
    expressions: tuple[str, ...] = EXPRESSION_NAMES
    turn_degrees: float = 15.0
    seed: int = 0
    noise: bool = True
    landmarks: str = "none"
    truth: bool = False

    def __post_init__(self) -> None:
        if self.n_subjects < 1:
            raise ValueRangeError(f"n_subjects must be at least 1, got {self.n_subjects}.")
        if self.n_frames < 1:
            raise ValueRangeError(f"n_frames must be at least 1, got {self.n_frames}.")
        if not self.expressions or len(set(self.expressions)) < len(self.expressions):
            raise ValueRangeError(f"expressions must be named once each, at least one, got {self.expressions}.")
        for name in self.expressions:
            check_choice("expression", name, EXPRESSION_NAMES)
        check_choice("landmarks", self.landmarks, LANDMARK_CHOICES)


@dataclass(frozen=True)
class SimulateCapturesResult:
    """What was written.

    Parameters
    ----------
    out : Path
        The folder of captures.
    subjects : tuple of str
        Names of the subjects.
    n_recordings, n_frames : int
        Recordings and frames in all.
    n_bytes : int
        Size of all files.
    """

    out: Path
    subjects: tuple[str, ...]
    n_recordings: int
    n_frames: int
    n_bytes: int


def simulate_captures(request: SimulateCapturesRequest, progress: Progress | None = None) -> SimulateCapturesResult:
    """Write captures: ``OUT/<subject>/<expression>/`` as TUM-style folders, and ``subject.json``.

    A subject's folder appears when it is whole.

    Raises
    ------
    StoreError
        If a subject's folder exists already, or the disk is full.
    MissingFaceError
        If the face is not installed.
    """
    from facewright.faces import load_face

    out = Path(request.out)
    names = tuple(f"person-{k:03d}" for k in range(request.n_subjects))
    if out.exists() and not out.is_dir():
        raise StoreError(f"{out} must be a folder for captures, got a file.")
    taken = [name for name in names if (out / name).exists()]
    if taken:
        raise StoreError(
            f"{out} holds {taken[0]} already and captures are not overwritten: give another folder or remove it."
        )
    face = load_face(request.face)
    total = request.n_subjects * len(request.expressions)
    for k, name in enumerate(names):
        subject = simulate_capture_subject(face, np.random.default_rng((request.seed, k)))
        with write_folder_atomically(out / name) as folder:
            _write_subject(folder, subject, k, request, progress, k * len(request.expressions), total)
    n_bytes = sum(f.stat().st_size for name in names for f in (out / name).rglob("*") if f.is_file())
    return SimulateCapturesResult(out, names, total, total * request.n_frames, n_bytes)


def _write_subject(
    folder: Path,
    subject: SimulatedCaptureSubject,
    number: int,
    request: SimulateCapturesRequest,
    progress: Progress | None,
    done: int,
    total: int,
) -> None:
    from facewright.capture.tum_writer import write_tum_recording
    from facewright.landmarks.files import write_landmarks

    truths: dict[str, list[NDArray[np.floating]]] = {"weights": [], "meshes": [], "camera_from_model": []}
    for name in request.expressions:
        # of its own, so that a person acts an expression alike whichever others are asked for
        rng = np.random.default_rng((request.seed, number, 1 + EXPRESSION_NAMES.index(name)))
        recording = simulate_recording(
            subject,
            expression_weights(name),
            rng,
            n_frames=request.n_frames,
            turn_degrees=request.turn_degrees,
            noise=request.noise,
        )
        write_tum_recording(folder / name, recording.frames())
        if request.landmarks == "refined":
            write_landmarks(folder / name / "landmarks-0.json", refined_landmarks(recording, 0, rng))
        if request.truth:  # not the recording itself, which holds pictures
            truths["weights"].append(recording.weights)
            truths["meshes"].append(recording.vertices)
            truths["camera_from_model"].append(_pose_table(recording))
        done += 1
        if progress is not None:
            progress("simulating captures", done, total)
    if request.truth:
        np.savez_compressed(
            folder / TRUTH_FILE,
            face=np.array(subject.face.name),
            expressions=np.array(request.expressions),
            neutral=subject.person.neutral,
            blendshape_deltas=subject.person.deltas,
            **{key: np.array(rows) for key, rows in truths.items()},
        )
    (folder / "subject.json").write_text(json.dumps(dict(subject.attributes), indent=2) + "\n", encoding="utf-8")


def refined_landmarks(recording: SimulatedRecording, frame: int, rng: np.random.Generator) -> Landmarks:
    """Return the landmarks of a frame as a careful person sets them, with an error of about a pixel."""
    truth = recording.true_landmarks(frame)
    return Landmarks(truth.scheme, truth.points + rng.normal(0.0, REFINED_NOISE_PX, truth.points.shape))


def _pose_table(recording: SimulatedRecording) -> NDArray[np.float64]:
    """Return camera_from_model = [R | t] of each frame, (T, 3, 4)."""
    return np.array([np.column_stack([m.rotation, m.translation]) for m in recording.camera_from_model])
