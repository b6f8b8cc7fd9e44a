"""Learn a region-based model from performers' registered data (Tena et al. 2011, sections 3.1 and 5)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from facewright.errors import TopologyError, ValueRangeError

if TYPE_CHECKING:
    from facewright.apps.segment_regions import SegmentOptions
    from facewright.models.performer_data import PerformerData
    from facewright.models.region_model import RegionModel
    from facewright.models.regions import Regions

Progress = Callable[[str, int, int], None]
Basis = Literal["pca", "blendshapes"]
BASES: tuple[Basis, ...] = ("pca", "blendshapes")

#: Components of each region where none are named.
COMPONENTS = 15
#: Frames that a bounded basis is measured on: each is a search of its own.
MEASURED_FRAMES = 200
_ROUNDING = 1e-3


@dataclass(frozen=True)
class TrainOptions:
    """What kind of model is learned.

    Parameters
    ----------
    components : int or float
        PCA components of each region, or the share of its squared motion to keep, in (0, 1).
    holistic : bool
        One region of all vertices.
    basis : {"pca", "blendshapes"}
        "blendshapes": the template's 46 shapes in each region they move, bounded to [0, 1]; data then only measure.
    centred : bool
        PCA about the mean displacement instead of about the neutral.
    frames_per_second : float, optional
        Rate that recordings are thinned to; all frames where absent.
    clips : sequence of str
        Only these clips; all where empty.
    left_out : sequence of str
        Clips that are not trained with, but measured with.
    neutral : str, optional
        Performer whose neutral the model poses; the first where absent.
    beta : float
        Weight of the boundaries where the model is measured.
    """

    components: int | float = COMPONENTS
    holistic: bool = False
    basis: Basis = "pca"
    centred: bool = False
    frames_per_second: float | None = None
    clips: Sequence[str] = ()
    left_out: Sequence[str] = ()
    neutral: str | None = None
    beta: float = 0.5


@dataclass(frozen=True, eq=False)
class TrainRequest:
    """What to learn from.

    Parameters
    ----------
    data : sequence of path
        Performers' registered data, `facewright mocap import`; of one mesh.
    out : path
        The model to write (.fwrm).
    regions : path, optional
        Regions of `facewright regions segment`; found from the data with the paper's parameters where absent.
    options : TrainOptions
    """

    data: Sequence[Path]
    out: Path
    regions: Path | None = None
    options: TrainOptions = TrainOptions()


@dataclass(frozen=True, eq=False)
class TrainResult:
    """A model and how well it describes what it was trained with, and what it was not.

    Parameters
    ----------
    model : RegionModel
    n_frames : int
        Frames trained with.
    train_rms_mm, left_out_rms_mm : mapping of str to float
        Eq. 13 for each performer, mm.
    remarks : tuple of str
        What the user should know.
    """

    model: RegionModel
    n_frames: int
    train_rms_mm: Mapping[str, float]
    left_out_rms_mm: Mapping[str, float] = field(default_factory=dict)
    remarks: tuple[str, ...] = ()


def train_from_files(request: TrainRequest, progress: Progress | None = None) -> TrainResult:
    """Read performers' data, learn a model and write it.

    Raises
    ------
    StoreError, FileFormatError
        If a file cannot be read or written.
    ValueRangeError, TopologyError, DegenerateError
        See `train_regions`.
    """
    from facewright.models.region_files import read_regions
    from facewright.models.region_store import save_region_model
    from facewright.models.sequence_store import load_performer

    if not request.data:
        raise ValueRangeError("at least one performer's data must be given, got none.")
    if request.regions is not None and request.options.holistic:
        raise ValueRangeError("a holistic model has one region: give either regions or holistic, not both.")
    regions = None if request.regions is None else read_regions(request.regions)
    performers = [load_performer(path) for path in request.data]
    result = train_regions(performers, regions, request.options, progress=progress)
    save_region_model(result.model, request.out)
    return result


def train_regions(
    performers: Sequence[PerformerData],
    regions: Regions | None = None,
    options: TrainOptions | None = None,
    *,
    segmentation: SegmentOptions | None = None,
    progress: Progress | None = None,
) -> TrainResult:
    """Learn a model from performers in correspondence; each one's displacements are from the own neutral.

    Parameters
    ----------
    performers : sequence of PerformerData
    regions : Regions, optional
        Found from the training data where absent (and the model is not holistic).
    options : TrainOptions, optional
    segmentation : SegmentOptions, optional
        How regions are found.
    progress : callable, optional

    Raises
    ------
    ValueRangeError, DegenerateError
        If the performers are of different meshes, a clip or performer is unknown, or fewer than two frames are left.
    TopologyError
        If regions are of another mesh, or blendshapes are asked of data that were not fitted to a face.
    """
    from facewright.models.regions import Regions

    options = options or TrainOptions()
    report = progress or (lambda *_: None)
    first = _one_mesh(performers)
    names = _training_clips(performers, options)
    if options.holistic:
        regions = Regions.holistic(first.n_vertices)
    elif regions is None:
        from facewright.apps.segment_regions import segment_performers

        regions = segment_performers(_only(performers, names), (), segmentation, progress).regions
    if regions.n_vertices != first.n_vertices:
        raise TopologyError(f"regions must be of the data's {first.n_vertices} vertices, got {regions.n_vertices}.")
    rate = options.frames_per_second
    report("reading frames", 0, len(performers))
    train = {one.name: _frames(one, names[one.name], rate) for one in performers}
    report("learning regions", 0, 1)
    model = _learn(performers, regions, np.concatenate(list(train.values())), options)
    report("learning regions", 1, 1)
    other = {
        one.name: _frames(one, [clip for clip in options.left_out if clip in one.clip_names], rate)
        for one in performers
    }
    remarks = _remarks(model, options)
    measured = [train, {name: frames for name, frames in other.items() if len(frames)}]
    if options.basis == "blendshapes":
        thinned = [_thinned(frames) for frames in measured]
        all_of_them, left = (sum(len(f) for group in groups for f in group.values()) for groups in (measured, thinned))
        if left < all_of_them:
            remarks += (f"the reconstruction is measured on {left} of {all_of_them} frames, evenly spread.",)
        measured = thinned
    trained, unseen = (_measure(model, frames, options.beta, report) for frames in measured)
    return TrainResult(model, sum(len(frames) for frames in train.values()), trained, unseen, remarks)


def _thinned(frames: Mapping[str, NDArray[np.float32]]) -> dict[str, NDArray[np.float32]]:
    """Return up to `MEASURED_FRAMES` frames of all performers together, evenly spread over each one's."""
    most = max(MEASURED_FRAMES // max(len(frames), 1), 1)
    return {
        name: moves[np.linspace(0, len(moves) - 1, most).round().astype(int)] if len(moves) > most else moves
        for name, moves in frames.items()
    }


def _one_mesh(performers: Sequence[PerformerData]) -> PerformerData:
    if not performers:
        raise ValueRangeError("at least one performer's data must be given, got none.")
    first = performers[0]
    for other in performers[1:]:
        if not (np.array_equal(other.faces, first.faces) and np.array_equal(other.vertex_ids, first.vertex_ids)):
            raise ValueRangeError(
                f"performers must be registered to one mesh, got {first.n_vertices} vertices of {first.name} and "
                f"{other.n_vertices} of {other.name} with other triangles: import both with the same template and "
                "version."
            )
    if len({one.name for one in performers}) != len(performers):
        raise ValueRangeError(f"performers must have different names, got {', '.join(one.name for one in performers)}.")
    return first


def _training_clips(performers: Sequence[PerformerData], options: TrainOptions) -> dict[str, list[str]]:
    """Return the clips of each performer to train with; a clip that nobody has is a mistake."""
    known = {clip for one in performers for clip in one.clip_names}
    for clip in (*options.clips, *options.left_out):
        if clip not in known:
            raise ValueRangeError(f"clip must be one of {', '.join(sorted(known))}, got {clip!r}.")
    wanted = set(options.clips) or known
    chosen = {
        one.name: [clip for clip in one.clip_names if clip in wanted and clip not in options.left_out]
        for one in performers
    }
    if not any(chosen.values()):
        raise ValueRangeError("at least one clip must be left to train with, got none.")
    return chosen


def _only(performers: Sequence[PerformerData], names: Mapping[str, Sequence[str]]) -> list[PerformerData]:
    """Return performers with only the clips named."""
    from dataclasses import replace

    return [
        replace(one, clips=tuple(one.clip(name) for name in names[one.name])) for one in performers if names[one.name]
    ]


def _frames(performer: PerformerData, names: Sequence[str], rate: float | None) -> NDArray[np.float32]:
    """Return displacements (T, N, 3), mm, of clips, at no more than `rate` frames a second."""
    if rate is not None and not rate > 0:
        raise ValueRangeError(f"frames_per_second must be positive, got {rate}.")
    kept = [np.empty((0, performer.n_vertices, 3), np.float32)]
    for name in names:
        clip = performer.clip(name)
        if rate is None:
            kept.append(clip.vertices)
        elif clip.n_frames:
            slot = np.floor((clip.times - clip.times[0]) * rate + _ROUNDING)
            kept.append(clip.vertices[np.r_[True, np.diff(slot) > 0]])
    return np.concatenate(kept) - performer.neutral


def _learn(
    performers: Sequence[PerformerData], regions: Regions, frames: NDArray[np.float32], options: TrainOptions
) -> RegionModel:
    from facewright.models.region_pca import fit_region_pca, region_basis

    first = performers[0]
    by_name = {one.name: one for one in performers}
    if options.neutral is not None and options.neutral not in by_name:
        raise ValueRangeError(f"neutral must be one of {', '.join(by_name)}, got {options.neutral!r}.")
    neutral = by_name[options.neutral or first.name].neutral
    provenance: dict[str, Any] = {
        "template": first.template,
        "vertex_ids": first.vertex_ids.tolist(),
        "performers": list(by_name),
        "neutral": options.neutral or first.name,
        "mirror": None if first.mirror is None else first.mirror.tolist(),
    }
    if options.basis == "blendshapes":
        from dataclasses import replace

        rig = _template_rig(first)
        model = region_basis(rig, regions, first.faces, provenance=provenance)
        return replace(model, neutral=neutral.astype(np.float64))
    if options.basis != "pca":
        raise ValueRangeError(f"basis must be one of {', '.join(BASES)}, got {options.basis!r}.")
    return fit_region_pca(
        frames, first.faces, neutral, regions, options.components, centred=options.centred, provenance=provenance
    )


def _template_rig(performer: PerformerData) -> Any:
    """Return the template's generic blendshapes at the mesh's vertices."""
    from facewright.errors import MissingFaceError
    from facewright.faces.load import load_face
    from facewright.models.blendshapes import BlendshapeRig

    try:
        face = load_face(performer.template)
    except MissingFaceError as error:
        raise TopologyError(
            f"blendshapes need data fitted to a face that is installed, got a mesh of {performer.template!r}."
        ) from error
    ids = performer.vertex_ids
    return BlendshapeRig(face.mean_shape[ids], face.blendshape_names, face.blendshape_deltas[:, ids])


def _measure(
    model: RegionModel, frames: Mapping[str, NDArray[np.float32]], beta: float, report: Progress
) -> dict[str, float]:
    """Return eq. 13 for each performer."""
    from facewright.models.region_fit import RegionFitter, reconstruction_rms

    fitter = RegionFitter(model, beta)
    result = {}
    for done, (name, moves) in enumerate(frames.items()):
        report("measuring", done, len(frames))
        if len(moves):
            result[name] = reconstruction_rms(moves, fitter.reconstruct(fitter.fit(moves)))
    if frames:
        report("measuring", len(frames), len(frames))
    return result


def _remarks(model: RegionModel, options: TrainOptions) -> tuple[str, ...]:
    if options.basis != "pca" or isinstance(options.components, float):
        return ()
    fewer = [
        f"{name} ({len(basis)})"
        for name, basis in zip(model.regions.names, model.bases, strict=True)
        if len(basis) < options.components
    ]
    if not fewer:
        return ()
    return (f"the data have fewer than {options.components} components in {', '.join(fewer)}.",)
