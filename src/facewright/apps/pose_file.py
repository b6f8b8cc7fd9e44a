"""Pose sessions as files (.fwpose): JSON that names the models it belongs to."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from facewright.apps.pose_session import PoseSession
from facewright.apps.pose_state import KINDS, PoseState
from facewright.errors import FacewrightError, FileFormatError, StoreError
from facewright.io.atomic import write_atomically
from facewright.models.pose_keyframes import PoseKeyframes
from facewright.models.region_model import RegionModel
from facewright.models.region_store import region_fingerprint

FORMAT = "facewright pose"
VERSION = 1
SUFFIX = ".fwpose"
MAX_BYTES = 256 << 20

#: Two pins of one vertex farther apart than this contradict each other, mm.
_SAME_MM = 1e-3


def write_pose(path: str | os.PathLike[str], state: PoseState, models: Mapping[str, RegionModel]) -> None:
    """Write a session's state, completely or not at all.

    Raises
    ------
    StoreError
        If the file cannot be written.
    """
    content = {
        "format": FORMAT,
        "version": VERSION,
        "models": {kind: region_fingerprint(model) for kind, model in models.items()},
        "beta": state.beta,
        "gamma": state.gamma,
        "symmetric": state.symmetric,
        "time": state.time,
        "pins": [{"vertex": vertex, "target_mm": target.tolist()} for vertex, target in state.pins.items()],
        "pose": {kind: state.coefficients[kind].tolist() for kind in models},
        "keyframes": [
            {"time": float(time), **{kind: state.keyframes[kind].coefficients[k].tolist() for kind in models}}
            for k, time in enumerate(state.keyframes["region"].times)
        ],
    }
    text = json.dumps(content, allow_nan=False, separators=(",", ":"))
    with write_atomically(path) as temporary:
        temporary.write_text(text + "\n", encoding="utf-8")


def open_pose(path: str | os.PathLike[str], session: PoseSession) -> None:
    """Take a session up where a file left it; the session keeps its models, its steps are forgotten.

    A file without the session's holistic model gets the holistic poses nearest to its own.

    Raises
    ------
    StoreError
        If the file cannot be read.
    FileFormatError
        If it is no pose, belongs to another model, or holds values that cannot be: a vertex out of range, two pins of
        one vertex at different places, a negative beta or gamma.
    """
    path = Path(path)
    content = _content(path)
    _check_models(path, content, session)
    try:
        state = _state(path, content, session)
        session.take_up(state)
    except FileFormatError:
        raise
    except FacewrightError as error:
        raise FileFormatError(f"{path} must hold a pose of this model, got one in which {error}") from error


def _check_models(path: Path, content: dict[str, Any], session: PoseSession) -> None:
    named = content.get("models")
    own = {kind: region_fingerprint(model) for kind, model in session.models.items()}
    if not isinstance(named, dict) or named.get("region") != own["region"]:
        found = named.get("region") if isinstance(named, dict) else None
        raise FileFormatError(
            f"{path} must hold a pose of this model ({own['region']}), got one of another model ({found}): open it "
            "with the model that it was made with."
        )
    if named.get("holistic") != own.get("holistic"):
        for entry in (content.get("pose"), *_list(content, "keyframes")):
            if isinstance(entry, dict):
                entry.pop("holistic", None)  # of another holistic model: made anew


def _state(path: Path, content: dict[str, Any], session: PoseSession) -> PoseState:
    P = session.model.n_coefficients
    keys = _list(content, "keyframes")
    times = _numbers(path, "the times of keyframes", [_get(key, "time") for key in keys], (len(keys),))
    poses = {"region": _numbers(path, "keyframes", [_get(key, "region") for key in keys], (len(keys), P))}
    pose = {"region": _numbers(path, "the pose", _get(content.get("pose"), "region"), (P,))}
    if "holistic" in session.models:
        Q = session.models["holistic"].n_coefficients
        known = [_get(entry, "holistic") for entry in (content.get("pose"), *keys)]
        if any(values is None for values in known):
            known = [session.as_holistic(zeta).tolist() for zeta in (pose["region"], *poses["region"])]
        values = _numbers(path, "holistic poses", known, (len(known), Q))
        pose["holistic"], poses["holistic"] = values[0], values[1:]
    numbers = {
        name: float(_numbers(path, name, content.get(name), ()))
        for name in ("beta", "gamma", "time")
        if name in content
    }
    symmetric = content.get("symmetric", False)
    if not isinstance(symmetric, bool):
        raise FileFormatError(f"{path} must hold true or false as 'symmetric', got {symmetric!r}.")
    return PoseState(
        coefficients={kind: pose[kind] for kind in KINDS if kind in pose},
        keyframes={kind: PoseKeyframes(times, poses[kind]) for kind in KINDS if kind in poses},
        pins=_pins(path, content),
        symmetric=symmetric,
        **numbers,
    )


def _pins(path: Path, content: dict[str, Any]) -> dict[int, NDArray[np.float64]]:
    pins: dict[int, NDArray[np.float64]] = {}
    for entry in _list(content, "pins"):
        vertex = _get(entry, "vertex")
        if not isinstance(vertex, int) or isinstance(vertex, bool):
            raise FileFormatError(f"{path} must give every pin a whole number as 'vertex', got {vertex!r}.")
        target = _numbers(path, "the target of a pin", _get(entry, "target_mm"), (3,))
        if vertex in pins and np.linalg.norm(pins[vertex] - target) > _SAME_MM:
            raise FileFormatError(f"{path} pins vertex {vertex} at two places: pins must not contradict each other.")
        pins[vertex] = target
    return pins


def _content(path: Path) -> dict[str, Any]:
    try:
        if path.is_file() and path.stat().st_size > MAX_BYTES:
            raise FileFormatError(f"{path} must have at most {MAX_BYTES >> 20} MB, got {path.stat().st_size >> 20} MB.")
        content = json.loads(path.read_text(encoding="utf-8-sig"))
    except OSError as error:
        raise StoreError(f"{path} must be a readable file, got: {error.strerror or error}.") from error
    except (ValueError, RecursionError) as error:
        raise FileFormatError(f"{path} must be a pose (JSON in UTF-8), got: {error}.") from error
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise FileFormatError(f'{path} must be a pose of facewright ("format": "{FORMAT}"), got another file.')
    if content.get("version") != VERSION:
        raise FileFormatError(
            f"{path} must be of version {VERSION}, got {content.get('version')!r}: another facewright wrote it."
        )
    return content


def _list(content: dict[str, Any], name: str) -> list[Any]:
    entries = content.get(name, [])
    return entries if isinstance(entries, list) else []


def _get(entry: Any, name: str) -> Any:
    return entry.get(name) if isinstance(entry, dict) else None


def _numbers(path: Path, what: str, given: Any, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Return finite numbers of a shape."""
    try:
        values = np.array(given if given is not None else np.nan, dtype=np.float64)
        if 0 in shape and values.size == 0:
            values = values.reshape(shape)
    except (TypeError, ValueError):
        values = np.full(1, np.nan)
    if values.shape != shape or not np.isfinite(values).all():
        wanted = " x ".join(map(str, shape)) or "one"
        raise FileFormatError(f"{path} must hold {wanted} finite numbers as {what}, got others.")
    return values
