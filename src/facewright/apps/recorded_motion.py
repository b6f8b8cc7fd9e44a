"""A recording's curves as something to act: gaps filled, evenly sampled, smooth enough for 120 frames a second."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.ndimage import gaussian_filter1d

from facewright.apps.performance_files import read_performance
from facewright.apps.untracked_frames import fill_untracked
from facewright.errors import FileFormatError
from facewright.models.performance import Performance
from facewright.models.resample_performance import resampled

#: Standard deviation of the smoothing, seconds: a camera's 30 frames a second hold nothing quicker.
_SMOOTH_S = 0.02
_SHORTEST_S = 1.0


def read_recorded_motion(path: str | Path, frames_per_second: float) -> Performance:
    """Read curves and resample them to an even, higher rate, without what lies before and after the tracked frames.

    Coefficients pass between frames on monotone cubics, smoothed over 20 ms: linear ones would bend at every frame of
    the source, which no face does.

    Parameters
    ----------
    path : str or Path
        See `facewright.apps.performance_files.read_performance`.
    frames_per_second : float
        Of the result.

    Raises
    ------
    StoreError, FileFormatError
        If the file cannot be read, is of another kind, or shows a face for less than a second.
    NoFaceError
        If no frame is tracked.
    """
    recording = read_performance(path)
    filled, _ = fill_untracked(recording.performance, recording.cuts)
    seen = np.flatnonzero(filled.tracked)
    first, last = float(filled.times[seen[0]]), float(filled.times[seen[-1]])
    if last - first < _SHORTEST_S:
        raise FileFormatError(f"{path} must show a face for at least {_SHORTEST_S:g} s, got {last - first:.2f} s.")
    times = first + np.arange(int((last - first) * frames_per_second + 1e-6) + 1) / frames_per_second
    motion = resampled(filled, np.minimum(times, last))
    weights = PchipInterpolator(filled.times, filled.weights, axis=0)(motion.times)
    weights = gaussian_filter1d(weights, _SMOOTH_S * frames_per_second, axis=0, mode="nearest")
    return Performance(
        times=motion.times - motion.times[0],
        names=motion.names,
        weights=np.clip(weights, 0.0, 1.0),
        rotations=motion.rotations,
        translations=motion.translations,
        gaze=motion.gaze,
        tracked=np.ones(motion.n_frames, dtype=bool),
    )
