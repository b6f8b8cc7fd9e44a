"""Where installed faces live on the user's machine."""

from __future__ import annotations

import os
from pathlib import Path


def facewright_home() -> Path:
    """Return the folder of everything facewright keeps: ``$FACEWRIGHT_HOME``, else the platform's user data folder."""
    home = os.environ.get("FACEWRIGHT_HOME")
    if home:
        return Path(home).expanduser()
    import platformdirs

    return Path(platformdirs.user_data_dir("facewright", appauthor=False))


def face_store() -> Path:
    """Return the folder of installed faces (it may not exist yet); each face is one ``NAME.npz`` in it."""
    return facewright_home() / "faces"


def stored_face_path(name: str) -> Path:
    """Return where the face `name` lies once it is installed."""
    return face_store() / f"{name}.npz"
