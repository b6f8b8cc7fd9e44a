"""Suite `scan`: the template on fused depth of simulated people, at rest and in 19 expressions, beside the truth."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from facewright.apps.simulated_recording import (
    SimulatedCaptureSubject,
    simulate_capture_subject,
    simulate_recording,
)
from facewright.capture.fused_depth import FusedDepth
from facewright.errors import MissingExtraError, NoFaceError, ValueRangeError
from facewright.faces.expressions import EXPRESSION_WEIGHTS, expression_weights
from facewright.faces.face import Face
from facewright.fitting.depth_target import depth_target
from facewright.fitting.scan import ScanFit, ScanFitOptions, ScanFitter
from facewright.landmarks.contour import face_region
from facewright.landmarks.detector import LandmarkDetector, open_detector
from facewright.landmarks.points import Landmarks
from facewright.mesh.closest_point import ClosestPoints
from facewright.numeric.similarity import estimate_similarity

Progress = Callable[[str, int, int], None]

N_FRAMES = 24
NOISE_PX = 1.0
"""Error of a landmark that a careful person has placed, each coordinate."""
SEALED_MM = 1.0
"""Lips are sealed in truth where a pair's offset is this near to that at rest; lids where it is this short."""
OPEN_MM = 4.0


@dataclass(frozen=True, eq=False)
class FusedExpression:
    """One fused recording and what is known of it.

    Parameters
    ----------
    fused : FusedDepth
        What is fitted.
    truth : ndarray of shape (V, 3), millimetres
        The skin in the camera's frame at the reference frame.
    guide : ndarray of shape (46,)
        What the person was asked for.
    detected : Landmarks or None
        By the detector, on the reference picture.
    refined : Landmarks
        The true ones with `NOISE_PX` of noise.
    """

    fused: FusedDepth
    truth: NDArray[np.float64]
    guide: NDArray[np.float64]
    detected: Landmarks | None
    refined: Landmarks


def record_expressions(
    subject: SimulatedCaptureSubject,
    rng: np.random.Generator,
    detector: LandmarkDetector | None,
    *,
    n_frames: int = N_FRAMES,
    expressions: NDArray[np.float64] | None = None,
) -> Iterator[FusedExpression]:
    """Let a subject act expressions (N, 46), the neutral first, before a simulated Kinect; yield them fused.

    Without `expressions` they are the 20 of FaceWarehouse. Without a detector the reference is the frame in the middle
    of the turn.
    """
    from facewright.capture.fusion import fuse

    n = subject.face.n_skin
    for guide in np.asarray(EXPRESSION_WEIGHTS) if expressions is None else expressions:
        recording = simulate_recording(subject, guide, rng, n_frames=n_frames)
        fused = fuse(recording.frames(), detector=detector)
        found = detector.detect(fused.color) if detector is not None else []
        true = recording.true_landmarks(fused.reference)
        yield FusedExpression(
            fused,
            recording.camera_from_model[fused.reference].apply(recording.vertices[:n].astype(np.float64)),
            guide,
            found[0].convert("fw74") if found else None,
            Landmarks("fw74", true.points + rng.normal(0.0, NOISE_PX, true.points.shape)),
        )


def run(face: Face, seed: int, progress: Progress | None = None, *, subjects: int = 3) -> dict[str, float]:
    """Measure scan fitting on simulated people, who lie outside what stage 1 can reach.

    Each person (all identity modes plus a random field, personal blendshapes, hair, sometimes glasses) records 20
    imperfectly acted expressions of 24 frames before a simulated Kinect; the recordings are fused. Stage 1 knows the
    leading 50 identity modes. Distances are root mean squares over the face in front of the jaw line
    (`facewright.landmarks.contour.face_region`), in the camera's frame, without any alignment to the truth; of several
    people or expressions, the mean. The throat is left out: it bends with the neck and so has no place in the frame of
    the head.

    Parameters
    ----------
    face : Face
        All parts of it.
    seed : int
        Seed of people, recordings and noise.
    progress : callable, optional
        Called as progress("fitting scans", done, total).
    subjects : int
        People.

    Returns
    -------
    dict of str to float
        ``neutral_stage1_to_depth_rms_mm``, ``neutral_stage2_to_depth_rms_mm``: matched vertices to the fused surface;
        ``neutral_surface_rms_mm``, ``neutral_stage1_surface_rms_mm``: to the true surface;
        ``neutral_with_throat_surface_rms_mm``: over the mask ``face_region``, which reaches down the throat;
        ``neutral_correspondence_rms_mm``: between corresponding vertices; ``mean_face_surface_rms_mm``,
        ``mean_face_correspondence_rms_mm``: of the mean face, moved rigidly as best fits the truth;
        ``expressions_surface_rms_mm``, ``expressions_correspondence_rms_mm``: of the 20 expressions, the neutral among
        them; ``mouth_stretch_surface_rms_mm``: of the largest motion, which landmarks help most (Fig. 3);
        ``guides_surface_rms_mm``: of the guides carried to the fitted neutral, without stage 1 and 2;
        ``lip_gap_mm``, ``lid_gap_mm``: mean change of the offset of touching vertices against the truth, where the
        truth is sealed; ``open_lip_error_mm``, ``open_lid_error_mm``: the same where it is open;
        ``expression_seconds``: median time of a fit; ``failed_fits``. Landmarks are the detector's, with
        ``detection_rate``; the same with ``refined_`` for true landmarks with 1 px of noise, as the paper refines them
        by hand (without a detector, only these); with ``without_landmarks_`` for fits by the surface alone, landmarks
        giving the first pose only (Fig. 3).

    Raises
    ------
    ValueRangeError
        If `subjects` is not positive.
    """
    if subjects < 1:
        raise ValueRangeError(f"subjects must be positive, got {subjects}.")
    detector = _detector()
    fitter, blind = ScanFitter(face), ScanFitter(face, ScanFitOptions(use_landmarks=False))
    ways = {"refined_": _Way(fitter), "without_landmarks_": _Way(blind)}
    if detector is not None:
        ways = {"": _Way(fitter), **ways}
    seen, total = 0, subjects * len(EXPRESSION_WEIGHTS)
    for k in range(subjects):
        rng = np.random.default_rng((seed, k))
        subject = simulate_capture_subject(face, rng)
        for number, expression in enumerate(record_expressions(subject, rng, detector)):
            seen += expression.detected is not None
            for prefix, way in ways.items():
                refined = prefix == "refined_" or detector is None
                way.add(expression, expression.refined if refined else expression.detected, at_rest=number == 0)
            if progress is not None:
                progress("fitting scans", k * len(EXPRESSION_WEIGHTS) + number + 1, total)
    metrics = {prefix + key: value for prefix, way in ways.items() for key, value in way.metrics().items()}
    if detector is not None:
        metrics["detection_rate"] = seen / total
    return metrics


@dataclass(eq=False)
class _Way:
    """One way to fit, and what is measured of its fits."""

    fitter: ScanFitter
    values: dict[str, list[float]] = field(default_factory=dict)
    neutral: ScanFit | None = None
    failed: int = 0

    def add(self, expression: FusedExpression, landmarks: Landmarks | None, *, at_rest: bool) -> None:
        """Fit and measure; without landmarks, or where the fit refuses, the failure is counted."""
        from time import perf_counter

        if at_rest:
            self.neutral = None
        try:
            if landmarks is None:
                raise NoFaceError("no landmarks were found.")
            target = depth_target(expression.fused.depth, expression.fused.intrinsics, landmarks)
            start = perf_counter()
            if at_rest:
                fit = self.neutral = self.fitter.fit_neutral(target)
            elif self.neutral is None:
                raise NoFaceError("the subject has no neutral.")
            else:
                fit = self.fitter.fit_expression(self.neutral, expression.guide, target)
                self._note("expression_seconds", perf_counter() - start)
        except NoFaceError:
            self.failed += 1
            return
        self._measure(fit, expression, at_rest)

    def _measure(self, fit: ScanFit, expression: FusedExpression, at_rest: bool) -> None:
        skin = self.fitter.face
        region = face_region(skin.topology, skin.mean_shape)
        truth, posed = expression.truth, fit.posed
        surface = ClosestPoints(truth, skin.topology.faces)

        def distance(vertices: NDArray[np.float64], where: NDArray[np.int32] = region) -> float:
            return _rms(surface.query(vertices[where]).distances)

        reached = distance(posed)
        apart = _rms(np.linalg.norm(posed[region] - truth[region], axis=1))
        self._note("expressions_surface_rms_mm", reached)
        self._note("expressions_correspondence_rms_mm", apart)
        if at_rest:
            self._note("neutral_stage1_to_depth_rms_mm", float(fit.report["stage1_rms_mm"]))
            self._note("neutral_stage2_to_depth_rms_mm", float(fit.report["stage2_rms_mm"]))
            self._note("neutral_surface_rms_mm", reached)
            throat = skin.topology.masks.get("face_region", region)
            self._note("neutral_with_throat_surface_rms_mm", distance(posed, throat))
            self._note("neutral_stage1_surface_rms_mm", distance(fit.target_from_model.apply(fit.stage1_vertices)))
            self._note("neutral_correspondence_rms_mm", apart)
            mean = skin.mean_shape.astype(np.float64)
            placed = estimate_similarity(mean[region], truth[region], with_scale=False).apply(mean)
            self._note("mean_face_surface_rms_mm", distance(placed))
            self._note("mean_face_correspondence_rms_mm", _rms(np.linalg.norm(placed - truth, axis=1)[region]))
        else:
            assert self.neutral is not None
            guide = self.fitter.transferred_guide(self.neutral, expression.guide)
            self._note("guides_surface_rms_mm", distance(fit.target_from_model.apply(guide)))
            if np.array_equal(expression.guide, expression_weights("mouth_stretch")):
                self._note("mouth_stretch_surface_rms_mm", reached)
        self._measure_contact(posed, truth)

    def _measure_contact(self, posed: NDArray[np.float64], truth: NDArray[np.float64]) -> None:
        mean = self.fitter.face.mean_shape.astype(np.float64)
        for part, (upper, lower) in self.fitter.contacts.pairs.items():
            true = truth[upper] - truth[lower]
            gap = np.linalg.norm(true, axis=1)
            error = np.linalg.norm(posed[upper] - posed[lower] - true, axis=1)
            rest = np.linalg.norm(mean[upper] - mean[lower], axis=1) if part == "lips" else 0.0
            kind = "lip" if part == "lips" else "lid"
            for name, chosen in ((f"{kind}_gap_mm", gap - rest < SEALED_MM), (f"open_{kind}_error_mm", gap > OPEN_MM)):
                if chosen.any():
                    self._note(name, float(error[chosen].mean()))

    def _note(self, name: str, value: float) -> None:
        self.values.setdefault(name, []).append(value)

    def metrics(self) -> dict[str, float]:
        """Return the means, the median time and the number of failures."""
        order = sorted(self.values, key=lambda name: not name.startswith("neutral"))
        result = {name: float(np.mean(self.values[name])) for name in order}
        if "expression_seconds" in result:
            result["expression_seconds"] = float(np.median(self.values["expression_seconds"]))
        return result | {"failed_fits": float(self.failed)}


def _rms(values: NDArray[np.float64]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _detector() -> LandmarkDetector | None:
    try:
        return open_detector(max_faces=1)
    except MissingExtraError:
        return None
