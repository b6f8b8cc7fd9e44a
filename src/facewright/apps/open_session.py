"""Everything that posing needs, from names and files."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from facewright.apps.pose_session import BETA, GAMMA, PoseSession
from facewright.apps.posed_character import PosedCharacter, load_character
from facewright.errors import MissingFaceError, StoreError, TopologyError, ValueRangeError

Progress = Callable[[str, int, int], None]

#: Where a session is saved if no file is named.
DEFAULT_FILE = Path("pose.fwpose")


@dataclass(frozen=True)
class OpenSessionRequest:
    """What to pose.

    Parameters
    ----------
    model : Path, optional
        A region model (.fwrm); the default one of the built-in face where absent.
    character : str, optional
        See `facewright.apps.posed_character.load_character`; where absent the built-in face, or the model's own mesh
        if that does not lie on a face.
    file : Path, optional
        A pose to go on with, and where steps are saved; a new `DEFAULT_FILE` in the working folder where absent.
    holistic : Path, optional
        A model of one region for comparison; the default model brings its own.
    beta, gamma : float
        Weights of eq. 9; a file's own take their place.
    """

    model: Path | None = None
    character: str | None = None
    file: Path | None = None
    holistic: Path | None = None
    beta: float = BETA
    gamma: float = GAMMA


@dataclass(frozen=True, eq=False)
class OpenedSession:
    """A session and the character that shows it.

    Parameters
    ----------
    session : PoseSession
    character : PosedCharacter
    title : str
        Name of the model for people.
    """

    session: PoseSession
    character: PosedCharacter
    title: str


def open_session(request: OpenSessionRequest, progress: Progress | None = None) -> OpenedSession:
    """Load models, character and the file to go on with.

    Raises
    ------
    StoreError, FileFormatError
        If a file cannot be read, is of another kind, or the pose belongs to another model.
    ValueRangeError, TopologyError, MissingFaceError
        If beta or gamma is negative, the models' meshes differ, or there is no such character.
    """
    from facewright.apps.pose_file import open_pose
    from facewright.models.region_store import load_region_model

    file = request.file or _unused(DEFAULT_FILE)
    if not file.resolve().parent.is_dir():
        raise StoreError(f"{file} cannot be written: the folder {file.parent} does not exist.")
    holistic = None if request.holistic is None else load_region_model(request.holistic)
    if request.model is None:
        from facewright.apps.default_region_model import default_region_models

        models = default_region_models(progress)
        model, title = models.region, "built-in face, default model"
        holistic = models.holistic if holistic is None else holistic
    else:
        model, title = load_region_model(request.model), request.model.name
    session = PoseSession(model, holistic=holistic, beta=request.beta, gamma=request.gamma)
    if file.exists():
        open_pose(file, session)
    session.autosave = file
    return OpenedSession(session, _character(request.character, session), title)


def _character(name: str | None, session: PoseSession) -> PosedCharacter:
    if name is not None:
        return load_character(name, session.models)
    try:
        return load_character("builtin", session.models)
    except (TopologyError, MissingFaceError):  # of a mesh that no face has
        return load_character("none", session.models)


def _unused(path: Path) -> Path:
    """Return a path beside `path` that is not there yet: pose.fwpose, pose-2.fwpose, ..."""
    for number in range(1, 10_000):
        found = path if number == 1 else path.with_stem(f"{path.stem}-{number}")
        if not found.exists():
            return found
    raise ValueRangeError(f"file must be named: {path} and thousands beside it are there already.")
