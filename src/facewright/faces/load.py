"""Load a face by name or from a file, and list the faces there are."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from facewright.errors import MissingFaceError
from facewright.faces.face import Face
from facewright.faces.store import stored_face_path


@dataclass(frozen=True)
class FaceInfo:
    """One line about a face, without loading it.

    Parameters
    ----------
    name : str
        What `load_face` takes.
    installed : bool
        Whether `load_face` would find it now.
    description : str
        What it is, in one line.
    licence : str
        Licence and attribution of its geometry.
    path : Path or None
        The file it is read from; None for the built-in face.
    """

    name: str
    installed: bool
    description: str
    licence: str
    path: Path | None = None


def list_faces() -> list[FaceInfo]:
    """Return every face `load_face` knows by name, installed or not."""
    from facewright.faces.builtin import BUILTIN_LICENCE
    from facewright.faces.ict import ICT_LICENCE

    path = stored_face_path("ict")
    return [
        FaceInfo(
            name="builtin",
            installed=True,
            description="comes with facewright, no download: 5-7 thousand vertices, 46 blendshapes",
            licence=BUILTIN_LICENCE,
        ),
        FaceInfo(
            name="ict",
            installed=path.is_file(),
            description="ICT-FaceKit light: 26,719 vertices (11,248 of skin), 100 identity modes, 46 blendshapes",
            licence=ICT_LICENCE,
            path=path,
        ),
    ]


def load_face(name: str | Path) -> Face:
    """Load a face: mean, identity modes and the 46 generic blendshapes on one topology.

    Parameters
    ----------
    name : str or Path
        ``"builtin"``, ``"ict"`` (once installed), or the path of a compact ``.npz`` file.

    Returns
    -------
    Face
        Kept in memory and shared between calls; treat its arrays as read-only.

    Raises
    ------
    MissingFaceError
        If the name is unknown or the face is not installed; the message says how to install it.
    FileFormatError
        If the file is truncated, corrupt or foreign.
    """
    text = str(name)
    if text == "builtin":
        return _load_builtin()
    if text == "ict":
        path = stored_face_path("ict")
        if not path.is_file():
            raise MissingFaceError(
                "face 'ict' must be installed first: run `facewright faces install ict`, "
                f"with --from PATH if you have it already (looked for {path})."
            )
        return _load_file(path, path.stat().st_mtime_ns)
    if text.endswith(".npz"):
        path = Path(text)
        if not path.is_file():
            raise MissingFaceError(f"face file must exist, got {path}.")
        return _load_file(path, path.stat().st_mtime_ns)
    raise MissingFaceError(f"face must be 'builtin', 'ict' or the path of a .npz file, got {text!r}.")


@lru_cache(maxsize=1)
def _load_builtin() -> Face:
    from facewright.faces.builtin import load_builtin_face

    return load_builtin_face()


@lru_cache(maxsize=2)
def _load_file(path: Path, _modified: int) -> Face:
    from facewright.faces.ict import read_ict_compact

    return read_ict_compact(path)
