"""The retarget suite: rendered clips of unseen people whose every coefficient is known, tracked from their pictures."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from facewright.errors import ValueRangeError
from facewright.evaluation.bilinear_transfer import bilinear_expression, transfer_errors
from facewright.evaluation.performance_error import (
    SHAPE_GROUPS,
    coefficient_errors,
    head_jitter,
    jitter,
    lip_gaps,
    point_distances,
    pose_degrees,
)
from facewright.evaluation.retarget_speed import retarget_speed
from facewright.evaluation.simulated_video import FRAMES_PER_SECOND, IMAGE_SIZE, SimulatedVideo, simulate_video
from facewright.evaluation.smaller_models import Tracker, smaller_trackers
from facewright.faces.face import Face
from facewright.faces.simulate import SimulatedPerson, simulate_person, simulate_population
from facewright.fitting.video import VideoFit, VideoFitter
from facewright.landmarks.contour import face_region
from facewright.landmarks.face_crops import FaceCrops, cut_face
from facewright.landmarks.scheme import load_scheme
from facewright.landmarks.track import LandmarkTrack
from facewright.landmarks.video_detector import VideoDetector
from facewright.models.bilinear import BilinearModel, fit_bilinear
from facewright.numeric.similarity import estimate_similarity

Progress = Callable[[str, int, int], None]

N_PEOPLE, N_IDENTITY, N_EXPRESSION = 150, 50, 47
#: The lips are meant to meet where mouthClose takes back so much of an open jaw; an estimate does the same if it leaves
#: them no more than this farther apart than the truth.
_MEANT, _CLOSED_MM = 0.8, 1.0
#: Every so many frames are carried to another person.
_TRANSFER_STEP = 5
#: Where the fitted mesh is compared with the true one in the picture: groups of `fw74`.
_PLACES = {"lips": ("outer_mouth", "inner_mouth"), "contour": ("contour",)}


def run(
    face: Face,
    seed: int,
    progress: Progress | None = None,
    *,
    subjects: int = 3,
    seconds: float = 10.0,
    model: BilinearModel | None = None,
) -> dict[str, float]:
    """Measure tracking and retargeting.

    Parameters
    ----------
    face : Face
        With all its parts; the model is of its skin.
    seed : int
        Of the population, the unseen people, performances and noise.
    progress : callable, optional
        Called with stage, done, total.
    subjects : int
        Clips, each of another unseen person; every other one begins in the middle of an expression.
    seconds : float
        Length of the clips, 640 x 480 at 25 frames a second.
    model : BilinearModel, optional
        Built from 150 other simulated people, 50 x 47, where absent, and then those of Fig. 12 beside it.

    Returns
    -------
    dict of str to float
        What `coefficient_errors` says, with zero coefficients (``neutral_``) beside; ``recall_lips_closed``, the share
        of frames with the jaw open and the lips brought together whose estimate, on the estimated person, brings them
        as near or at most 1 mm less, and ``precision_lips_closed``; ``pose_deg``; ``jitter_rest`` and
        ``jitter_motion``, mean absolute second differences of the coefficients while head and face are still and while
        they move, and ``truth_jitter_motion`` (at rest truth has none); ``head_jitter_rest``, ``head_jitter_motion``,
        ``truth_head_jitter_motion``, degrees per frame squared;
        ``identity_drift_mm``, RMS between the neutrals found from the two halves of a clip, and ``identity_mm``, of the
        neutral to the person's own, both after the best similarity, with ``mean_face_identity_mm``; ``tracked``;
        ``landmark_residual_iod``, of the detector's points, and against the truth ``lips_iod`` and ``contour_iod``, the
        distance in the picture between the fitted and the true mesh's points; the same with ``_15x47`` and ``_150x10``,
        and ``mean_correlation`` over the shape groups with each (Fig. 12); ``blendshape_transfer_mm``,
        ``bilinear_transfer_mm`` and ``neutral_transfer_mm`` (Fig. 14): RMS error of another person's motion driven by
        the coefficients, by w_exp, and not at all; ``detect_ms``, ``fit_ms`` of one core a frame and ``track_fps``; and
        what `retarget_speed` says of the first clip: ``fps``.
    """
    if subjects < 1:
        raise ValueRangeError(f"subjects must be at least 1, got {subjects}.")
    others: dict[str, Tracker] = {}
    if model is None:
        model, others = _build_models(face.skin(), seed, progress)
    fitter = VideoFitter(model)
    figures = _Figures(face, fitter, _Tracked(face, Tracker(fitter, np.eye(len(face.blendshape_names)))))
    smaller = {name: _Tracked(face, tracker) for name, tracker in others.items()}
    kept: list[NDArray[np.uint8]] = []
    for k in range(subjects):
        clip = simulate_video(face, np.random.default_rng((seed, 2, k)), seconds, rest_first=k % 2 == 0)
        track, crops, detect_s = _track(clip, kept if k == 0 else None, progress, f"drawing clip {k + 1} of {subjects}")
        other = simulate_person(face, np.random.default_rng((seed, 3, k)))
        figures.add(clip, track, crops, detect_s, other)
        for each in smaller.values():
            each.add(clip, each.tracker.fitter.fit(track, crops=crops))
    metrics = figures.metrics()
    for name, each in smaller.items():
        metrics |= {f"{key}_{name}": value for key, value in each.metrics().items()}
    return metrics | retarget_speed(np.array(kept), FRAMES_PER_SECOND, model, progress)


def _track(
    clip: SimulatedVideo, kept: list[NDArray[np.uint8]] | None, progress: Progress | None, stage: str
) -> tuple[LandmarkTrack, FaceCrops, float]:
    """Draw a clip and find its face; returns the detector's processor time too. Optionally keeps the pictures."""
    found, crops, seconds = [], [], 0.0
    with VideoDetector() as detector:
        for k, image in enumerate(clip.images()):
            start = time.process_time()
            face = detector.detect(image)
            crops.append(None if face.points is None else cut_face(image, face.points))
            seconds += time.process_time() - start
            found.append(face)
            if kept is not None:
                kept.append(image)
            if progress is not None:
                progress(stage, k + 1, clip.n_frames)
    track = LandmarkTrack.of(
        clip.performance.times, [each.points for each in found], IMAGE_SIZE, [each.cut for each in found]
    )
    return track, FaceCrops.of(crops), seconds


@dataclass
class _Tracked:
    """Coefficients and places found in the clips with one model, beside the truth."""

    face: Face
    tracker: Tracker
    found: list[NDArray[np.float64]] = field(default_factory=list)
    truth: list[NDArray[np.float64]] = field(default_factory=list)
    places: dict[str, list[NDArray[np.float64]]] = field(default_factory=dict)

    def add(self, clip: SimulatedVideo, fit: VideoFit) -> None:
        """Compare the fit of a clip with its truth."""
        self.found.append(self.tracker.coefficients(fit.performance.weights))
        self.truth.append(clip.performance.weights)
        scheme, ids = load_scheme("fw74"), np.asarray(self.face.topology.landmarks["fw74"])
        eyes = [ids[scheme.groups[name]] for name in ("right_eye", "left_eye")]
        for name, groups in _PLACES.items():
            chosen = np.concatenate([ids[scheme.groups[group]] for group in groups])
            self.places.setdefault(f"{name}_iod", []).append(
                point_distances(clip.person, clip.performance, clip.intrinsics, fit, chosen, eyes)
            )

    def errors(self) -> dict[str, float]:
        """Return what `coefficient_errors` says."""
        return coefficient_errors(np.concatenate(self.found), np.concatenate(self.truth), self.face.blendshape_names)

    def metrics(self) -> dict[str, float]:
        """Return the mean correlation over the groups of shapes, and the places' mean distances."""
        errors = self.errors()
        correlations = [value for name, value in errors.items() if name.startswith("correlation_")]
        means = {name: float(np.mean(np.concatenate(parts))) for name, parts in self.places.items()}
        return {"mean_correlation": float(np.mean(correlations)), "active_mae": errors["active_mae"]} | means


@dataclass
class _Figures:
    """What is measured on each clip."""

    face: Face
    fitter: VideoFitter
    whole: _Tracked
    frames: dict[str, list[NDArray[np.float64]]] = field(default_factory=dict)
    clips: dict[str, list[float]] = field(default_factory=dict)
    gaps: list[NDArray[np.float64]] = field(default_factory=list)

    def add(
        self, clip: SimulatedVideo, track: LandmarkTrack, crops: FaceCrops, detect_s: float, other: SimulatedPerson
    ) -> None:
        """Fit a clip and measure."""
        start = time.process_time()
        fit = self.fitter.fit(track, crops=crops)
        fit_s = time.process_time() - start
        ours, true = fit.performance, clip.performance
        self.whole.add(clip, fit)
        everywhere = np.ones(track.n_frames, bool)
        moving = ~clip.rest
        for name, values in {
            "pose_deg": pose_degrees(ours, true),
            "jitter_rest": jitter(ours.weights, clip.rest),
            "jitter_motion": jitter(ours.weights, moving),
            "truth_jitter_motion": jitter(true.weights, moving),
            "head_jitter_rest": head_jitter(ours.rotations, clip.rest),
            "head_jitter_motion": head_jitter(ours.rotations, moving),
            "truth_head_jitter_motion": head_jitter(true.rotations, moving),
            "landmark_residual_iod": fit.residuals_iod[track.tracked],
            "tracked": track.tracked[everywhere].astype(float),
            "detect_ms": np.full(track.n_frames, 1e3 * detect_s / track.n_frames),
            "fit_ms": np.full(track.n_frames, 1e3 * fit_s / track.n_frames),
        }.items():
            self.frames.setdefault(name, []).append(values)
        self._identity(clip, track, fit)
        self._lips(clip, fit)
        self._transfer(clip, track, fit, other)

    def _identity(self, clip: SimulatedVideo, track: LandmarkTrack, fit: VideoFit) -> None:
        model = self.fitter.model
        skin = self.face.skin()
        region = face_region(skin.topology, skin.mean_shape)
        half = track.n_frames // 2
        neutrals = [
            self.fitter.identity(track.part(part)).rig.neutral[region]
            for part in (slice(0, half), slice(half, track.n_frames))
        ]
        truth = clip.person.neutral[region]
        for name, (a, b) in {
            "identity_drift_mm": (neutrals[0], neutrals[1]),
            "identity_mm": (fit.identity.rig.neutral[region], truth),
            "mean_face_identity_mm": (model.mean_face[region], truth),
        }.items():
            moved = estimate_similarity(a.astype(np.float64), b.astype(np.float64)).apply(a.astype(np.float64))
            self.clips.setdefault(name, []).append(float(np.sqrt(((moved - b) ** 2).sum(axis=1).mean())))

    def _lips(self, clip: SimulatedVideo, fit: VideoFit) -> None:
        masks = self.fitter.model.topology.masks
        if "lip_contact_upper" not in masks:
            return
        upper, lower = masks["lip_contact_upper"], masks["lip_contact_lower"]
        ids = np.concatenate([upper, lower])
        pairs = np.arange(len(upper)), len(upper) + np.arange(len(lower))
        rig = fit.identity.rig
        ours = rig.neutral[ids] + np.tensordot(fit.performance.weights, rig.deltas[:, ids], 1)
        weights = clip.performance.weights
        true = clip.person.neutral[ids] + np.tensordot(weights, clip.person.deltas[:, ids], 1)
        jaw, close = (weights[:, clip.performance.names.index(name)] for name in ("jawOpen", "mouthClose"))
        meant = (jaw > 0.1) & (close >= _MEANT * jaw)
        self.gaps.append(np.stack([lip_gaps(ours, pairs), lip_gaps(true, pairs), jaw, meant], axis=1))

    def _transfer(self, clip: SimulatedVideo, track: LandmarkTrack, fit: VideoFit, other: SimulatedPerson) -> None:
        model = self.fitter.model
        skin = self.face.skin()
        n = model.n_vertices  # of the skin, or of all parts
        rows = np.flatnonzero(track.tracked)[::_TRANSFER_STEP]
        w_exp = np.array([bilinear_expression(self.fitter, track, fit, int(row)) for row in rows])
        w_id, _ = model.project(other.neutral[:n], noise_mm=0.5)
        truth = np.tensordot(clip.performance.weights[rows], other.deltas[:, :n], 1)
        region = face_region(skin.topology, skin.mean_shape)
        errors = transfer_errors(model, w_id, fit.performance.weights[rows], w_exp, truth, region)
        names = ("blendshape_transfer_mm", "bilinear_transfer_mm", "neutral_transfer_mm")
        for name, error in zip(names, errors, strict=True):
            self.clips.setdefault(name, []).append(error)

    def metrics(self) -> dict[str, float]:
        """Return the means over all frames and clips."""
        result = self.whole.errors() | self.whole.metrics()
        if self.gaps:
            ours, true, jaw, meant = np.concatenate(self.gaps).T
            sealed, claimed = meant > 0, (ours < 2.0 * _CLOSED_MM) & (jaw > 0.1)
            if sealed.any():
                result["recall_lips_closed"] = float((ours[sealed] < true[sealed] + _CLOSED_MM).mean())
            if claimed.any():
                result["precision_lips_closed"] = float((true[claimed] < 3.0 * _CLOSED_MM).mean())
        values = {name: np.concatenate(parts) for name, parts in self.frames.items()}
        result |= {name: float(np.mean(part)) for name, part in values.items() if len(part)}
        result |= {name: float(np.mean(part)) for name, part in self.clips.items()}
        result["track_fps"] = 1e3 / (result["detect_ms"] + result["fit_ms"])
        return result


def _build_models(skin: Face, seed: int, progress: Progress | None) -> tuple[BilinearModel, dict[str, Tracker]]:
    """Return the model of 150 people x 47 shapes and the smaller ones of Fig. 12."""
    tensor = simulate_population(skin, N_PEOPLE, np.random.default_rng((seed, 0)), progress)
    model = fit_bilinear(
        tensor,
        N_IDENTITY,
        N_EXPRESSION,
        topology=skin.topology,
        expression_names=("neutral", *skin.blendshape_names),
        provenance={"face": skin.name},
        progress=progress,
    )
    return model, smaller_trackers(skin, tensor, N_IDENTITY)


__all__ = ["SHAPE_GROUPS", "run"]
