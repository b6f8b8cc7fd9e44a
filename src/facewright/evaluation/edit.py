"""The edit suite: attributes of rendered people changed in their pictures, against the same people changed for real."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from typing import TYPE_CHECKING, Self

import numpy as np
from numpy.typing import NDArray

from facewright.apps.edited_view import edited_view
from facewright.apps.photo_subject import PhotoSubject, open_photo_subject
from facewright.errors import MissingExtraError, ValueRangeError
from facewright.evaluation.edit_attributes import attribute_metrics
from facewright.evaluation.picture_similarity import psnr_db, ssim
from facewright.evaluation.simulated_edit import EditScene, TrueAttributes, simulate_scene
from facewright.evaluation.thin_plate import thin_plate_warp
from facewright.faces.attribute_editor import AttributeEditor
from facewright.faces.face import Face
from facewright.landmarks.detector import LandmarkDetector, open_detector
from facewright.landmarks.points import Landmarks, interocular_distance
from facewright.models.bilinear import BilinearModel

if TYPE_CHECKING:
    from facewright.imaging.mesh_view import MeshView
    from facewright.imaging.synthesis import Synthesis

Progress = Callable[[str, int, int], None]

N_PEOPLE, N_IDENTITY, N_EXPRESSION = 150, 50, 25
#: How many of the people smaller models know (Fig. 7 and 8 of FaceWarehouse).
IDENTITIES = (15, 30, 60, 90, 150)
NOISE_PX = 1.0
#: Longer and wider, as in Fig. 7 and 8, for every person; then two others in turn.
_ALWAYS = (("face length", 1.5), ("face width", 1.5))
_IN_TURN = (
    ("mouth width", -1.5),
    ("nose width", 1.5),
    ("jaw width", -1.5),
    ("eye size", 1.5),
    ("lip thickness", 1.5),
    ("cheek fullness", 1.5),
    ("nose length", -1.5),
    ("forehead height", 1.5),
)


def run(
    face: Face,
    seed: int,
    progress: Progress | None = None,
    *,
    subjects: int = 6,
    models: Sequence[BilinearModel] | None = None,
) -> dict[str, float]:
    """Measure photo editing.

    Parameters
    ----------
    face : Face
        With all its parts; the models are of its skin.
    seed : int
        Of the population, the unseen people, looks, cameras and noise.
    progress : callable, optional
        Called with stage, done, total.
    subjects : int
        Unseen people, of one picture and four changes of 1.5 standard deviations each: face length, face width, and
        two others in turn.
    models : sequence of BilinearModel, optional
        Of the face's skin, one for each of `IDENTITIES`; built from simulated people where absent.

    Returns
    -------
    dict of str to float
        ``psnr_db``, ``ssim``: the photo edited with the last model, against the true re-render, over the pixels of the
        face before or after; ``tps_psnr_db``, ``tps_ssim``: the photo warped by a thin-plate spline through that
        model's landmarks before and after; ``unchanged_psnr_db``, ``unchanged_ssim``: the photo as it was;
        ``whole_psnr_db``: of the whole picture;
        ``landmarks_iod``: mean distance of the landmarks detected in the edited photo from the model's, by the
        inter-ocular distance (left out where the detector is not installed); ``smallest_jacobian`` of all edits;
        ``psnr_db_15_identities`` and so on, for longer and wider faces; then what `attribute_metrics` measures.
    """
    if subjects < 1:
        raise ValueRangeError(f"subjects must be at least 1, got {subjects}.")
    models = models or build_models(face.skin(), seed, progress)
    if len(models) != len(IDENTITIES):
        raise ValueRangeError(f"models must be {len(IDENTITIES)}, one for each of {IDENTITIES} people.")
    editors = [AttributeEditor.of_model(model) for model in models]
    truth = TrueAttributes(face)
    figures: dict[str, list[float]] = defaultdict(list)
    with ExitStack() as stack:
        detector = _detector(stack)
        for k in range(subjects):
            rng = np.random.default_rng((seed, 1, k))
            scene = simulate_scene(face, rng)
            photo, region = scene.draw()
            found = _find(detector, photo, scene, rng)
            people = [open_photo_subject(photo, model, detector=_Found(found)) for model in models]
            for name, deviations in _requests(k):
                after, changed_region = scene.draw(truth.change(scene.person.neutral, {name: deviations}))
                scale = truth.standard_deviation[truth.names.index(name)]
                trial = _Trial(photo, after, region | changed_region, name, float(deviations * scale))
                if (name, deviations) in _ALWAYS:
                    for subject, editor, n_people in zip(people, editors, IDENTITIES, strict=True):
                        image = trial.edit(subject, editor)[0].image
                        figures[f"psnr_db_{n_people}_identities"].append(trial.psnr_db(image))
                trial.add(figures, people[-1], editors[-1], detector)
            if progress is not None:
                progress("editing photos", k + 1, subjects)
    metrics = {key: float(np.mean(values)) for key, values in figures.items()}
    metrics["smallest_jacobian"] = float(np.min(figures["smallest_jacobian"]))
    return metrics | attribute_metrics(face, models[-1], editors[-1], seed, progress)


def build_models(skin: Face, seed: int, progress: Progress | None = None) -> list[BilinearModel]:
    """Return models of the first 15, 30, ... of 150 simulated people: up to 50 identities x 25 expressions."""
    from facewright.faces.simulate import simulate_population
    from facewright.models.bilinear import fit_bilinear

    tensor = simulate_population(skin, N_PEOPLE, np.random.default_rng((seed, 0)), progress)
    return [
        fit_bilinear(
            tensor[:n],
            min(N_IDENTITY, n),
            N_EXPRESSION,
            topology=skin.topology,
            expression_names=("neutral", *skin.blendshape_names),
            provenance={"source": "simulated people", "face": skin.name, "n_people": n},
            progress=progress,
        )
        for n in IDENTITIES
    ]


class _Trial:
    """One change of one person, and the truth of it."""

    def __init__(
        self,
        photo: NDArray[np.uint8],
        truth: NDArray[np.uint8],
        region: NDArray[np.bool_],
        name: str,
        millimetres: float,
    ) -> None:
        self.photo, self.truth, self.region = photo, truth, region
        self.name, self.millimetres = name, millimetres

    def edit(self, subject: PhotoSubject, editor: AttributeEditor) -> tuple[Synthesis, MeshView]:
        """Edit by one model: the same millimetres, whatever its people's standard deviation."""
        asked = {self.name: self.millimetres / editor.standard_deviation[editor.names.index(self.name)]}
        view = edited_view(subject, editor.change(subject.fit.identity_weights, asked).weights)
        return subject.edit_synthesiser.draw(view), view

    def psnr_db(self, image: NDArray[np.uint8]) -> float:
        """Compare with the truth over the face."""
        return psnr_db(image, self.truth, self.region)

    def add(
        self,
        figures: dict[str, list[float]],
        subject: PhotoSubject,
        editor: AttributeEditor,
        detector: LandmarkDetector | None,
    ) -> None:
        """Edit, and measure beside the baselines."""
        drawn, view = self.edit(subject, editor)
        figures["smallest_jacobian"].append(drawn.smallest_jacobian)
        ids = subject.face.topology.landmarks["fw74"]
        landmarks = Landmarks("fw74", view.pixels[ids])
        warped = thin_plate_warp(self.photo, subject.source.pixels[ids], landmarks.points)
        for prefix, image in (("", drawn.image), ("tps_", warped), ("unchanged_", self.photo)):
            figures[f"{prefix}psnr_db"].append(self.psnr_db(image))
            figures[f"{prefix}ssim"].append(ssim(image, self.truth, self.region))
        figures["whole_psnr_db"].append(psnr_db(drawn.image, self.truth, np.ones_like(self.region)))
        if detector is None:
            return
        faces = detector.detect(drawn.image)
        figures["edited_detection_rate"].append(float(bool(faces)))
        if faces:
            found = faces[0].convert("fw74")
            inner = found.definition.fixed
            away = np.linalg.norm(found.points[inner] - landmarks.points[inner], axis=1)
            figures["landmarks_iod"].append(float(away.mean()) / interocular_distance(landmarks.points, "fw74"))


class _Found:
    """A detector that has looked already."""

    def __init__(self, landmarks: Landmarks) -> None:
        self._landmarks = landmarks

    def detect(self, image: NDArray[np.uint8]) -> list[Landmarks]:
        """Return what was found."""
        return [self._landmarks]

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        """Nothing to close."""


def _requests(subject: int) -> list[tuple[str, float]]:
    """Return the changes of a person: two that all have, and two of the others."""
    n = len(_IN_TURN)
    return [*_ALWAYS, _IN_TURN[2 * subject % n], _IN_TURN[(2 * subject + 1) % n]]


def _find(
    detector: LandmarkDetector | None, photo: NDArray[np.uint8], scene: EditScene, rng: np.random.Generator
) -> Landmarks:
    """Return detected landmarks; the true ones with noise where there is no detector or it finds nothing."""
    noisy = scene.landmarks(NOISE_PX, rng)
    faces = [] if detector is None else detector.detect(photo)
    return faces[0] if faces else noisy


def _detector(stack: ExitStack) -> LandmarkDetector | None:
    try:
        return stack.enter_context(open_detector())
    except MissingExtraError:
        return None
