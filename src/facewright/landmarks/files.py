"""Landmark files as landmarks of a known scheme."""

from __future__ import annotations

from pathlib import Path

from facewright.errors import FileFormatError
from facewright.io.points import read_points, write_points
from facewright.landmarks.points import Landmarks
from facewright.landmarks.scheme import SCHEME_NAMES, load_scheme


def read_landmarks(path: str | Path, scheme: str | None = None) -> Landmarks:
    """Read a landmark file and tell its scheme.

    Parameters
    ----------
    path : str or Path
        ``.pts``, ``.ljson`` or ``.json``, see `facewright.io.points.read_points`.
    scheme : str, optional
        Scheme of the points; by default what the file says, else the scheme with so many points.

    Returns
    -------
    Landmarks
        Points with confidence; missing ones have confidence 0.

    Raises
    ------
    StoreError
        If the file cannot be read.
    FileFormatError
        If it is corrupt, names an unknown scheme, or has a number of points that is not the scheme's.
    """
    file = read_points(path)
    if file.points.shape[1] != 2:
        raise FileFormatError(f"{path} must hold points of 2 coordinates in a picture, got 3.")
    by_count = {load_scheme(name).n_points: name for name in SCHEME_NAMES}
    name = scheme or file.scheme or by_count.get(len(file.points))
    if name is None:
        counts = ", ".join(f"{count} ({known})" for count, known in by_count.items())
        raise FileFormatError(f"{path} must hold {counts} points, got {len(file.points)}.")
    if name not in SCHEME_NAMES:
        raise FileFormatError(f"{path} must be of scheme {', '.join(SCHEME_NAMES)}, got {name!r}.")
    expected = load_scheme(name).n_points
    if len(file.points) != expected:
        raise FileFormatError(f"{path} must hold {expected} points of scheme {name}, got {len(file.points)}.")
    return Landmarks(name, file.points, file.confidence)


def write_landmarks(path: str | Path, landmarks: Landmarks) -> None:
    """Write landmarks as ``.json`` (with scheme, confidence and missing points) or ``.pts``.

    Raises
    ------
    ValueRangeError
        If the suffix is another, or a ``.pts`` file would have to hold missing points.
    StoreError
        If the file cannot be written.
    """
    write_points(path, landmarks.points, landmarks.scheme, landmarks.confidence)
