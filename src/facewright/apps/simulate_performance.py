"""Write what a motion capture session with simulated performers would bring: markers of four people who act."""

from __future__ import annotations

import json
import os
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from facewright.errors import StoreError, ValueRangeError
from facewright.io.atomic import write_set_atomically
from facewright.numeric.check import check_choice

if TYPE_CHECKING:
    from facewright.faces.performers import Performer, SimulatedClip

Progress = Callable[[str, int, int], None]

FORMATS = ("c3d", "trc", "csv")
MANIFEST = "manifest.json"
MESH_FRAMES_PER_SECOND = 15.0
RECORDED_CURVES = "curves/alex_rom_3.csv"
"""The real recording, within the folder of FACEWRIGHT_TEST_DATA."""


@dataclass(frozen=True)
class SimulatePerformanceRequest:
    """What to simulate.

    Parameters
    ----------
    out : Path
        Folder of the session; one folder a performer is added to it, none is overwritten.
    face : str
        ``builtin``, ``ict`` or the path of a face's .npz file.
    seed : int
        Of performers, takes and noise; a clip depends on it, the performer and the clip alone.
    format : str
        Of the marker files: ``c3d``, ``trc`` or ``csv``.
    performers : tuple of str, optional
        Of ``M1``, ``F1``, ``M2``, ``F2``; all if absent.
    clips : tuple of str, optional
        Which clips; all if absent.
    meshes : bool
        Write the true surface of each clip beside, as ``meshes/CLIP.npz`` at 15 frames a second: times (T,), vertices
        (T, V, 3) of the skin with head motion, faces (F, 3).
    curves : Path or "none", optional
        Recording of face curves for the first performer's range of motion, "none" for a made-up one; where absent the
        real recording of ``FACEWRIGHT_TEST_DATA`` if there is one.
    """

    out: Path
    face: str = "builtin"
    seed: int = 0
    format: str = "c3d"
    performers: tuple[str, ...] | None = None
    clips: tuple[str, ...] | None = None
    meshes: bool = False
    curves: Path | str | None = None

    def __post_init__(self) -> None:
        if self.seed < 0:
            raise ValueRangeError(f"seed must not be negative, got {self.seed}.")
        check_choice("format", self.format, FORMATS)


@dataclass(frozen=True)
class SimulatePerformanceResult:
    """What was written.

    Parameters
    ----------
    out : Path
        The session's folder.
    performers : mapping of str to int
        Name -> number of markers.
    n_clips, n_frames : int
        Clips and frames in all.
    n_bytes : int
        Size of the performers' files.
    range_of_motion : str
        Where the first performer's range of motion comes from: a file name, ``made up``, or empty without it.
    """

    out: Path
    performers: dict[str, int]
    n_clips: int
    n_frames: int
    n_bytes: int
    range_of_motion: str


def simulate_performance(
    request: SimulatePerformanceRequest, progress: Progress | None = None
) -> SimulatePerformanceResult:
    """Write a session: ``OUT/<performer>/<clip>.<format>`` for every performer, and ``OUT/manifest.json``.

    A performer's folder appears when it is whole, together with the manifest that names it.

    Raises
    ------
    StoreError
        If a performer's folder exists already, the manifest is of another session, or the disk is full.
    ValueRangeError
        If a performer or clip is unknown.
    MissingFaceError, MissingExtraError
        If the face, or the package that writes C3D files, is not installed.
    """
    from facewright.faces import load_face
    from facewright.faces.performers import PERFORMER_NAMES, RANGE_OF_MOTION_NAME, simulate_performers

    names = request.performers or PERFORMER_NAMES
    for name in names:
        check_choice("performer", name, PERFORMER_NAMES)
    out = Path(request.out)
    manifest = _open_manifest(out, request, names)
    recorded, source = _recorded_motion(request.curves)
    performers = simulate_performers(
        load_face(request.face), np.random.default_rng(request.seed), names=names, recorded=recorded, progress=progress
    )
    chosen = {performer.name: _chosen_clips(performer, request.clips) for performer in performers}
    _check_all_known(request.clips, chosen)
    done, total, n_frames, n_bytes = 0, sum(map(len, chosen.values())), 0, 0
    for performer in performers:
        entries: dict[str, Any] = {}
        with write_set_atomically(out) as folder:
            (folder / performer.name).mkdir()
            for name in chosen[performer.name]:
                clip = performer.clip(name)
                entries[name] = _write_clip(folder / performer.name, clip, request)
                done, n_frames = done + 1, n_frames + clip.n_frames
                if progress is not None:
                    progress("writing clips", done, total)
            if RANGE_OF_MOTION_NAME in entries:
                entries[RANGE_OF_MOTION_NAME]["source"] = source
            manifest["performers"][performer.name] = {"markers": len(performer.layout.labels), "clips": entries}
            (folder / MANIFEST).write_text(json.dumps(manifest, indent=2) + "\n", encoding="utf-8")
            n_bytes += sum(f.stat().st_size for f in (folder / performer.name).rglob("*") if f.is_file())
    used = any(RANGE_OF_MOTION_NAME in clips for clips in chosen.values())
    return SimulatePerformanceResult(
        out,
        {performer.name: len(performer.layout.labels) for performer in performers},
        total,
        n_frames,
        n_bytes,
        source if used else "",
    )


def _open_manifest(out: Path, request: SimulatePerformanceRequest, names: tuple[str, ...]) -> dict[str, Any]:
    """Return the session's manifest, new or with the performers that are there; refuse to mix or overwrite."""
    from facewright import __version__
    from facewright.faces.acting import FRAMES_PER_SECOND

    fresh: dict[str, Any] = {
        "kind": "facewright simulated performance",
        "version": __version__,
        "face": request.face,
        "seed": request.seed,
        "format": request.format,
        "frames_per_second": FRAMES_PER_SECOND,
        "units": "mm",
        "up": "y",
        "performers": {},
    }
    if out.exists() and not out.is_dir():
        raise StoreError(f"{out} must be a folder for performances, got a file.")
    taken = [name for name in names if (out / name).exists()]
    if taken:
        raise StoreError(f"{out} holds {taken[0]} already and is not overwritten: give another folder or remove it.")
    if not (out / MANIFEST).is_file():
        return fresh
    try:
        there = json.loads((out / MANIFEST).read_text(encoding="utf-8"))
        same = all(there[key] == fresh[key] for key in ("kind", "face", "seed", "format"))
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise StoreError(f"{out / MANIFEST} must be a session's manifest, got another file.") from error
    if not same:
        raise StoreError(f"{out} holds a session of another face, seed or format: give another folder.")
    return dict(there)


def _recorded_motion(curves: Path | str | None) -> tuple[Any, str]:
    """Return the recorded performance, or None, and what it is called."""
    from facewright.apps.recorded_motion import read_recorded_motion
    from facewright.faces.acting import FRAMES_PER_SECOND

    if curves is None:
        folder = os.environ.get("FACEWRIGHT_TEST_DATA", "")
        there = Path(folder) / RECORDED_CURVES
        curves = there if folder and there.is_file() else "none"
    if str(curves) == "none":
        return None, "made up"
    return read_recorded_motion(curves, FRAMES_PER_SECOND), Path(curves).name


def _chosen_clips(performer: Performer, clips: tuple[str, ...] | None) -> tuple[str, ...]:
    """Return the performer's clips among those wanted."""
    return performer.clips if clips is None else tuple(name for name in performer.clips if name in clips)


def _check_all_known(clips: tuple[str, ...] | None, chosen: dict[str, tuple[str, ...]]) -> None:
    unknown = sorted(set(clips or ()) - {name for names in chosen.values() for name in names})
    if unknown:
        raise ValueRangeError(f"clips must be of the chosen performers, got {unknown[0]!r}.")


def _write_clip(folder: Path, clip: SimulatedClip, request: SimulatePerformanceRequest) -> dict[str, Any]:
    """Write markers, and meshes where wanted; return the manifest's entry."""
    from facewright.faces.acting_speech import load_sentences
    from facewright.io.markers import write_markers

    performer = clip.performer
    rng = np.random.default_rng((request.seed, zlib.crc32(f"{performer.name}/{clip.name}".encode())))
    data, faults = clip.record(rng)
    write_markers(folder / f"{clip.name}.{request.format}", data)
    if request.meshes:
        (folder / "meshes").mkdir(exist_ok=True)
        rate = 1.0 / float(np.median(np.diff(data.times)))
        meshes = clip.meshes(slice(None, None, max(1, round(rate / MESH_FRAMES_PER_SECOND))))
        np.savez(
            folder / "meshes" / f"{clip.name}.npz",
            times=meshes.times,
            vertices=meshes.vertices,
            faces=meshes.faces,
        )
    entry: dict[str, Any] = {
        "file": f"{performer.name}/{clip.name}.{request.format}",
        "frames": clip.n_frames,
        "seconds": round(float(data.times[-1]), 4),
        "unseen": round(float(1.0 - data.seen.mean()), 5),
        "swaps": [list(swap) for swap in faults.swaps],
        "set": "train" if clip.name in performer.train else "test" if clip.name in performer.test else "other",
    }
    spoken = {sentence.name: sentence for sentence in load_sentences()}.get(clip.name)
    if spoken is not None:
        entry |= {"emotion": spoken.emotion, "text": spoken.text}
    return entry
