"""A stand-in for `process_subject` that takes milliseconds; what it does depends on the capture's name."""

import os
import signal
import time
import zlib
from dataclasses import replace
from pathlib import Path

import numpy as np

from facewright.errors import DegenerateError, MissingExtraError, StoreError
from facewright.faces import load_face
from facewright.warehouse.subject import Subject

PICTURE = (48, 64)
TINY = 300  # vertices


def process_subject(capture, options, progress=None):
    """Make a subject from the capture's name; takes FAKE_PROCESS_SECONDS more than needed."""
    behaviour = capture.name.partition("-")[0]
    _note(capture)
    time.sleep(float(os.environ.get("FAKE_PROCESS_SECONDS", 0)))
    if progress is not None:
        progress("neutral", 1, 1)
    if behaviour == "refused":
        raise DegenerateError(f"the neutral of {capture.name} must show a face, got a wall.")
    if behaviour == "broken":
        return [][1]
    if behaviour == "unreadable":
        raise OSError(5, "Input/output error", str(capture.path))
    if behaviour == "missing":
        raise StoreError(f"{capture.path} cannot be read: it is gone.")
    if behaviour == "uninstalled":
        raise MissingExtraError('open3d must be installed: pip install "facewright[capture]".')
    if behaviour == "flaky" and attempts(capture) < 2:
        raise OSError(116, "Stale file handle", str(capture.path))
    if behaviour == "dying":
        os._exit(9)
    if behaviour == "interrupted":
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(5)
    if behaviour == "hungry":
        raise MemoryError
    subject = subject_of(capture.name, options.face)
    return replace(subject, provenance=noted(capture.path)) if behaviour == "noted" else subject


def subject_of(name, face="tiny"):
    """Make the subject of a name, without BLAS, whose last bits would depend on the number of threads."""
    number = zlib.crc32(name.encode())
    rng = np.random.default_rng(number)
    if face == "tiny":
        shapes = rng.normal(0, 50, (47, TINY, 3)).astype(np.float32)
    else:
        face = load_face(face)
        amplitudes = rng.uniform(0.7, 1.2, (46, 1, 1)).astype(np.float32)
        shapes = np.concatenate([face.mean_shape[None], face.mean_shape + amplitudes * face.blendshape_deltas])
    return Subject(
        name=name,
        expressions=("neutral", "smile"),
        meshes=shapes[:2].copy(),
        blendshapes=shapes,
        depth=rng.uniform(500, 700, (2, *PICTURE)).astype(np.float32),
        color=rng.integers(0, 256, (2, *PICTURE, 3), dtype=np.uint8),
        attributes={"age": int(rng.integers(18, 80)), "sex": "f" if number % 2 else "m"},
        provenance={"made_by": "fake_process", "number": number},
    )


def noted(path):
    """Provenance as the real process writes it, of a subject with troubles."""
    unsteady = "Frames differ by {} mm: the expression was not held."
    metres = "Depths of {} look like metres, not millimetres: multiplied by 1000."
    expressions = {
        "neutral": {"recording": "neutral", "warnings": [metres.format(path / "neutral")]},
        "smile": {"recording": "smile", "warnings": [metres.format(path / "smile"), unsteady.format(1.5)]},
    }
    reason = f"{path / 'grin' / 'depth' / '0.1.png'} must be a whole picture."
    return {"expressions": expressions, "failed": {"grin": {"kind": "FileFormatError", "reason": reason}}}


def _note(capture):
    """Leave a file for each attempt, where the capture names a folder for them."""
    if folder := capture.attributes.get("notes"):
        (Path(folder) / f"{capture.name}@{time.time_ns()}-{os.getpid()}").touch()


def attempts(capture):
    return len(list(Path(capture.attributes["notes"]).glob(f"{capture.name}@*")))
