"""Suite `fusion`: recordings of simulated people fused into smooth depth maps, against the true depth and motion."""

from __future__ import annotations

from collections.abc import Callable
from importlib.util import find_spec
from time import perf_counter
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from facewright.apps.simulated_recording import SimulatedRecording, simulate_capture_subject, simulate_recording
from facewright.camera.rotation import rotation_angle
from facewright.capture.face_rectangle import Rectangle, rectangle_from_landmarks
from facewright.capture.frame import RGBDFrame
from facewright.capture.fused_depth import FusedDepth
from facewright.capture.fusion import FusionOptions, fuse
from facewright.errors import ValueRangeError
from facewright.faces.expressions import EXPRESSION_WEIGHTS
from facewright.faces.face import Face

Progress = Callable[[str, int, int], None]

N_FRAMES = 24
#: Expressions of each person: the neutral, and one with an open mouth.
EXPRESSIONS = (0, 1)
_EDGE_MM, _EDGE_PIXELS = 15.0, 5


class DepthError(NamedTuple):
    """Root mean square and mean absolute difference of a depth map from the truth, mm."""

    rms: float
    mean: float


def run(face: Face, seed: int, progress: Progress | None = None, *, subjects: int = 3) -> dict[str, float]:
    """Measure fusion on simulated Kinect recordings of 24 frames, the head turning 15 degrees each way.

    Each person records the neutral and an expression, with hair, torso and sometimes glasses. The reference frame is
    the first, its face rectangle comes from the true landmarks: the detector is no part of it. Noise is measured on the
    pixels of the face rectangle that have raw and fused depth and are at least two pixels from an edge of the true
    depth (a step of 15 mm), the same for both. Fusion leaves out what the reference frame contradicts, which takes
    the worst pixels out of the noise: ``coverage`` and ``ungated_fused_noise_mm`` tell how many and how bad. The
    neutral of each person is fused with Open3D's volume too, where that is installed, and judged beside on the
    pixels that both have.

    Parameters
    ----------
    face : Face
        All parts of it.
    seed : int
        Seed of people and recordings.
    progress : callable, optional
        Called as progress("fusion", done, total).
    subjects : int
        People.

    Returns
    -------
    dict of str to float
        ``fps``: frames per second, median over recordings, without reading and detecting; ``drift_mm``,
        ``drift_deg``: largest error over the frames of where the face's middle is and how the head is turned, against
        the reference frame, mean over recordings; ``raw_noise_mm``, ``fused_noise_mm``: root mean square error of the
        reference frame's depth and of the fused depth, both on the same pixels, over all recordings; ``fused_to_raw``:
        their ratio;
        ``raw_noise_mean_mm``, ``fused_noise_mean_mm``: the same as mean absolute error; ``fused_bias_mm``: mean of
        the fused error, positive behind the truth; ``single_frame_noise_mm``: root mean square error of the reference
        frame smoothed by itself (what fusion must beat); ``coverage``: share of those pixels, raw depth or none, that
        have fused depth; ``ungated_fused_noise_mm``: the fused error without leaving out what the reference frame
        contradicts, on all its pixels with raw depth; ``lost_frames``: mean per recording; ``reported_noise_mm``: what
        the report says without truth, mean.

        With Open3D also, over the recordings fused with it: ``open3d_fps``, ``open3d_drift_mm``,
        ``open3d_fused_noise_mm``, and ``open3d_coverage``, measured as for our own; ``beside_open3d_fused_noise_mm``:
        our own fused noise on the very same recordings and pixels.

    Raises
    ------
    ValueRangeError
        If `subjects` is not positive.
    """
    if subjects < 1:
        raise ValueRangeError(f"subjects must be positive, got {subjects}.")
    figures: list[dict[str, float]] = []
    beside: list[dict[str, float]] = []
    others = find_spec("open3d") is not None
    for person in range(subjects):
        rng = np.random.default_rng((seed, person))
        subject = simulate_capture_subject(face, rng)
        for expression in EXPRESSIONS:
            weights = np.asarray(EXPRESSION_WEIGHTS[expression], np.float64)
            recording = simulate_recording(subject, weights, rng, n_frames=N_FRAMES)
            frames = list(recording.frames())
            rectangle = rectangle_from_landmarks(recording.true_landmarks(0), frames[0].size)
            if not figures:  # compiles the kernels and loads Open3D, outside the times
                _timed_fuse(frames[:3], rectangle)
            fused, seconds = _timed_fuse(frames, rectangle)
            figures.append({"fps": len(frames) / seconds} | measure(fused, frames, recording))
            if others and expression == EXPRESSIONS[0]:
                if not beside:
                    _timed_fuse(frames[:3], rectangle, "open3d")
                other, seconds = _timed_fuse(frames, rectangle, "open3d")
                beside.append({"open3d_fps": len(frames) / seconds} | compare_open3d(fused, other, frames, recording))
            if progress is not None:
                progress("fusion", len(figures), subjects * len(EXPRESSIONS))
    own = _summary(figures)
    own["fused_to_raw"] = own["fused_noise_mm"] / own["raw_noise_mm"]
    return own | (_summary(beside) if beside else {})


def _timed_fuse(frames: list[RGBDFrame], rectangle: Rectangle, engine: str = "numba") -> tuple[FusedDepth, float]:
    """Fuse at the first frame; return the seconds too."""
    start = perf_counter()
    fused = fuse(frames, reference=0, rectangle=rectangle, options=FusionOptions(engine=engine))
    return fused, perf_counter() - start


def _summary(figures: list[dict[str, float]]) -> dict[str, float]:
    """Take frames per second by their median, root mean squares as such, and the mean of the rest."""
    out = {}
    for name in figures[0]:
        values = np.array([f[name] for f in figures])
        if name.endswith("fps"):
            out[name] = float(np.median(values))
        elif name.endswith("_noise_mm") and name != "reported_noise_mm":
            out[name] = float(np.sqrt(np.mean(values**2)))
        else:
            out[name] = float(values.mean())
    return out


def compare_open3d(
    own: FusedDepth, other: FusedDepth, frames: list[RGBDFrame], recording: SimulatedRecording
) -> dict[str, float]:
    """Return the figures of Open3D's volume, and our own on the same pixels; see `run`."""
    truth = recording.true_depth(own.reference)
    face = judged_pixels(truth, own.rectangle)
    both = face & (frames[own.reference].depth > 0) & (own.depth > 0) & (other.depth > 0)
    return {
        "open3d_drift_mm": motion_error(other, recording)[0],
        "open3d_fused_noise_mm": _error(other.depth, truth, both).rms,
        "beside_open3d_fused_noise_mm": _error(own.depth, truth, both).rms,
        "open3d_coverage": _coverage(other.depth, face),
    }


def measure(fused: FusedDepth, frames: list[RGBDFrame], recording: SimulatedRecording) -> dict[str, float]:
    """Return the figures of one fused recording; see `run`."""
    truth, raw = recording.true_depth(fused.reference), frames[fused.reference].depth
    single = fuse([frames[fused.reference]], rectangle=fused.rectangle).depth
    everything = FusionOptions(contradiction_mm=np.inf)
    ungated = fuse(frames, reference=fused.reference, rectangle=fused.rectangle, options=everything).depth
    face = judged_pixels(truth, fused.rectangle)
    both = face & (raw > 0) & (fused.depth > 0) & (single > 0)
    errors = {
        name: _error(depth, truth, both)
        for name, depth in (("raw", raw), ("fused", fused.depth), ("single_frame", single))
    }
    drift_mm, drift = motion_error(fused, recording)
    return {
        "drift_mm": drift_mm,
        "drift_deg": float(np.rad2deg(drift)),
        "raw_noise_mm": errors["raw"].rms,
        "fused_noise_mm": errors["fused"].rms,
        "raw_noise_mean_mm": errors["raw"].mean,
        "fused_noise_mean_mm": errors["fused"].mean,
        "fused_bias_mm": float(np.mean(fused.depth[both].astype(np.float64) - truth[both])),
        "single_frame_noise_mm": errors["single_frame"].rms,
        "coverage": _coverage(fused.depth, face),
        "ungated_fused_noise_mm": _error(ungated, truth, face & (raw > 0) & (ungated > 0)).rms,
        "lost_frames": float(len(fused.report.lost)),
        "reported_noise_mm": fused.report.raw_noise_mm,
    }


def judged_pixels(truth: NDArray[np.floating], rectangle: Rectangle) -> NDArray[np.bool_]:
    """Return the pixels (H, W) of the head in the rectangle that are not at an edge of the true depth."""
    from scipy.ndimage import maximum_filter, minimum_filter

    left, top, right, bottom = rectangle
    mask = np.zeros(truth.shape, np.bool_)
    mask[top:bottom, left:right] = True
    smooth = maximum_filter(truth, _EDGE_PIXELS) - minimum_filter(truth, _EDGE_PIXELS) < _EDGE_MM
    inside = mask & smooth & (truth > 0)
    # a wall or shoulder lies far behind the nose
    return inside & (truth < truth[inside].min(initial=np.inf) + 180.0)


def motion_error(fused: FusedDepth, recording: SimulatedRecording) -> tuple[float, float]:
    """Return the largest error of the face's middle (mm) and of the head's turn (rad) over the tracked frames."""
    face = recording.subject.face
    middle = recording.vertices[face.topology.landmarks["fw74"]].astype(np.float64).mean(axis=0)
    reference = recording.camera_from_model[fused.reference]
    shifts, turns = [0.0], [0.0]
    for pose, camera_from_model in zip(fused.reference_from_frame, recording.camera_from_model):
        if pose is not None:
            true = reference.after(camera_from_model.inverse())
            seen = camera_from_model.apply(middle)
            shifts.append(float(np.linalg.norm(pose.apply(seen) - true.apply(seen))))
            turns.append(rotation_angle(pose.rotation, true.rotation))
    return max(shifts), max(turns)


def _error(depth: NDArray[np.floating], truth: NDArray[np.floating], pixels: NDArray[np.bool_]) -> DepthError:
    off = depth[pixels].astype(np.float64) - truth[pixels]
    return DepthError(float(np.sqrt(np.mean(off**2))), float(np.mean(np.abs(off))))


def _coverage(depth: NDArray[np.floating], face: NDArray[np.bool_]) -> float:
    """Return the share of pixels (H, W) that have depth."""
    return float(np.count_nonzero(depth[face]) / max(np.count_nonzero(face), 1))
