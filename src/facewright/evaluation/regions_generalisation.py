"""How well region-based and holistic models reconstruct unseen performances (Tena et al. 2011, Fig. 5)."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from facewright.apps.segment_regions import SegmentOptions, segment_performers
from facewright.evaluation.regions_session import RegisteredSession
from facewright.models.region_fit import RegionFitter, reconstruction_rms
from facewright.models.region_model import RegionModel
from facewright.models.region_pca import fit_region_pca
from facewright.models.regions import Regions

Progress = Callable[[str, int, int], None]

MOST_COMPONENTS = 15
#: Components each that figures are given for by name.
_NAMED = (1, 5, 10, 15)
_MAIN = 10
#: Components in all at which models are compared: this many times the number of regions.
_TOTALS = (1, 3, 5, 10, 15)
_SPARSE = 3
_SPARSE_FRAMES = 700
_SPARSE_ALPHA = 2.0


def first_components(model: RegionModel, count: int) -> RegionModel:
    """Return the model with the first `count` components of each region: of PCA the one trained with so many."""
    return replace(
        model,
        bases=tuple(part[:count] for part in model.bases),
        deviations=tuple(part[:count] for part in model.deviations),
        units=tuple(part[:count] for part in model.units),
        lower=tuple(part[:count] for part in model.lower),
        upper=tuple(part[:count] for part in model.upper),
        coefficient_names=tuple(part[:count] for part in model.coefficient_names),
    )


def unseen_rms(model: RegionModel, displacements: NDArray[np.floating]) -> float:
    """Return E_RMS (eq. 13), mm, of displacements (T, N, 3) fitted by eq. 6 with the paper's beta."""
    fitter = RegionFitter(model)
    return reconstruction_rms(displacements, fitter.reconstruct(fitter.fit(displacements)))


def measure_generalisation(
    session: RegisteredSession, regions: Regions, progress: Progress | None = None
) -> dict[str, float]:
    """Measure Fig. 5, and what it leaves open: equal numbers of components in all, and sparse components.

    Parameters
    ----------
    session : RegisteredSession
        Four performers.
    regions : Regions
        Of the region-based model.
    progress : callable, optional
        Called with stage, done, total.

    Returns
    -------
    dict of str to float
        ``region_rms_mm`` and ``holistic_rms_mm``: mean over the four test sets, 10 components each, trained with all;
        with ``_spread`` the standard deviation over performers; ``_m1``, ``_m1_f1``, ``_m1_f1_m2`` and ``_all`` with
        ``_1``, ``_5``, ``_10`` and ``_15`` components; ``_unseen_m1``: of the three performers that M1's model has not
        seen; ``region_below``: share of the 240 cells (training, test set, components) in which the region-based model
        is better, 1 in the paper. ``*_rms_mm_total_K`` with K components in all, trained with M1 (``_m1``) and with
        all; ``sparse_rms_mm_*_total_K`` and ``sparse_zeros``, the share of zeros in those components, beside
        ``holistic_rms_mm_*_thinned_total_K``: PCA of the same thinned frames, their mean subtracted too.
    """
    performers, names = session.performers, [data.name for data in session.performers]
    tests = [data.displacements(*session.test) for data in performers]
    trains = [data.displacements(*session.train) for data in performers]
    holistic = Regions.holistic(regions.n_vertices)
    first = performers[0]
    metrics: dict[str, float] = {}
    below = []
    for count in range(1, len(performers) + 1):
        label = "all" if count == len(performers) else "_".join(names[:count]).lower()
        moves = np.concatenate(trains[:count])
        wanted = max(MOST_COMPONENTS, max(_TOTALS) * len(regions.members))
        by_region = fit_region_pca(moves, first.faces, first.neutral, regions, MOST_COMPONENTS)
        whole = fit_region_pca(moves, first.faces, first.neutral, holistic, wanted)
        curves = {}
        for kind, model in (("region", by_region), ("holistic", whole)):
            curves[kind] = _curves(model, tests, progress, f"{kind} models of {label}")
            metrics |= _named(kind, label, curves[kind])
        below.append(curves["region"] < curves["holistic"])
        if count in (1, len(performers)):
            metrics |= _equal_totals(by_region, whole, tests, label)
            total = _SPARSE * len(regions.members)
            thinned = moves[:: max(1, len(moves) // _SPARSE_FRAMES)]
            twin = fit_region_pca(thinned, first.faces, first.neutral, holistic, total, centred=True)
            metrics[f"holistic_rms_mm_{label}_thinned_total_{total}"] = float(
                np.mean([unseen_rms(twin, test) for test in tests])
            )
            metrics |= _sparse(thinned, tests, total, f"{label}_total_{total}")
    metrics["region_below"] = float(np.mean(below))
    return _with_main(metrics)


def measure_unseen_segmentation(
    session: RegisteredSession, seed: int, n_regions: int, progress: Progress | None = None
) -> dict[str, float]:
    """Segment the first performer's session without the test sentences, and train on the rest as ever.

    The paper segments with all clips of M1, those that M1 is tested with among them.

    Parameters
    ----------
    session : RegisteredSession
    seed : int
        Of k-means.
    n_regions : int
        As many as the segmentation with all clips has.
    progress : callable, optional
        Called with stage, done, total.

    Returns
    -------
    dict of str to float
        ``regions_k_unseen``: clusters found; ``region_rms_mm_m1_10_unseen_segmentation``: to be held against
        ``region_rms_mm_m1_10``; with ``_at_k``: with `n_regions` clusters, for more of them have more coefficients.
    """
    first = session.performers[0]
    clips = [name for name in first.clip_names if name not in session.test]
    moves = first.displacements(*session.train)
    tests = [data.displacements(*session.test) for data in session.performers]
    metrics = {}
    for suffix, wanted in (("", None), ("_at_k", n_regions)):
        options = SegmentOptions(seed=seed, n_regions=wanted)
        regions = segment_performers([first], clips, options, progress).regions
        model = fit_region_pca(moves, first.faces, first.neutral, regions, _MAIN)
        errors = [unseen_rms(model, test) for test in tests]
        metrics[f"region_rms_mm_m1_{_MAIN}_unseen_segmentation{suffix}"] = float(np.mean(errors))
        if wanted is None:
            metrics["regions_k_unseen"] = float(len(regions.members))
    return metrics


def _curves(
    model: RegionModel, tests: list[NDArray[np.float32]], progress: Progress | None, stage: str
) -> NDArray[np.float64]:
    """Return E_RMS (test sets, components)."""
    errors = np.zeros((len(tests), MOST_COMPONENTS))
    for p in range(MOST_COMPONENTS):
        part = first_components(model, p + 1)
        errors[:, p] = [unseen_rms(part, test) for test in tests]
        if progress is not None:
            progress(stage, p + 1, MOST_COMPONENTS)
    return errors


def _named(kind: str, label: str, errors: NDArray[np.float64]) -> dict[str, float]:
    metrics = {}
    for p in _NAMED:
        metrics[f"{kind}_rms_mm_{label}_{p}"] = float(errors[:, p - 1].mean())
        metrics[f"{kind}_spread_mm_{label}_{p}"] = float(errors[:, p - 1].std())
    if label == "m1":
        metrics[f"{kind}_rms_mm_unseen_m1"] = float(errors[1:, _MAIN - 1].mean())
    return metrics


def _with_main(metrics: dict[str, float]) -> dict[str, float]:
    """Put what a reader looks for first: trained with all, ten components each."""
    main = {}
    for kind in ("region", "holistic"):
        main[f"{kind}_rms_mm"] = metrics[f"{kind}_rms_mm_all_{_MAIN}"]
        main[f"{kind}_spread_mm"] = metrics[f"{kind}_spread_mm_all_{_MAIN}"]
    return main | metrics


def _equal_totals(
    by_region: RegionModel, whole: RegionModel, tests: list[NDArray[np.float32]], label: str
) -> dict[str, float]:
    """Return E_RMS with as many components in all, shared among the regions or not."""
    metrics = {}
    for p in _TOTALS:
        part = first_components(by_region, p)
        total = part.n_coefficients
        for kind, model in (("region", part), ("holistic", first_components(whole, total))):
            metrics[f"{kind}_rms_mm_{label}_total_{total}"] = float(np.mean([unseen_rms(model, t) for t in tests]))
    return metrics


def _sparse(moves: NDArray[np.float32], tests: list[NDArray[np.float32]], total: int, suffix: str) -> dict[str, float]:
    """Return E_RMS of `total` sparse components, fitted to the tests by least squares, and their share of zeros.

    The mean that the learner subtracts is subtracted from the tests and added back.

    Scikit-learn's dictionary learning with sparse codes over the coordinates (`MiniBatchSparsePCA`) stands in for
    SPLOCS (Neumann et al. 2013): its components are sparse, but nothing groups x, y and z of a vertex or keeps a
    component in one place.
    """
    from sklearn.decomposition import MiniBatchSparsePCA

    flat = moves.reshape(len(moves), -1).astype(np.float64)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        learner = MiniBatchSparsePCA(total, alpha=_SPARSE_ALPHA, max_iter=60, batch_size=32, random_state=0)
        learner.fit(flat)
    components = learner.components_[np.abs(learner.components_).sum(axis=1) > 0]
    basis = np.linalg.qr(components.T)[0]
    errors = []
    for test in tests:
        rows = test.reshape(len(test), -1).astype(np.float64) - learner.mean_
        errors.append(reconstruction_rms(test, (learner.mean_ + rows @ basis @ basis.T).reshape(test.shape)))
    zeros = float(np.mean(components == 0))
    return {f"sparse_rms_mm_{suffix}": float(np.mean(errors)), f"sparse_zeros_{suffix}": zeros}
