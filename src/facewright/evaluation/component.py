"""The component suite: face components carried between pictures of one unseen person, beside copy-and-paste."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from facewright.apps.photo_subject import PhotoSubject, complete_subject
from facewright.apps.transfer_component import transfer_between
from facewright.errors import ValueRangeError
from facewright.evaluation.copy_and_paste import paste_component
from facewright.evaluation.picture_similarity import psnr_db, ssim
from facewright.evaluation.simulated_pair import IMAGE_SIZE, SimulatedPair, simulate_pair
from facewright.faces.face import Face
from facewright.faces.simulate import simulate_person, simulate_population
from facewright.fitting.joint import JointFitter
from facewright.imaging.component_mask import COMPONENTS
from facewright.io.image import PhotoFile
from facewright.models.bilinear import BilinearModel, fit_bilinear

Progress = Callable[[str, int, int], None]

N_PEOPLE, N_IDENTITY, N_EXPRESSION = 150, 50, 47
N_FEW = 15
#: Ten symmetric expressions, the neutral being the first: sums of shapes.
SYMMETRIC: dict[str, tuple[str, ...]] = {
    "jawOpen": ("jawOpen",),
    "mouthSmile": ("mouthSmile_L", "mouthSmile_R"),
    "mouthFrown": ("mouthFrown_L", "mouthFrown_R"),
    "mouthPucker": ("mouthPucker",),
    "mouthStretch": ("mouthStretch_L", "mouthStretch_R"),
    "cheekPuff": ("cheekPuff_L", "cheekPuff_R"),
    "browDown": ("browDown_L", "browDown_R"),
    "browUp": ("browInnerUp_L", "browInnerUp_R", "browOuterUp_L", "browOuterUp_R"),
    "eyeBlink": ("eyeBlink_L", "eyeBlink_R"),
}


def run(
    face: Face,
    seed: int,
    progress: Progress | None = None,
    *,
    subjects: int = 3,
    model: BilinearModel | None = None,
) -> dict[str, float]:
    """Measure component transfer on rendered pairs whose truth is known.

    Parameters
    ----------
    face : Face
        With all its parts.
    seed : int
        Of the populations, the unseen people, expressions, cameras, lights and noise.
    progress : callable, optional
        Called with stage, done, total.
    subjects : int
        Unseen people; each gives a pair for every component and one with a mouth pulled to one side.
    model : BilinearModel, optional
        Of the face or its skin; built from 150 other simulated people with 47 shapes each, where absent.

    Returns
    -------
    dict of str to float
        Over the component's pixels of the true picture (target's camera, pose and light, reference's expression of the
        component): ``psnr_db`` and ``ssim`` of the result, ``paste_psnr_db`` and ``paste_ssim`` of copy-and-paste in
        two dimensions, ``unchanged_psnr_db`` of the target as it is; means over people and components, then
        ``psnr_db_mouth``, ``paste_psnr_db_mouth`` and so on of each component. ``asymmetric_psnr_db_150x47``,
        ``asymmetric_psnr_db_15x10`` (and ``ssim``): the mouth pulled to one side, with the model and with one of 15
        people and 10 symmetric expressions; ``asymmetric_paste_psnr_db`` beside. Landmarks are the true ones with
        noise of 1 pixel.

    Raises
    ------
    ValueRangeError
        If there is no subject.
    """
    if subjects < 1:
        raise ValueRangeError(f"subjects must be at least 1, got {subjects}.")
    many = JointFitter(model or _build_model(face.skin(), seed, progress))
    few = JointFitter(_build_symmetric_model(face, seed, progress))
    found: dict[str, list[float]] = defaultdict(list)
    total = subjects * (len(COMPONENTS) + 1)
    for k in range(subjects):
        person = simulate_person(face, np.random.default_rng((seed, 2, k)))
        for i, component in enumerate(COMPONENTS):
            pair = simulate_pair(face, person, component, np.random.default_rng((seed, 3, k, i)))
            _measure(found, f"_{component}", pair, _transferred(many, face, pair))
            if progress is not None:
                progress("carrying components over", k * (len(COMPONENTS) + 1) + i + 1, total)
        pair = simulate_pair(face, person, "mouth", np.random.default_rng((seed, 4, k)), one_sided=True)
        for name, fitter in (("150x47", many), ("15x10", few)):
            picture = _transferred(fitter, face, pair)
            found[f"asymmetric_psnr_db_{name}"].append(psnr_db(picture, pair.truth, pair.region))
            found[f"asymmetric_ssim_{name}"].append(ssim(picture, pair.truth, pair.region))
        found["asymmetric_paste_psnr_db"].append(psnr_db(_pasted(pair), pair.truth, pair.region))
        if progress is not None:
            progress("carrying components over", (k + 1) * (len(COMPONENTS) + 1), total)
    return _means(found)


def _transferred(fitter: JointFitter, face: Face, pair: SimulatedPair) -> NDArray[np.uint8]:
    """Return the target with the reference's component."""
    target, reference = subjects_of(fitter, face, pair)
    return transfer_between(target, reference, pair.component).image


def subjects_of(fitter: JointFitter, face: Face, pair: SimulatedPair) -> list[PhotoSubject]:
    """Return the fitted person in both pictures, with one identity."""
    shots = (pair.target, pair.reference)
    fits = fitter.fit([shot.landmarks for shot in shots], [IMAGE_SIZE, IMAGE_SIZE])
    return [
        complete_subject(PhotoFile.of(shot.image), fit, face, shot.landmarks)
        for shot, fit in zip(shots, fits, strict=True)
    ]


def _pasted(pair: SimulatedPair) -> NDArray[np.uint8]:
    return paste_component(
        pair.target.image, pair.reference.image, pair.target.landmarks, pair.reference.landmarks, pair.component
    )


def _measure(found: dict[str, list[float]], suffix: str, pair: SimulatedPair, picture: NDArray[np.uint8]) -> None:
    """Append what a result, copy-and-paste and the unchanged target reach."""
    for prefix, image in (("", picture), ("paste_", _pasted(pair)), ("unchanged_", pair.target.image)):
        found[f"{prefix}psnr_db{suffix}"].append(psnr_db(image, pair.truth, pair.region))
        found[f"{prefix}ssim{suffix}"].append(ssim(image, pair.truth, pair.region))


def _means(found: dict[str, list[float]]) -> dict[str, float]:
    """Return means over people and components first, then those of each component."""
    overall = {}
    for name in ("psnr_db", "ssim", "paste_psnr_db", "paste_ssim", "unchanged_psnr_db"):
        overall[name] = float(np.mean([found[f"{name}_{component}"] for component in COMPONENTS]))
    single = {name: float(np.mean(values)) for name, values in found.items() if name.startswith("asymmetric")}
    for component in COMPONENTS:
        for name in ("psnr_db", "paste_psnr_db", "ssim", "paste_ssim"):
            single[f"{name}_{component}"] = float(np.mean(found[f"{name}_{component}"]))
    return overall | single


def _build_model(skin: Face, seed: int, progress: Progress | None) -> BilinearModel:
    tensor = simulate_population(skin, N_PEOPLE, np.random.default_rng((seed, 0)), progress)
    names = ("neutral", *skin.blendshape_names)
    return fit_bilinear(
        tensor, N_IDENTITY, N_EXPRESSION, topology=skin.topology, expression_names=names, progress=progress
    )


def _build_symmetric_model(face: Face, seed: int, progress: Progress | None) -> BilinearModel:
    """Return the model of 15 people x 10 symmetric expressions, after Vlasic et al. (2005); all parts of the face."""
    tensor = simulate_population(face, N_FEW, np.random.default_rng((seed, 1)), progress)
    neutral = tensor[:, 0]
    shapes = [neutral, *(neutral + _sum_of(tensor, face, shapes) for shapes in SYMMETRIC.values())]
    return fit_bilinear(
        np.stack(shapes, axis=1),
        N_FEW,
        len(shapes),
        topology=face.topology,
        expression_names=("neutral", *SYMMETRIC),
    )


def _sum_of(tensor: NDArray[np.float32], face: Face, names: Sequence[str]) -> NDArray[np.float32]:
    """Return the sum of displacements of shapes, (N, V, 3)."""
    rows = [1 + face.blendshape_names.index(name) for name in names]
    return np.asarray(tensor[:, rows].sum(axis=1) - len(rows) * tensor[:, 0])
