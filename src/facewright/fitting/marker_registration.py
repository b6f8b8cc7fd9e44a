"""A performer's motion capture to clips of one coarse mesh: placed once, every frame registered, head motion apart."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from facewright.errors import DegenerateError, ValueRangeError
from facewright.faces.face import Face
from facewright.fitting.marker_motion import MarkerMotion, MarkerRegistration, MotionPrior
from facewright.fitting.marker_placement import LEAST_MARKERS, find_up, place_markers
from facewright.fitting.marker_template import marker_template
from facewright.io.marker_data import MarkerData
from facewright.io.marker_units import turned_up
from facewright.models.performer_data import PerformerClip, PerformerData
from facewright.models.procrustes import RigidMotions, rigid_motions
from facewright.numeric.similarity import estimate_similarity

Array = NDArray[np.float64]
Progress = Callable[[str, int, int], None]

_NEUTRAL_WORDS = ("neutral", "rest")
_REST_S = 0.1  # frames about the one at rest that are averaged
#: A clip with more frames than this that show no face is refused; clean recordings have none.
_STRAY_FRAMES = 0.1


@dataclass(frozen=True)
class RegistrationSettings:
    """How markers are registered.

    Parameters
    ----------
    n_vertices : int
        Of the coarse mesh.
    neutral : str, optional
        ``CLIP`` or ``CLIP:FRAME`` at rest; a clip called neutral or rest, else the first frame of the first clip, where
        absent. Of a clip without a frame the median of all frames is taken.
    standoff_mm : float
        Height of the markers' centres above the skin: their radius.
    gap_limit_s : float
        Longest gap that is interpolated.
    frames_per_second : float, optional
        Frames to keep, after all have been used to fill gaps; all where absent.
    up : str, optional
        Axis that points up in the recordings; found from the markers where absent.
    prior : MotionPrior
        How faces are thought to move.
    """

    n_vertices: int = 397
    neutral: str | None = None
    standoff_mm: float = 1.5
    gap_limit_s: float = 0.5
    frames_per_second: float | None = None
    up: str | None = "y"
    prior: MotionPrior = field(default_factory=MotionPrior)

    def __post_init__(self) -> None:
        if not 0 <= self.standoff_mm <= 20:
            raise ValueRangeError(f"standoff_mm must lie in [0, 20], got {self.standoff_mm}.")
        if not self.gap_limit_s >= 0:
            raise ValueRangeError(f"gap_limit_s must not be negative, got {self.gap_limit_s}.")
        if self.frames_per_second is not None and not self.frames_per_second > 0:
            raise ValueRangeError(f"frames_per_second must be positive, got {self.frames_per_second}.")


@dataclass(frozen=True, eq=False)
class RegisteredPerformer:
    """A performer's data, and what pictures need.

    Parameters
    ----------
    data : PerformerData
    registration : MarkerRegistration
        The placement and the linear map.
    reference_from_head : RigidMotions
        One motion, from the frame of the placement to that of the data.
    markers : mapping of str to ndarray of shape (T, M, 3), millimetres
        Mended markers of the kept frames in the placement's frame.
    """

    data: PerformerData
    registration: MarkerRegistration
    reference_from_head: RigidMotions
    markers: Mapping[str, Array]


def register_performer(
    clips: Mapping[str, MarkerData],
    face: Face,
    *,
    name: str = "performer",
    settings: RegistrationSettings | None = None,
    progress: Progress | None = None,
) -> RegisteredPerformer:
    """Register all clips of one performer.

    Parameters
    ----------
    clips : mapping of str to MarkerData
        Millimetres; markers bear the same labels in all of them.
    face : Face
        The generic template.
    name : str
        Of the performer.
    settings : RegistrationSettings, optional
    progress : callable, optional
        Called as progress("registering clips", done, total).

    Raises
    ------
    ValueRangeError
        If there is no clip, the neutral is not one of them, a clip has no frame with half its markers, or markers are
        where no face would have them in more than a tenth of its frames: labels of others.
    DegenerateError
        If too few markers are seen at rest or no face can be found in them.
    """
    settings = settings or RegistrationSettings()
    if not clips:
        raise ValueRangeError("clips must hold at least one clip, got none.")
    template = marker_template(face, settings.n_vertices)
    labels, rest, told = _rest(clips, settings.neutral)
    up = settings.up if settings.up is not None else find_up(template, rest)
    placement = place_markers(template, turned_up(rest, up), settings.standoff_mm)
    registration = MarkerRegistration(template, placement, standoff_mm=settings.standoff_mm, prior=settings.prior)
    to_reference = estimate_similarity(registration.neutral, template.coarse.positions, with_scale=False)
    home = RigidMotions(to_reference.rotation[None], to_reference.translation[None])
    done, markers, notes, partners = [], {}, {}, []
    for number, (clip_name, clip) in enumerate(clips.items()):
        registered, mended, note, partner = _register_clip(registration, clip_name, clip, labels, up, home, settings)
        done.append(registered)
        partners.append(partner)
        markers[clip_name], notes[clip_name] = mended, note
        if progress is not None:
            progress("registering clips", number + 1, len(clips))
    usual = _usual_labels(partners)
    for note, partner in zip(notes.values(), partners):
        note["relabelled"] = int(((partner != usual) & (partner >= 0)).sum())
    data = PerformerData(
        name=name,
        faces=template.coarse.faces,
        neutral=home.apply(registration.neutral[None])[0].astype(np.float32),
        reference=template.coarse.positions,
        clips=tuple(done),
        template=template.coarse.template,
        vertex_ids=template.coarse.vertex_ids,
        mirror=template.coarse.mirror,
        statistics={
            "neutral": told,
            "markers": len(labels),
            "relabelled_at_rest": int((usual != np.arange(len(labels))).sum()),
            "up": up,
            "size": round(placement.scale, 4),
            "model_rms_mm": round(placement.model_rms_mm, 4),
            "standoff_mm": settings.standoff_mm,
            "gap_limit_s": settings.gap_limit_s,
            "clips": notes,
        },
    )
    return RegisteredPerformer(data, registration, home, markers)


def _rest(clips: Mapping[str, MarkerData], neutral: str | None) -> tuple[tuple[str, ...], Array, str]:
    """Return labels and positions (M, 3) of the markers seen at rest, and which frames these were."""
    clip_name, frame = _neutral_frame(clips, neutral)
    clip = clips[clip_name]
    positions, middle = clip.positions, 0 if frame is None else frame
    if frame is not None:
        near = np.abs(clip.times - clip.times[frame]) <= _REST_S
        positions, middle = positions[near], int(np.flatnonzero(np.flatnonzero(near) == frame)[0])
    whole = clip.seen.any(axis=0) if frame is None else ~np.isnan(positions).any(axis=2).all(axis=0)
    if frame is None:  # the frame that shows most
        middle = int(clip.seen.sum(axis=1).argmax())
    base = positions[middle]
    here = ~np.isnan(base).any(axis=1)
    if here.sum() < LEAST_MARKERS:
        raise DegenerateError(
            f"the frame at rest must show at least {LEAST_MARKERS} markers, got {int(here.sum())} in {clip_name}."
        )
    seen = ~np.isnan(positions).any(axis=2)
    enough = (seen & here).sum(axis=1) >= max(3, LEAST_MARKERS // 2)
    still = rigid_motions(positions[enough], np.where(here[:, None], base, 0.0), (seen & here)[enough])
    with np.errstate(all="ignore"):
        rest = np.nanmedian(np.where(seen[enough][..., None], still.apply(positions[enough]), np.nan), axis=0)
    kept = whole & ~np.isnan(rest).any(axis=1)
    told = clip_name if frame is None else f"{clip_name}:{frame}"
    return tuple(label for label, there in zip(clip.labels, kept) if there), rest[kept], told


def _neutral_frame(clips: Mapping[str, MarkerData], neutral: str | None) -> tuple[str, int | None]:
    if neutral is None:
        named = [name for name in clips if any(word in name.lower() for word in _NEUTRAL_WORDS)]
        return (named[0], None) if named else (next(iter(clips)), 0)
    clip_name, colon, number = neutral.rpartition(":")
    if not colon or neutral in clips:
        clip_name, number = neutral, ""
    if clip_name not in clips:
        raise ValueRangeError(f"neutral must name a clip, one of {', '.join(clips)}, got {clip_name!r}.")
    if not number:
        return clip_name, None
    frames = len(clips[clip_name].times)
    if not number.isdigit() or int(number) >= frames:
        raise ValueRangeError(f"neutral must be a frame of {clip_name} from 0 to {frames - 1}, got {number!r}.")
    return clip_name, int(number)


def _register_clip(
    registration: MarkerRegistration,
    name: str,
    clip: MarkerData,
    labels: tuple[str, ...],
    up: str,
    home: RigidMotions,
    settings: RegistrationSettings,
) -> tuple[PerformerClip, Array, dict[str, Any], NDArray[np.intp]]:
    """Return the clip, its mended markers in the placement's frame, what was done, and whose labels markers bore."""
    place = {label: k for k, label in enumerate(clip.labels)}
    positions = np.full((len(clip.times), len(labels), 3), np.nan)
    known = [k for k, label in enumerate(labels) if label in place]
    positions[:, known] = turned_up(clip.positions[:, [place[labels[k]] for k in known]], up)
    usable = 2 * (~np.isnan(positions).any(axis=2)).sum(axis=1) >= len(labels)
    if not usable.any():
        raise ValueRangeError(
            f"clip {name} must show at least half of the {len(labels)} markers that are seen at rest, "
            f"got {len(known)} of their labels; are the labels those of the same performer?"
        )
    times = clip.times[usable]
    motion: MarkerMotion = registration.register(positions[usable], times, gap_limit_s=settings.gap_limit_s)
    believed = np.flatnonzero(_plausible(name, motion))
    keep = believed[_kept(times[believed], settings.frames_per_second)]
    back = home.inverse()
    n = len(keep)
    recorded = RigidMotions(motion.recorded_from_head.rotations[keep], motion.recorded_from_head.translations[keep])
    head = recorded.compose(RigidMotions(np.repeat(back.rotations, n, 0), np.repeat(back.translations, n, 0)))
    registered = PerformerClip(
        name,
        times[keep],
        home.apply(motion.vertices[keep]).astype(np.float32),
        head.rotations,
        head.translations,
    )
    notes = {
        "frames": len(clip.times),
        "frames_left_out": int((~usable).sum()),
        "frames_implausible": len(times) - len(believed),
        "labels_missing": [labels[k] for k in range(len(labels)) if labels[k] not in place],
        "labels_unknown": [label for label in clip.labels if label not in labels],
        "out_of_place": motion.n_left_out,
        "labels_out_of_place": _mostly_out_of_place(motion, positions[usable], labels),
        "filled": motion.n_filled,
        "beyond_limit": motion.n_beyond,
        "longest_gap_s": round(motion.longest_gap_s, 4),
        "residual_mm": round(motion.residual_mm, 4),
    }
    return registered, motion.markers[keep], notes, motion.partner


def _plausible(name: str, motion: MarkerMotion) -> NDArray[np.bool_]:
    """Return the frames (T,) whose markers lie on a face; refuse a clip that has too few."""
    stray = motion.n_stray > 0
    if stray.mean() > _STRAY_FRAMES:
        left_out = (motion.partner[stray] < 0).sum(axis=1)
        raise ValueRangeError(
            f"clip {name} must show its markers where a face has those of the frame at rest, got "
            f"{int(np.median(left_out + motion.n_stray[stray]))} of {motion.partner.shape[1]} out of place, by "
            f"{motion.stray_mm:.0f} mm, in {int(stray.sum())} of {len(stray)} frames (medians); are they labelled "
            "otherwise? Label the clip again or leave it out."
        )
    return ~stray


def _mostly_out_of_place(motion: MarkerMotion, positions: Array, labels: tuple[str, ...]) -> list[str]:
    """Return the labels that were left out in most frames that show them."""
    seen = ~np.isnan(positions).any(axis=2)
    left_out = seen & (motion.partner < 0)
    return [labels[k] for k in np.flatnonzero(2 * left_out.sum(axis=0) > np.maximum(seen.sum(axis=0), 1))]


def _usual_labels(partners: list[NDArray[np.intp]]) -> NDArray[np.intp]:
    """Return the label (M,) that each marker bears in most frames: another one where the frame at rest had a swap."""
    M = partners[0].shape[1]
    count = np.zeros((M, M + 1), dtype=np.int64)
    for partner in partners:
        np.add.at(count, (np.broadcast_to(np.arange(M), partner.shape), partner), 1)
    count = count[:, :M]  # -1 went to the last column
    count[np.arange(M), np.arange(M)] += 1
    return count.argmax(axis=1)


def _kept(times: Array, rate: float | None) -> NDArray[np.intp]:
    """Return the frames nearest to an even rate, or all."""
    if rate is None or len(times) < 2:
        return np.arange(len(times))
    wanted = np.arange(times[0], times[-1] + 1e-9, 1.0 / rate)
    return np.unique(np.abs(np.searchsorted(0.5 * (times[1:] + times[:-1]), wanted)))
