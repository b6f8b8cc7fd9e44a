"""Fitting a video: one identity for the whole clip, FACS coefficients and head pose in every frame (4.4)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from facewright.camera.pinhole import Intrinsics
from facewright.errors import DegenerateError, ShapeError, ValueRangeError
from facewright.fitting.clip_gaze import clip_gaze, whole_face
from facewright.fitting.clip_person import (
    ClipPersonFitter,
    FrameState,
    KeyFrame,
    fit_frame,
    frame_quadratic,
    spread_frames,
    start_state,
)
from facewright.fitting.clip_rest import without_rest
from facewright.fitting.dense_model import N_POSE, ClipPerson, DenseModel
from facewright.fitting.energies.coefficient_terms import PICTURE_SHARES, CoefficientTerms
from facewright.fitting.energies.expression_prior import ExpressionPrior
from facewright.fitting.face_surface import FaceSurface, SurfacePoints
from facewright.fitting.image_term import ImageTerm
from facewright.fitting.lid_aperture import lid_closure, open_aperture
from facewright.fitting.lip_closure import lip_closure, lip_gap_row, with_lips_closed
from facewright.fitting.performance_smoothing import fill_gaps, smooth_coefficients, smooth_motion
from facewright.fitting.perspective_refinement import CameraPrior
from facewright.fitting.shot_image import SHOT_FRAMES, learn_shot
from facewright.landmarks.dense import DensePoints
from facewright.landmarks.face_crops import FaceCrops
from facewright.landmarks.points import interocular_distance
from facewright.landmarks.track import LandmarkTrack
from facewright.models.bilinear import BilinearModel
from facewright.models.blendshapes import BlendshapeRig
from facewright.models.performance import Performance

Progress = Callable[[str, int, int], None]

#: Frames among which key frames are chosen.
_CANDIDATES = 160
#: Frames that are smoothed together, and how many at each end are only looked at.
_CHUNK, _MARGIN = 750, 50
#: Steps of each frame by points and picture before the last.
_PICTURE_STEPS = 1


@dataclass(frozen=True)
class VideoFitOptions:
    """How a video is fitted.

    Parameters
    ----------
    key_frames : int
        Frames from which the identity is found.
    focal_length : float or None
        Focal length in pixels where it is known; guessed from the picture's size, and refined, otherwise.
    expression_spread, expression_sparsity : float
        Prior of the FACS coefficients, see `ExpressionPrior`.
    picture_sparsity : float
        Sparsity instead where pictures are seen, which tell more.
    smoothness : float
        Strength of the smoothing over time; 0 leaves every frame on its own.
    rest_freedom : float
        How far the clip's own face at rest may differ from model and detector, see `DenseModel`.
    """

    key_frames: int = 20
    focal_length: float | None = None
    expression_spread: float = 0.35
    expression_sparsity: float = 4.0
    picture_sparsity: float = 16.0
    smoothness: float = 1.0
    rest_freedom: float = 1.0

    def __post_init__(self) -> None:
        if self.key_frames < 1:
            raise ValueRangeError(f"key_frames must be at least 1, got {self.key_frames}.")
        if not self.expression_spread > 0:
            raise ValueRangeError(f"expression_spread must be positive, got {self.expression_spread}.")
        if min(self.smoothness, self.expression_sparsity, self.picture_sparsity) < 0:
            raise ValueRangeError(
                f"smoothness, expression_sparsity and picture_sparsity must not be negative, got {self.smoothness}, "
                f"{self.expression_sparsity} and {self.picture_sparsity}."
            )
        if self.focal_length is not None and not (np.isfinite(self.focal_length) and self.focal_length > 0):
            raise ValueRangeError(f"focal_length must be positive, got {self.focal_length}.")


@dataclass(frozen=True, eq=False)
class ClipIdentity:
    """Who acts in a clip, and through which lens.

    Parameters
    ----------
    model : BilinearModel
        The model it was fitted with.
    identity_weights : ndarray of shape (I,)
        w_id, one for all frames.
    intrinsics : Intrinsics
        The camera.
    person : ClipPerson
        The same person at the detector's points.
    open_eyes : ndarray of shape (2,)
        Height of the open right and left eye as a share of its width, see `open_aperture`.
    """

    model: BilinearModel
    identity_weights: NDArray[np.float64]
    intrinsics: Intrinsics
    person: ClipPerson
    open_eyes: NDArray[np.float64]

    @property
    def rig(self) -> BlendshapeRig:
        """The person's neutral and FACS blendshapes: eq. (17)."""
        return self.model.blendshapes(self.identity_weights)


@dataclass(frozen=True, eq=False)
class VideoFit:
    """A face followed through a clip.

    Parameters
    ----------
    identity : ClipIdentity
        Who.
    performance : Performance
        What: absolute coefficients (all zero is the neutral), head motion, and gaze (zero where the model's face is not
        installed). Frames without a face hold the last expression for a moment and then ease to the neutral.
    residuals_iod : ndarray of shape (T,)
        Mean distance of the detected points from the fit's, as a share of the inter-ocular distance; NaN in frames
        without a face.
    """

    identity: ClipIdentity
    performance: Performance
    residuals_iod: NDArray[np.float64]


class VideoFitter:
    """Fits clips with one model; keeps what does not depend on the clip.

    Parameters
    ----------
    model : BilinearModel
        The model.
    options : VideoFitOptions, optional
        Defaults where absent.
    points : DensePoints, optional
        What the detector's points are on the model's mesh; looked up where absent.

    Raises
    ------
    TopologyError
        If it is not known what the detector's points are on the model's mesh.
    """

    def __init__(
        self, model: BilinearModel, options: VideoFitOptions | None = None, points: DensePoints | None = None
    ) -> None:
        self.model = model
        self.options = options or VideoFitOptions()
        self.dense = DenseModel(model, points, self.options.rest_freedom)
        prior = ExpressionPrior(self.options.expression_spread, self.options.expression_sparsity)
        self._terms = CoefficientTerms.of(self.dense.names, prior)
        with_pictures = replace(prior, sparsity=self.options.picture_sparsity)
        self._picture_terms = CoefficientTerms.of(self.dense.names, with_pictures, PICTURE_SHARES)
        self._skin: SurfacePoints | None = None

    def identity(self, track: LandmarkTrack) -> ClipIdentity:
        """Find who acts, from key frames of the whole clip that are unlike one another.

        Raises
        ------
        DegenerateError
            If no frame of the track has a face.
        """
        tracked = np.flatnonzero(track.tracked)
        if not len(tracked):
            raise DegenerateError("a face must be seen in at least one frame of the clip, got none.")
        rows = tracked[np.unique(np.linspace(0, len(tracked) - 1, _CANDIDATES).astype(int))]
        founds = np.array([self.dense.detected(track.points[row]) for row in rows])
        lens = self._lens(track.image_size)
        guess = Intrinsics.for_image(track.image_size, lens.focal_length)
        keys = spread_frames(self.dense, founds, self.options.key_frames, guess)
        opened = open_aperture(track.points[tracked])
        frames = [KeyFrame(founds[k], self._frame_terms(track, int(rows[k]), opened)) for k in keys]
        person, intrinsics, _ = ClipPersonFitter(self.dense, lens).fit(frames, track.image_size)
        return ClipIdentity(self.model, self.dense.identity_of(person), intrinsics, person, opened)

    def _frame_terms(
        self, track: LandmarkTrack, row: int, opened: NDArray[np.float64], pictures: bool = False
    ) -> CoefficientTerms:
        """Return what is known of a frame's coefficients besides its points and its picture."""
        terms = self._picture_terms if pictures else self._terms
        return terms.with_lids(lid_closure(track.points[row : row + 1], opened)[0])

    def fit(
        self,
        track: LandmarkTrack,
        identity: ClipIdentity | None = None,
        progress: Progress | None = None,
        crops: FaceCrops | None = None,
    ) -> VideoFit:
        """Follow the face through a clip.

        Parameters
        ----------
        track : LandmarkTrack
            The detector's points.
        identity : ClipIdentity, optional
            Who acts, where it is known from `identity`; found first where absent.
        progress : callable, optional
            Called with stage, done, total.
        crops : FaceCrops, optional
            The face's brightness in the same frames: what points do not tell is then read from the skin.

        Returns
        -------
        VideoFit
            Coefficients, poses and residuals of all frames.

        Raises
        ------
        DegenerateError
            If no frame of the track has a face.
        ShapeError
            If there are not as many crops as frames.
        """
        if crops is not None and crops.n_frames != track.n_frames:
            raise ShapeError(f"crops must be of {track.n_frames} frames, got {crops.n_frames}.")
        who = identity or self.identity(track)
        surface = None if crops is None else self._surface(who)
        T, B = track.n_frames, self.dense.n_shapes
        weights, residuals = np.zeros((T, B)), np.full(T, np.nan)
        rotations, translations = np.tile(np.eye(3), (T, 1, 1)), np.zeros((T, 3))
        learned: slice | None = None
        image: ImageTerm | None = None
        for shot, run in _runs(track):
            if crops is not None and surface is not None and shot is not learned:
                learned, image = shot, self._image(track, who, crops, surface, shot)
            for chunk, kept in _chunks(run):
                states, beta = self._fit_chunk(track, who, chunk, progress, image, crops)
                motion = smooth_motion([state.pose for state in states], track.times[chunk], self.options.smoothness)
                inner = slice(kept.start - chunk.start, kept.stop - chunk.start)
                weights[kept] = beta[inner]
                rotations[kept], translations[kept] = motion[0][inner], motion[1][inner]
                for row in range(kept.start, kept.stop):
                    residuals[row] = self._residual(track, who, row, states[row - chunk.start])
        weights[track.tracked] = without_rest(weights[track.tracked])
        weights[track.tracked] = self._with_lips(who, track.points[track.tracked], weights[track.tracked])
        performance = Performance(
            times=track.times,
            names=self.dense.names,
            weights=np.clip(weights, 0.0, 1.0),
            rotations=rotations,
            translations=translations,
            gaze=np.zeros((T, 2, 2)),
            tracked=track.tracked.copy(),
        )
        whole = whole_face(self.model, who.rig.neutral)
        if whole is not None:
            performance = replace(performance, gaze=clip_gaze(*whole, who.intrinsics, performance, track))
        return VideoFit(who, fill_gaps(performance), residuals)

    def _with_lips(
        self, who: ClipIdentity, points: NDArray[np.floating], weights: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return the coefficients with lips that touch where the detector's do."""
        masks = self.model.topology.masks
        if "lip_contact_upper" not in masks or "lip_contact_lower" not in masks:
            return weights
        row = lip_gap_row(who.rig, masks["lip_contact_upper"], masks["lip_contact_lower"])
        return with_lips_closed(weights, self.dense.names, lip_closure(points), row)

    def _surface(self, who: ClipIdentity) -> FaceSurface:
        """Return the skin of the person in the clip."""
        if self._skin is None:
            self._skin = SurfacePoints(self.model)
        return self._skin.of(who.rig)

    def _image(
        self, track: LandmarkTrack, who: ClipIdentity, crops: FaceCrops, surface: FaceSurface, shot: slice
    ) -> ImageTerm | None:
        """Learn what the skin looks like in a shot."""
        rows = shot.start + np.flatnonzero(track.tracked[shot] & (crops.steps[shot] > 0))
        rows = rows[np.unique(np.linspace(0, len(rows) - 1, SHOT_FRAMES).astype(int))] if len(rows) else rows
        frames = [
            KeyFrame(self.dense.detected(track.points[row]), self._frame_terms(track, row, who.open_eyes, True))
            for row in rows.tolist()
        ]
        seen = [crop for row in rows.tolist() if (crop := crops.at(row)) is not None]
        return learn_shot(self.dense, surface, frames, seen, who.person, who.intrinsics)

    def _fit_chunk(
        self,
        track: LandmarkTrack,
        who: ClipIdentity,
        chunk: slice,
        progress: Progress | None,
        image: ImageTerm | None,
        crops: FaceCrops | None,
    ) -> tuple[list[FrameState], NDArray[np.float64]]:
        """Fit each frame from where the one before ended, then smooth the coefficients over time."""
        B = self.dense.n_shapes
        n = chunk.stop - chunk.start
        hessians, slopes = np.empty((n, B, B)), np.empty((n, B))
        states: list[FrameState] = []
        for k in range(n):
            found = self.dense.detected(track.points[chunk.start + k])
            start = states[-1] if k else start_state(self.dense, found, who.person, who.intrinsics)
            terms = self._frame_terms(track, chunk.start + k, who.open_eyes, image is not None)
            state = fit_frame(self.dense, found, who.person, terms, start, 1 if k else 5)
            crop = None if crops is None else crops.at(chunk.start + k)
            extra = None if image is None or crop is None else partial(image.quadratic, crop)
            if extra is not None:
                state = fit_frame(self.dense, found, who.person, terms, state, _PICTURE_STEPS, extra)
            H, g = frame_quadratic(self.dense, found, who.person, terms, state, extra)
            hessians[k], slopes[k], state = _without_pose(H, g, state)
            states.append(state)
            if progress is not None:
                progress("fitting frames", chunk.start + k + 1, track.n_frames)
        beta = np.array([state.beta for state in states])
        if self.options.smoothness > 0:
            step = np.diff(track.times[chunk])
            beta = smooth_coefficients(hessians, slopes, beta, step, self.dense.names, self.options.smoothness)
        return [FrameState(state.pose, row) for state, row in zip(states, beta, strict=True)], beta

    def _residual(self, track: LandmarkTrack, who: ClipIdentity, row: int, state: FrameState) -> float:
        found = self.dense.detected(track.points[row])
        distance = np.linalg.norm(found - self.dense.predict(who.person, state.pose, state.beta), axis=1)
        return float(distance.mean()) / interocular_distance(track.points[row], "mediapipe478")

    def _lens(self, image_size: tuple[int, int]) -> CameraPrior:
        if self.options.focal_length is not None:
            return CameraPrior(self.options.focal_length, 0.02)
        return CameraPrior(Intrinsics.for_image(image_size).focal_x, 0.3)


def fit_video(model: BilinearModel, track: LandmarkTrack, options: VideoFitOptions | None = None) -> VideoFit:
    """Fit one clip; one line over `VideoFitter`."""
    return VideoFitter(model, options).fit(track)


def _without_pose(
    H: NDArray[np.float64], g: NDArray[np.float64], state: FrameState
) -> tuple[NDArray[np.float64], NDArray[np.float64], FrameState]:
    """Return the quadratic in beta alone (Hessian, slope at beta = 0), and the state at its minimum within bounds."""
    from facewright.fitting.perspective_refinement import bounded_step

    n = N_POSE
    solved = np.linalg.solve(H[:n, :n], np.column_stack([H[:n, n:], g[:n]]))
    S = H[n:, n:] - H[n:, :n] @ solved[:, :-1]
    slope = g[n:] - H[n:, :n] @ solved[:, -1] - S @ state.beta
    step, beta = bounded_step(H, g, n, state.beta, 0.0)
    return S, slope, FrameState(state.pose.moved(step), beta)


def _runs(track: LandmarkTrack) -> list[tuple[slice, slice]]:
    """Return the unbroken runs of tracked frames, each with its shot before it."""
    runs = []
    for shot in track.shots():
        edges = np.flatnonzero(np.diff(np.concatenate([[False], track.tracked[shot], [False]]).astype(int)))
        runs += [(shot, slice(shot.start + int(a), shot.start + int(b))) for a, b in edges.reshape(-1, 2)]
    return runs


def _chunks(run: slice) -> list[tuple[slice, slice]]:
    """Return pieces of a run: what is fitted, and what of it is kept."""
    pieces = []
    for start in range(run.start, run.stop, _CHUNK):
        stop = min(start + _CHUNK, run.stop)
        pieces.append((slice(max(start - _MARGIN, run.start), min(stop + _MARGIN, run.stop)), slice(start, stop)))
    return pieces
