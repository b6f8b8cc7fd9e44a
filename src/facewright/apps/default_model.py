"""The model that every photo verb uses where none is named: built once, kept in the user's folder."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from facewright.errors import FileFormatError, StoreError

if TYPE_CHECKING:
    from facewright.faces.face import Face
    from facewright.models.bilinear import BilinearModel

Progress = Callable[[str, int, int], None]

#: Raised when the recipe below changes, so that models of the old one are built again.
_RECIPE = 1
_SEED, _N_PEOPLE, _N_IDENTITY, _N_EXPRESSION = 0, 150, 50, 47


def default_model_path(face: str = "builtin") -> Path:
    """Return where the default model of a face is kept; the name tells version, recipe and the face's contents."""
    from facewright import __version__
    from facewright.faces import load_face
    from facewright.faces.store import facewright_home

    loaded = load_face(face)
    return facewright_home() / "models" / f"{loaded.name}-{__version__}-{_RECIPE}-{face_hash(loaded)}.fwbm"


def default_model(progress: Progress | None = None, *, face: str = "builtin") -> BilinearModel:
    """Return the default model, 50 identities x 47 expressions of 150 simulated people, seed 0.

    Built the first time (about 40 seconds with the built-in face) and kept in ``$FACEWRIGHT_HOME/models``, or the
    platform's user data folder; built again where the face or facewright's version changed or the file is damaged.

    Parameters
    ----------
    progress : callable, optional
        Called with stage, done, total while it is built.
    face : str
        Name of a face, see `facewright.faces.load_face`.

    Raises
    ------
    MissingFaceError
        If the face is not installed.
    StoreError
        If the model cannot be written.
    """
    path = default_model_path(face)
    if path.is_file():
        try:
            return _loaded(path, path.stat().st_mtime_ns)
        except FileFormatError:  # damaged: built again
            pass
    _build(path, face, progress)
    return _loaded(path, path.stat().st_mtime_ns)


def model_or_default(path: Path | None, progress: Progress | None = None) -> BilinearModel:
    """Return the model of a file, or the default one where absent.

    Raises
    ------
    StoreError, FileFormatError
        If the file cannot be read or is no model.
    """
    if path is None:
        return default_model(progress)
    from facewright.models.bilinear_store import load_bilinear

    return load_bilinear(path)


@lru_cache(maxsize=1)
def _loaded(path: Path, _modified: int) -> BilinearModel:
    from facewright.models.bilinear_store import load_bilinear

    return load_bilinear(path)


def _build(path: Path, face: str, progress: Progress | None) -> None:
    from facewright.apps.build_model import BuildModelRequest, build_model

    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StoreError(
            f"{path.parent} must be a folder that can be written, to keep the default model there "
            f"({error.strerror or error}); give another place by FACEWRIGHT_HOME, or a model by --model."
        ) from error
    request = BuildModelRequest(
        path,
        face=face,
        n_people=_N_PEOPLE,
        n_identity=_N_IDENTITY,
        n_expression=_N_EXPRESSION,
        seed=_SEED,
        n_unseen=0,
    )
    build_model(request, progress)


def face_hash(face: Face) -> str:
    """Return 12 hex digits that change with the geometry and the modes of a face."""
    digest = hashlib.sha256(face.topology.fingerprint.encode())
    for array in (face.mean_shape, face.identity_basis, face.blendshape_deltas):
        digest.update(np.ascontiguousarray(array, dtype=np.float32).data)
    return digest.hexdigest()[:12]
