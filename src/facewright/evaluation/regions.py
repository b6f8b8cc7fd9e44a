"""The regions suite: region-based models of four performers who are known by their markers (Tena et al. 2011)."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from facewright.apps.segment_regions import SegmentOptions, segment_performers
from facewright.errors import ValueRangeError
from facewright.evaluation.regions_behaviour import measure_boundaries, measure_dragged_boundaries, measure_locality
from facewright.evaluation.regions_clusters import measure_segmentation
from facewright.evaluation.regions_generalisation import measure_generalisation, measure_unseen_segmentation
from facewright.evaluation.regions_session import register_session
from facewright.evaluation.regions_speed import measure_speed
from facewright.faces.face import Face
from facewright.faces.performers import PERFORMER_NAMES
from facewright.models.performer_data import PerformerData
from facewright.models.region_pca import fit_region_pca
from facewright.models.regions import Regions

Progress = Callable[[str, int, int], None]

#: Components of the models that are posed, and the share of the motion that the holistic one keeps: as the default
#: model of the posing page has them, whose regions are symmetric.
_PER_REGION, _HOLISTIC_SHARE = 20, 0.99
#: Components of a holistic model that reconstructs as well as the region-based one.
_DETAILED = 600
#: ibug68: corners of the mouth (left, right), brows (left, right), and a brow, the chin, the other brow.
_CORNERS, _BROWS, _PINNED = (54, 48), (24, 19), (24, 8, 19)


def run(face: Face, seed: int, progress: Progress | None = None, *, subjects: int = 4) -> dict[str, float]:
    """Measure region-based models on the whole way from markers to drags.

    Four simulated performers act; cameras see markers, with noise, dropouts and swapped labels; every eighth frame (15
    a second) is registered to 397 vertices; M1's whole session is segmented; models are trained with 12 sentences of
    each performer and tested with 6 others. Errors are against the registered meshes, as in the paper, but for
    ``registration_*``, which are against the true surfaces.

    Parameters
    ----------
    face : Face
        Identities of the performers, and the template.
    seed : int
        Of performers, takes, noise and clustering.
    progress : callable, optional
        Called with stage, done, total.
    subjects : int
        Performers, 2 to 4, in the paper's order: M1, F1, M2, F2.

    Returns
    -------
    dict of str to float
        What `measure_generalisation`, `measure_unseen_segmentation`, `measure_segmentation`, `measure_locality`,
        `measure_speed`, `measure_boundaries` and `measure_dragged_boundaries` say; ``registration_*`` of
        `RegistrationErrors`, and ``registration_s_per_minute`` of motion; ``posed_regions``: how many the posed model
        has, which are symmetric (``plain_``: the paper's instead); ``training_s``: processor time of one model of all
        performers; ``frames``: registered; ``recorded``: 1 where the range of motion is the real recording's.
    """
    if not 2 <= subjects <= len(PERFORMER_NAMES):
        raise ValueRangeError(f"subjects must be in [2, {len(PERFORMER_NAMES)}], got {subjects}.")
    session = register_session(face, seed, progress, names=PERFORMER_NAMES[:subjects])
    first = session.performers[0]
    segmented = measure_segmentation(first, seed, progress)
    regions = segmented.result.regions
    general = measure_generalisation(session, regions, progress)
    general |= measure_unseen_segmentation(session, seed, len(regions.members), progress)
    everything = np.concatenate([data.displacements(*session.train) for data in session.performers])
    start = time.process_time()
    fit_region_pca(everything, first.faces, first.neutral, regions, _PER_REGION)
    training_s = time.process_time() - start
    whole = first.displacements()  # "trained with the complete motion capture set from subject M1", section 6
    provenance = {"template": first.template, "vertex_ids": first.vertex_ids.tolist()}
    neutral = first.reference.astype(np.float64)
    one = Regions.holistic(first.n_vertices)
    symmetric = segment_performers([first], options=SegmentOptions(seed=seed, symmetric=True), progress=progress)
    region, plain, holistic, detailed = (
        fit_region_pca(whole, first.faces, neutral, parts, count, provenance=provenance)
        for parts, count in (
            (symmetric.regions, _PER_REGION),
            (regions, _PER_REGION),
            (one, _HOLISTIC_SHARE),
            (one, _DETAILED),
        )
    )
    corners = _nearest(face, first, _CORNERS)
    if progress is not None:
        progress("dragging", 0, 1)
    drags = measure_locality({"region": region, "plain": plain, "holistic": holistic}, first.reference, corners)
    speed = measure_speed(region, face, np.concatenate([corners[:1], _nearest(face, first, _PINNED)]))
    unseen = session.performers[1].displacements(*session.test)
    return {
        **_main(general),
        **drags,
        **speed,
        "posed_regions": float(len(region.regions.members)),
        **segmented.metrics,
        **session.errors.metrics(),
        "registration_s_per_minute": session.seconds,
        "training_s": training_s,
        "frames": float(session.n_frames),
        "recorded": float(session.recorded),
        **measure_boundaries(region, detailed, unseen),
        **measure_dragged_boundaries(region, holistic, first.reference, corners, _nearest(face, first, _BROWS)),
        **general,
    }


def _main(metrics: dict[str, float]) -> dict[str, float]:
    """Return the figures that come first."""
    names = ("region_rms_mm", "holistic_rms_mm", "region_spread_mm", "holistic_spread_mm", "region_below")
    return {name: metrics[name] for name in names}


def _nearest(face: Face, data: PerformerData, points: tuple[int, ...]) -> NDArray[np.intp]:
    """Return the coarse vertices nearest to points of the ibug68 scheme."""
    places = face.mean_shape[face.topology.landmarks["ibug68"][list(points)]].astype(np.float64)
    distance = np.linalg.norm(places[:, None] - data.reference[None].astype(np.float64), axis=2)
    return np.asarray(distance.argmin(axis=1))
