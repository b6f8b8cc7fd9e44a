"""Motion capture files of one performer become registered meshes in one file."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from facewright.errors import FileFormatError, StoreError, ValueRangeError
from facewright.io.markers import MARKER_SUFFIXES, MarkerRecording, read_markers
from facewright.models.performer_data import PerformerData
from facewright.models.sequence_store import save_performer

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class ImportMocapRequest:
    """What to import.

    Parameters
    ----------
    files : tuple of Path
        Marker files (.c3d, .trc, .csv) or folders of them; with `meshes`, folders of OBJ or PLY files, .npz files, or
        folders of .npz files.
    out : Path
        The performer's file (.fwms).
    template : str
        Face that is fitted: ``builtin``, ``ict`` or the path of a face's .npz file.
    n_vertices : int
        Of the coarse mesh.
    neutral : str, optional
        ``CLIP`` or ``CLIP:FRAME`` at rest; see `RegistrationSettings`.
    performer : str, optional
        Name; that of the output file where absent.
    unit, up : str, optional
        Of files that do not say.
    standoff_mm : float
        Height of the markers' centres above the skin.
    gap_limit_s : float
        Longest gap that is interpolated.
    frames_per_second : float, optional
        Frames to keep; all where absent. With `meshes`, the rate of folders, 30 where absent.
    meshes : bool
        Files are meshes of one topology: nothing is fitted.
    picture : Path, optional
        Markers over mesh; none where absent.
    """

    files: tuple[Path, ...]
    out: Path
    template: str = "builtin"
    n_vertices: int = 397
    neutral: str | None = None
    performer: str | None = None
    unit: str | None = None
    up: str | None = None
    standoff_mm: float = 1.5
    gap_limit_s: float = 0.5
    frames_per_second: float | None = None
    meshes: bool = False
    picture: Path | None = None

    def __post_init__(self) -> None:
        if not self.files:
            raise ValueRangeError("files must name at least one recording, got none.")


@dataclass(frozen=True, eq=False)
class ImportMocapResult:
    """What was imported.

    Parameters
    ----------
    data : PerformerData
        As saved.
    path : Path
        Where.
    picture : Path or None
    notes : tuple of str
        What was guessed, mended or left out: one sentence each.
    """

    data: PerformerData
    path: Path
    picture: Path | None
    notes: tuple[str, ...]

    def summary(self) -> dict[str, Any]:
        """Return what was done as JSON values."""
        return {
            "performer": self.data.name,
            "path": str(self.path),
            "picture": None if self.picture is None else str(self.picture),
            "clips": len(self.data.clips),
            "frames": sum(clip.n_frames for clip in self.data.clips),
            "vertices": self.data.n_vertices,
            "template": self.data.template,
            "statistics": dict(self.data.statistics),
            "notes": list(self.notes),
        }


def import_mocap(request: ImportMocapRequest, progress: Progress | None = None) -> ImportMocapResult:
    """Import all recordings of a performer; see `register_performer` and `performer_from_meshes`.

    Raises
    ------
    StoreError, FileFormatError, MissingExtraError
        If a recording cannot be read, or the result not be written.
    ValueRangeError, DegenerateError, TopologyError
        If recordings do not belong together or no face is found in them.
    MissingFaceError
        If the template is not installed.
    """
    return _import_meshes(request, progress) if request.meshes else _import_markers(request, progress)


def _import_markers(request: ImportMocapRequest, progress: Progress | None) -> ImportMocapResult:
    from facewright.apps.mocap_picture import markers_over_mesh
    from facewright.faces import load_face
    from facewright.fitting.marker_registration import RegistrationSettings, register_performer
    from facewright.io.image import write_image

    face = load_face(request.template)
    paths = _recordings(request.files)
    recordings: dict[str, MarkerRecording] = {}
    notes: list[str] = []
    for number, (name, path) in enumerate(paths.items()):
        found = read_markers(path, unit=request.unit, up=request.up)
        recordings[name] = found
        notes += [f"{name}: {note}." for note in found.notes]
        if progress is not None:
            progress("reading recordings", number + 1, len(paths))
    ups = {found.up for found in recordings.values()}
    if len(ups) > 1:
        raise ValueRangeError("recordings must all state the axis that points up or none of them; give it.")
    # read_markers has turned those that say
    settings = RegistrationSettings(
        n_vertices=request.n_vertices,
        neutral=request.neutral,
        standoff_mm=request.standoff_mm,
        gap_limit_s=request.gap_limit_s,
        frames_per_second=request.frames_per_second,
        up=None if ups == {None} else "y",
    )
    clips = {name: found.markers for name, found in recordings.items()}
    registered = register_performer(clips, face, name=_name(request), settings=settings, progress=progress)
    if ups == {None}:
        notes.append(f"the recordings do not say which axis points up; it is {registered.data.statistics['up']}.")
    notes += _told(registered.data)
    save_performer(registered.data, request.out)
    if request.picture is not None:
        write_image(request.picture, markers_over_mesh(registered))
    return ImportMocapResult(registered.data, request.out, request.picture, tuple(notes))


def _import_meshes(request: ImportMocapRequest, progress: Progress | None) -> ImportMocapResult:
    from facewright.apps.mesh_sequences import mesh_recordings, performer_from_meshes, read_mesh_sequence
    from facewright.apps.mocap_picture import coarse_meshes
    from facewright.io.image import write_image

    rate = 30.0 if request.frames_per_second is None else request.frames_per_second
    if not (rate > 0 and np.isfinite(rate)):
        raise ValueRangeError(f"frames_per_second must be positive, got {rate}.")
    clips = {}
    paths = mesh_recordings(request.files)
    for number, (name, path) in enumerate(paths.items()):
        clips[name] = read_mesh_sequence(path, rate)
        if progress is not None:
            progress("reading meshes", number + 1, len(paths))
    data = performer_from_meshes(
        clips, name=_name(request), n_vertices=request.n_vertices, neutral=request.neutral, progress=progress
    )
    save_performer(data, request.out)
    if request.picture is not None:
        write_image(request.picture, coarse_meshes(data))
    return ImportMocapResult(data, request.out, request.picture, ())


def _name(request: ImportMocapRequest) -> str:
    return request.performer or request.out.stem


def _recordings(files: tuple[Path, ...]) -> dict[str, Path]:
    """Return the marker files by name, those of folders in the order of names."""
    found: dict[str, Path] = {}
    for file in files:
        if file.is_dir():
            inside = sorted(path for path in file.iterdir() if path.suffix.lower() in MARKER_SUFFIXES)
            if not inside:
                raise FileFormatError(f"{file} must hold marker files in {', '.join(MARKER_SUFFIXES)}, got none.")
        elif file.is_file():
            inside = [file]
        else:
            raise StoreError(f"{file} must be a marker file or a folder of them, got nothing there.")
        for path in inside:
            if path.stem in found:
                raise ValueRangeError(f"recordings must have different names, got {path.stem!r} twice.")
            found[path.stem] = path
    return found


def _told(data: PerformerData) -> list[str]:
    """Return one sentence for everything that was mended or left out."""
    notes = []
    clips = data.statistics["clips"]
    limit = data.statistics["gap_limit_s"]
    total = {key: sum(clip[key] for clip in clips.values()) for key in ("relabelled", "out_of_place", "filled")}
    frames = sum(clip["frames"] for clip in clips.values())
    values = frames * data.statistics["markers"]
    if data.statistics["relabelled_at_rest"]:
        notes.append(f"{data.statistics['relabelled_at_rest']} markers at rest bore other labels than in most frames.")
    if total["relabelled"]:
        notes.append(f"{total['relabelled']} of {values} values bore another marker's label and got their own back.")
    if total["out_of_place"]:
        notes.append(f"{total['out_of_place']} values where no face would have a marker were left out.")
    beyond = sum(clip["beyond_limit"] for clip in clips.values())
    if total["filled"] or beyond:
        longest = max(clip["longest_gap_s"] for clip in clips.values())
        notes.append(
            f"{total['filled']} unseen values in gaps up to {limit:g} s were interpolated; {beyond} in longer ones, up "
            f"to {longest:.2f} s, follow the other markers alone."
        )
    for name, clip in clips.items():
        if clip["frames_left_out"]:
            notes.append(f"{name}: {clip['frames_left_out']} frames with fewer than half the markers were left out.")
        if clip["frames_implausible"]:
            notes.append(f"{name}: {clip['frames_implausible']} frames whose markers lie on no face were left out.")
        if clip["labels_out_of_place"]:
            wrong = clip["labels_out_of_place"]
            some = ", ".join(wrong[:4]) + (", ..." if len(wrong) > 4 else "")
            notes.append(f"{name}: {len(wrong)} markers ({some}) are out of place in most frames: labelled wrongly?")
        if clip["labels_missing"]:
            notes.append(f"{name}: {len(clip['labels_missing'])} markers that are seen at rest are missing.")
        if clip["labels_unknown"]:
            notes.append(f"{name}: {len(clip['labels_unknown'])} labels that are not seen at rest were left out.")
    return notes
