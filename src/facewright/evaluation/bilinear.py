"""Suite `bilinear`: how fast and small the N-mode SVD is, and how well the model fits people it never saw."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from facewright.errors import ValueRangeError
from facewright.evaluation.nmode_timing import has_tensorly, time_nmode, time_out_of_core, time_tensorly
from facewright.faces.expressions import random_expression_weights
from facewright.faces.face import Face
from facewright.faces.simulate import simulate_person, simulate_population
from facewright.models.bilinear import BilinearModel, fit_bilinear
from facewright.models.bilinear_projection import BilinearProjector
from facewright.models.bilinear_store import load_bilinear, save_bilinear
from facewright.models.morphable import MorphableModel

Progress = Callable[[str, int, int], None]

COMPONENTS = ((10, 5), (25, 15), (50, 25), (75, 35), (100, 47))
HEADLINE = (50, 25, 150, 47)  # components, people and shapes that `fit_rms_mm` and its target are about
IDENTITIES = (15, 30, 60, 90, 150)
# Ten of the 47: the neutral and the strongest movements of brows, lids, lips and jaw.
TEN_EXPRESSIONS = (
    "neutral",
    "jawOpen",
    "mouthSmile_L",
    "mouthSmile_R",
    "mouthPucker",
    "mouthFunnel",
    "browInnerUp_L",
    "browInnerUp_R",
    "eyeBlink_L",
    "eyeBlink_R",
)
NOISE_MM = 0.5


def run(
    face: Face,
    seed: int,
    progress: Progress | None = None,
    *,
    subjects: int = 150,
    unseen_people: int = 12,
    expressions_each: int = 2,
    components: Sequence[tuple[int, int]] = COMPONENTS,
    with_tensorly: bool | None = None,
    repeats: int = 3,
    cache: Path | None = None,
) -> dict[str, float]:
    """Measure the bilinear model on simulated people.

    Parameters
    ----------
    face : Face
        Its skin is used (ICT-FaceKit: 11,248 vertices).
    seed : int
        Training people come from ``default_rng([seed, 0])``, unseen ones from ``default_rng([seed, 1])``.
    progress : callable(stage, done, total), optional
    subjects : int
        Training people.
    unseen_people, expressions_each : int
        Unseen people, and random blends of the 46 shapes with each.
    components : sequence of (I, E)
        Sizes for Fig. 4; those larger than the data are left out.
    with_tensorly : bool, optional
        Time TensorLy too (minutes and 8 GB at full size); where it is installed by default.
    repeats : int
        Runs of each timing; the best counts.
    cache : path, optional
        Folder that keeps the training tensor between runs.

    Returns
    -------
    dict of str to float
        All `*_rms_mm` are roots of mean squared vertex distances over all unseen meshes, without alignment.
        `fit_rms_mm` is 50 x 25 components of 150 people and 47 shapes, left out of runs with other `subjects` (whose
        best is `fit_rms_mm_` with their people and shapes); `fit_rms_mm_c10x5` (Fig. 4) other components;
        `fit_rms_mm_15x47` fewer people or ten expressions; `mean_face_rms_mm` the trivial baseline, the mean neutral.
        `fit_rms_mm_per_coordinate` is `fit_rms_mm` / sqrt(3). `neutral_pca_rms_mm` is the error of the unseen people's
        *neutrals* in a PCA with as many identity modes: what any bilinear model of this size leaves for identity alone.
    """
    if subjects < 3 or unseen_people < 1 or expressions_each < 1 or repeats < 1:
        raise ValueRangeError("subjects must be at least 3, unseen_people, expressions_each and repeats at least 1.")
    face = face.skin()
    tensor = _training_tensor(face, seed, subjects, cache, progress)
    n_shapes = tensor.shape[1]
    names = ("neutral", *face.blendshape_names)
    I, E = min(50, subjects), min(25, n_shapes)

    metrics: dict[str, float] = {"subjects": subjects, "vertices": tensor.shape[2]}
    _report(progress, "timing the N-mode SVD", 0, 3)
    metrics |= time_nmode(tensor, I, E, repeats=repeats)
    _report(progress, "timing the N-mode SVD", 1, 3)
    metrics |= time_out_of_core(tensor, I, E)
    _report(progress, "timing the N-mode SVD", 2, 3)
    if has_tensorly() if with_tensorly is None else with_tensorly:
        metrics |= time_tensorly(tensor, I, E)
        metrics["ratio_to_tensorly"] = metrics["nmode_seconds"] / metrics["tensorly_seconds"]
    _report(progress, "timing the N-mode SVD", 3, 3)

    neutrals, meshes = _unseen(face, seed, unseen_people, expressions_each, progress)

    def build(data: Any, n_identity: int, n_expression: int, shape_names: Sequence[str]) -> BilinearModel:
        return fit_bilinear(data, n_identity, n_expression, topology=face.topology, expression_names=shape_names)

    model = build(tensor, I, E, names)
    fit_rms, model_metrics = _model_metrics(model, meshes, progress)
    metrics |= model_metrics
    if (I, E, *tensor.shape[:2]) == HEADLINE:
        metrics["fit_rms_mm"] = fit_rms
        metrics["fit_rms_mm_per_coordinate"] = fit_rms / np.sqrt(3)
    metrics["mean_face_rms_mm"] = _rms(meshes - tensor[:, 0].mean(axis=0, dtype=np.float64))
    metrics["neutral_pca_rms_mm"] = _neutral_pca_rms(tensor[:, 0], neutrals, min(I, subjects - 1))
    del model

    def sweep(key: str, data: NDArray[np.float32], i: int, e: int, shape_names: Sequence[str]) -> None:
        headline = data is tensor and (i, e) == (I, E)
        metrics[key] = fit_rms if headline else _fit_rms(build(data, i, e, shape_names), meshes, progress, key)

    for i, e in components:
        if i <= subjects and e <= n_shapes:
            sweep(f"fit_rms_mm_c{i}x{e}", tensor, i, e, names)
    ten = np.array([names.index(name) for name in TEN_EXPRESSIONS])
    for people in sorted({*(n for n in IDENTITIES if n < subjects), subjects}):
        i = min(I, people)
        few = np.ascontiguousarray(tensor[:people, ten])
        sweep(f"fit_rms_mm_{people}x10", few, i, 10, TEN_EXPRESSIONS)
        del few
        sweep(f"fit_rms_mm_{people}x{n_shapes}", tensor if people == subjects else tensor[:people], i, E, names)
    return {name: float(value) for name, value in metrics.items()}


def _training_tensor(
    face: Face, seed: int, subjects: int, cache: Path | None, progress: Progress | None
) -> NDArray[np.float32]:
    path = None if cache is None else Path(cache) / f"{face.topology.fingerprint}-{subjects}-{seed}.npy"
    if path is not None and path.is_file():
        return np.load(path)
    tensor = simulate_population(face, subjects, np.random.default_rng([seed, 0]), progress)
    if path is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
        np.save(path, tensor)
    return tensor


def _unseen(
    face: Face, seed: int, people: int, each: int, progress: Progress | None
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return neutrals (people, V, 3) and meshes (people * each, V, 3) of people that are in no training set."""
    rng = np.random.default_rng([seed, 1])
    neutrals: list[NDArray[np.float32]] = []
    meshes: list[NDArray[np.float32]] = []
    for number in range(people):
        person = simulate_person(face, rng)
        neutrals.append(person.neutral)
        meshes.extend(person.pose(random_expression_weights(rng, each)))
        _report(progress, "unseen people", number + 1, people)
    return np.array(neutrals), np.array(meshes)


def _model_metrics(
    model: BilinearModel, meshes: NDArray[np.float32], progress: Progress | None
) -> tuple[float, dict[str, float]]:
    """Fit the unseen meshes with the full model (its error, mm), time its use, store and load it."""
    metrics: dict[str, float] = {}
    start = time.perf_counter()
    projector = BilinearProjector(model)
    metrics["projector_ms"] = 1e3 * (time.perf_counter() - start)
    times, squares = [], []
    for number, mesh in enumerate(meshes):
        start = time.perf_counter()
        fit = projector.fit(mesh, noise_mm=NOISE_MM)
        times.append(time.perf_counter() - start)
        squares.append(fit.rms_mm**2)
        _report(progress, "fitting unseen people", number + 1, len(meshes))
    fit_rms = float(np.sqrt(np.mean(squares)))
    metrics["project_ms"] = 1e3 * float(np.median(times))
    w_id, w_exp = fit.identity_weights, fit.expression_weights
    metrics["synthesise_ms"] = _median_ms(lambda: model.synthesise(w_id, w_exp))
    person = model.person(w_id).reshape(model.n_expression, -1)
    single = w_exp.astype(np.float32)
    metrics["synthesise_fixed_person_ms"] = _median_ms(lambda: single @ person)
    metrics["blendshapes_ms"] = _median_ms(lambda: model.blendshapes(w_id))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "model.fwbm"
        metrics["stored_max_error_mm"] = save_bilinear(model, path)
        metrics["file_mb"] = path.stat().st_size / 1e6
        metrics["load_ms"] = _median_ms(lambda: load_bilinear(path), 3)
    return fit_rms, metrics


def _fit_rms(model: BilinearModel, meshes: NDArray[np.float32], progress: Progress | None, label: str) -> float:
    projector = BilinearProjector(model)
    squares = []
    for number, mesh in enumerate(meshes):
        squares.append(projector.fit(mesh, noise_mm=NOISE_MM).rms_mm ** 2)
        _report(progress, label, number + 1, len(meshes))
    return float(np.sqrt(np.mean(squares)))


def _neutral_pca_rms(training: NDArray[np.float32], unseen: NDArray[np.float32], n_modes: int) -> float:
    model = MorphableModel.from_samples(training, n_modes)
    return _rms(np.array([x - model.synthesise(model.project(x)) for x in unseen]))


def _rms(offsets: NDArray[np.floating]) -> float:
    return float(np.sqrt((offsets.astype(np.float64) ** 2).sum(axis=-1).mean()))


def _median_ms(work: Callable[[], Any], repeats: int = 15) -> float:
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return 1e3 * float(np.median(times))


def _report(progress: Progress | None, stage: str, done: int, total: int) -> None:
    if progress is not None:
        progress(stage, done, total)
