"""The region-based model that posing uses where none is named: built once, kept in the user's folder."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from facewright.errors import FileFormatError, StoreError

if TYPE_CHECKING:
    from pathlib import Path

    from facewright.faces.face import Face
    from facewright.models.performer_data import PerformerData
    from facewright.models.region_model import RegionModel

Progress = Callable[[str, int, int], None]

#: Raised when the recipe below changes, so that models of the old one are built again.
_RECIPE = 4
_SEED, _RATE = 0, 15.0
_PER_REGION = 20
_HOLISTIC_SHARE = 0.99  # of the squared motion: about as much as so many components keep of a region's


class RegionModels(NamedTuple):
    """A region-based model and, for comparison, a holistic one of the same data."""

    region: RegionModel
    holistic: RegionModel


def default_region_model_paths(face: str = "builtin") -> tuple[Path, Path]:
    """Return where the default models of a face are kept, region-based and holistic."""
    from facewright import __version__
    from facewright.apps.default_model import face_hash
    from facewright.faces import load_face
    from facewright.faces.store import facewright_home

    loaded = load_face(face)
    folder = facewright_home() / "models"
    stem = f"{loaded.name}-{__version__}-{_RECIPE}-{face_hash(loaded)}"
    return folder / f"{stem}.fwrm", folder / f"{stem}.holistic.fwrm"


def default_region_models(progress: Progress | None = None, *, face: str = "builtin") -> RegionModels:
    """Return the default models of a face, of the simulated performer M1: 397 vertices, as in the paper.

    Built the first time, in well under a minute, and kept in ``$FACEWRIGHT_HOME/models``, or the platform's user data
    folder; built again where the face or facewright's version changed or a file is damaged. The true surfaces of the
    simulated performance are used, not markers; the pose starts at the face's own mean.

    Parameters
    ----------
    progress : callable, optional
        Called with stage, done, total while they are built.
    face : str
        Name of a face, see `facewright.faces.load_face`.

    Raises
    ------
    MissingFaceError
        If the face is not installed.
    StoreError
        If the models cannot be written.
    """
    from facewright.models.region_store import load_region_model

    paths = default_region_model_paths(face)
    if all(path.is_file() for path in paths):
        try:
            return RegionModels(*(load_region_model(path) for path in paths))
        except FileFormatError:  # damaged: built again
            pass
    return _build(paths, face, progress)


def _build(paths: tuple[Path, Path], name: str, progress: Progress | None) -> RegionModels:
    from facewright.faces import load_face
    from facewright.models.region_store import save_region_model

    try:
        paths[0].parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StoreError(
            f"{paths[0].parent} must be a folder that can be written, to keep the default model there "
            f"({error.strerror or error}); give another place by FACEWRIGHT_HOME, or name a model."
        ) from error
    face = load_face(name)
    models = train_default(face, _performed(face, progress), progress)
    for model, path in zip(models, paths, strict=True):
        save_region_model(model, path)
    return models


def train_default(face: Face, data: PerformerData, progress: Progress | None = None) -> RegionModels:
    """Segment a performer's data and train both models for the mean of `face`.

    Raises
    ------
    ValueRangeError, DegenerateError
        See `facewright.apps.segment_regions.segment_performers`.
    """
    from facewright.apps.segment_regions import SegmentOptions, segment_performers
    from facewright.models.region_pca import fit_region_pca
    from facewright.models.regions import Regions

    # who poses a face expects left and right alike
    found = segment_performers([data], options=SegmentOptions(symmetric=True), progress=progress)
    moves = np.concatenate([clip.vertices - data.neutral for clip in data.clips])
    if data.mirror is not None:  # what one side of the performer does the other shall be able to
        moves = np.concatenate([moves, moves[:, data.mirror] * np.array([-1.0, 1.0, 1.0], np.float32)])
    provenance = {
        "template": data.template,
        "vertex_ids": data.vertex_ids.tolist(),
        "data": f"simulated performer {data.name}, seed {_SEED}, {_RATE:g} frames a second",
    }
    neutral = face.mean_shape[data.vertex_ids].astype(np.float64)
    region, holistic = (
        fit_region_pca(moves, data.faces, neutral, regions, count, provenance=provenance)
        for regions, count in (
            (found.regions, _PER_REGION),
            (Regions.holistic(data.n_vertices), _HOLISTIC_SHARE),
        )
    )
    return RegionModels(region, holistic)


def _performed(face: Face, progress: Progress | None) -> PerformerData:
    """Return what the simulated performer M1 did, on the coarse mesh of `face`."""
    from facewright.faces.coarse_face import coarse_face
    from facewright.faces.performers import simulate_performers
    from facewright.models.performer_data import PerformerData

    coarse = coarse_face(face)
    (performer,) = simulate_performers(face, np.random.default_rng(_SEED), names=("M1",), progress=progress)
    clips = []
    for k, name in enumerate(performer.clips):
        clips.append(_clip(performer.clip(name), coarse.vertex_ids))
        if progress is not None:
            progress("simulating a performance", k + 1, len(performer.clips))
    return PerformerData(
        name="M1",
        faces=coarse.faces,
        neutral=performer.person.neutral[coarse.vertex_ids],
        reference=coarse.positions,
        clips=tuple(clips),
        template=coarse.template,
        vertex_ids=coarse.vertex_ids,
        mirror=coarse.mirror,
    )


def _clip(clip, ids: NDArray[np.int32]):  # type: ignore[no-untyped-def]
    """Return some frames of a clip on some vertices, the head held still."""
    from facewright.models.performer_data import PerformerClip

    times = clip.performance.times
    step = max(1, round(1.0 / (_RATE * float(np.median(np.diff(times))))))
    meshes = clip.meshes(slice(None, None, step), rigid=False)
    T = meshes.n_frames
    return PerformerClip(
        clip.name, meshes.times, meshes.vertices[:, ids], np.tile(np.eye(3), (T, 1, 1)), np.zeros((T, 3))
    )
