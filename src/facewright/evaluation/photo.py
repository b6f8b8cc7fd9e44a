"""The photo suite: faces fitted to pictures of simulated people whom the model has not seen, and to one real photo."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from facewright.camera.rotation import rotation_angle
from facewright.errors import MissingExtraError, ValueRangeError
from facewright.evaluation.mesh_distance import MeshDistance, mesh_distance
from facewright.evaluation.simulated_photo import SimulatedPhoto, simulate_photo
from facewright.faces.face import Face
from facewright.fitting.image import PhotoFit, PhotoFitter
from facewright.landmarks.contour import face_region
from facewright.landmarks.detector import LandmarkDetector, open_detector
from facewright.landmarks.points import Landmarks, interocular_distance
from facewright.models.bilinear import BilinearModel

Progress = Callable[[str, int, int], None]

NOISE_PX = 1.0
N_PEOPLE, N_IDENTITY, N_EXPRESSION = 150, 50, 25
_TIMED_REPEATS = 5
#: What the fields of `MeshDistance` are called for the mean face.
_MEAN_FACE_METRICS = (
    "mean_face_mm",
    "mean_face_correspondence_mm",
    "similarity_mean_face_mm",
    "similarity_mean_face_correspondence_mm",
)


def run(
    face: Face,
    seed: int,
    progress: Progress | None = None,
    *,
    subjects: int = 20,
    model: BilinearModel | None = None,
) -> dict[str, float]:
    """Measure photo fitting.

    Parameters
    ----------
    face : Face
        With all its parts; the model is of its skin.
    seed : int
        Of the population, the unseen people, cameras and noise.
    progress : callable, optional
        Called with stage, done, total.
    subjects : int
        Pictures, each of another unseen person.
    model : BilinearModel, optional
        Of the face's skin; built from 150 other simulated people, 50 x 25, where absent.

    Returns
    -------
    dict of str to float
        ``surface_mm`` and ``correspondence_mm``: mean distance over the face's region (in front of the jaw line and
        ears, with the forehead) from the true surface and between corresponding vertices, after the best rigid motion;
        ``similarity_surface_mm``, ``similarity_correspondence_mm``: after the best similarity, which takes the size,
        unseen in one picture, from the truth; ``mean_face_mm`` (surface), ``mean_face_correspondence_mm``,
        ``similarity_mean_face_mm``, ``similarity_mean_face_correspondence_mm``: the same of the mean face at rest;
        ``reprojection_iod``: mean distance of the landmarks from the fit's by the inter-ocular distance (between the
        centres of the eye outlines, in the picture); ``head_degrees``: error of the head's rotation; ``fit_ms``: median
        time of a fit with its full mesh, without detector. The same with ``detected_`` for the detector's landmarks on
        the rendered pictures, with
        ``detection_rate`` and ``detected_landmarks_iod`` (the detector's own error), and ``astronaut_iod`` of
        scikit-image's portrait; these are left out where the detector is not installed.
    """
    if subjects < 1:
        raise ValueRangeError(f"subjects must be at least 1, got {subjects}.")
    skin = face.skin()
    model = model or _build_model(skin, seed, progress)
    fitter = PhotoFitter(model)
    detector = _detector()
    region = face_region(skin.topology, skin.mean_shape)
    given, found = _Figures(), _Figures()
    mean_face: list[MeshDistance] = []
    landmark_error: list[float] = []
    for k in range(subjects):
        rng = np.random.default_rng((seed, 1, k))
        photo = simulate_photo(face, rng)
        truth = photo.vertices[: skin.topology.n_vertices]
        mean_face.append(mesh_distance(model.mean_face, truth, skin.topology.faces, region))
        given.add(fitter, photo.noisy_landmarks(NOISE_PX, rng), photo, truth, region)
        if detector is not None:
            faces = detector.detect(render_photo(face, photo, rng))
            if faces:
                landmarks = faces[0].convert("fw74")
                landmark_error.append(_landmark_error(landmarks, photo.landmarks))
                found.add(fitter, landmarks, photo, truth, region)
        if progress is not None:
            progress("fitting photos", k + 1, subjects)
    metrics = given.metrics("")
    metrics |= dict(zip(_MEAN_FACE_METRICS, np.mean(mean_face, axis=0).tolist(), strict=True))
    if detector is not None:
        metrics["detection_rate"] = len(landmark_error) / subjects
        if landmark_error:
            metrics |= found.metrics("detected_")
            metrics["detected_landmarks_iod"] = float(np.mean(landmark_error))
        metrics["astronaut_iod"] = _astronaut_iod(fitter, detector)
    return metrics


def render_photo(face: Face, photo: SimulatedPhoto, rng: np.random.Generator) -> NDArray[np.uint8]:
    """Draw a simulated person with a made-up appearance, for a detector; (H, W, 3), uint8."""
    from facewright.faces.appearance import albedo_function, sample_appearance, visible_faces
    from facewright.imaging.render import Lights, render_mesh

    look = sample_appearance(rng)
    seen = photo.camera_from_model.apply(photo.vertices)
    faces = visible_faces(face)
    return render_mesh(
        seen,
        photo.intrinsics.project(seen),
        faces,
        photo.image_size,
        albedo=albedo_function(face, look, faces),
        lights=Lights(look.light_directions, look.light_colours, look.sky, look.ground),
        background=look.background,
    ).image


@dataclass
class _Figures:
    """What is measured on each fit."""

    distances: list[MeshDistance] = field(default_factory=list)
    iod: list[float] = field(default_factory=list)
    degrees: list[float] = field(default_factory=list)
    times: list[float] = field(default_factory=list)

    def add(
        self,
        fitter: PhotoFitter,
        landmarks: Landmarks,
        photo: SimulatedPhoto,
        truth: NDArray[np.floating],
        region: NDArray[np.int32],
    ) -> None:
        """Fit and measure."""
        fit: PhotoFit = fitter.fit(landmarks, photo.image_size)  # compiles, the first time
        for _ in range(_TIMED_REPEATS):
            start = time.perf_counter()
            fit = fitter.fit(landmarks, photo.image_size)
            self.times.append(1e3 * (time.perf_counter() - start))
        self.distances.append(mesh_distance(fit.vertices, truth, fit.model.topology.faces, region))
        self.iod.append(fit.reprojection_iod)
        self.degrees.append(float(np.rad2deg(rotation_angle(fit.rotation, photo.camera_from_model.rotation))))

    def metrics(self, prefix: str) -> dict[str, float]:
        """Return the means, and the median time."""
        metrics = dict(zip(MeshDistance._fields, np.mean(self.distances, axis=0).tolist(), strict=True)) | {
            "reprojection_iod": float(np.mean(self.iod)),
            "head_degrees": float(np.mean(self.degrees)),
        }
        if not prefix:
            metrics["fit_ms"] = float(np.median(self.times))
        return {prefix + name: value for name, value in metrics.items()}


def _build_model(skin: Face, seed: int, progress: Progress | None) -> BilinearModel:
    from facewright.faces.simulate import simulate_population
    from facewright.models.bilinear import fit_bilinear

    tensor = simulate_population(skin, N_PEOPLE, np.random.default_rng((seed, 0)), progress)
    return fit_bilinear(
        tensor,
        N_IDENTITY,
        N_EXPRESSION,
        topology=skin.topology,
        expression_names=("neutral", *skin.blendshape_names),
        progress=progress,
    )


def _detector() -> LandmarkDetector | None:
    try:
        return open_detector()
    except MissingExtraError:
        return None


def _landmark_error(found: Landmarks, truth: Landmarks) -> float:
    """Return the mean distance of the inner landmarks from the true ones, by the inter-ocular distance."""
    inner = found.definition.fixed
    distance = np.linalg.norm(found.points[inner] - truth.points[inner], axis=1)
    return float(distance.mean()) / interocular_distance(truth.points, truth.scheme)


def _astronaut_iod(fitter: PhotoFitter, detector: LandmarkDetector) -> float:
    """Return the reprojection error on scikit-image's astronaut portrait (NASA, public domain); 1 if not found."""
    from skimage import data

    picture = np.ascontiguousarray(data.astronaut())
    faces = detector.detect(picture)
    return fitter.fit(faces[0], (picture.shape[0], picture.shape[1])).reprojection_iod if faces else 1.0
