"""The segmentation by correlation and distance, and by each alone (Tena et al. 2011, Fig. 4)."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from facewright.apps.segment_regions import SegmentOptions, SegmentResult, segment_performers
from facewright.errors import ValueRangeError
from facewright.models.performer_data import PerformerData
from facewright.models.region_affinity import CORRELATION_THRESHOLD

Progress = Callable[[str, int, int], None]

_ALONE = {"correlation": 1.0, "distance": 0.0}
#: Thresholds of the correlation to try where it stands alone: without the distance, the paper's may leave vertices that
#: belong to no other.
_THRESHOLDS = (CORRELATION_THRESHOLD, 0.6, 0.5, 0.4, 0.3, 0.2, 0.1, 0.0)


class Segmented(NamedTuple):
    """The segmentation that the models use, and what was measured."""

    result: SegmentResult
    metrics: dict[str, float]


def measure_segmentation(performer: PerformerData, seed: int, progress: Progress | None = None) -> Segmented:
    """Segment a performer's mesh by A, by correlation alone and by distance alone.

    Parameters
    ----------
    performer : PerformerData
        With all its clips.
    seed : int
        Of k-means.
    progress : callable, optional
        Called with stage, done, total.

    Returns
    -------
    Segmented
        With metrics ``regions_k``: clusters found; ``symmetry``: adjusted Rand index with the mirror image;
        ``in_one_piece``: share of the clusters that are; ``ragged``: share of the vertices in no triangle of their
        cluster, before they join neighbours; the same with ``_correlation`` and ``_distance``, and with
        ``_at_k`` for these with as many clusters as A has, with ``loose``: how many of them are not compact;
        ``threshold_correlation``: the highest threshold at which correlation alone leaves no vertex without another;
        ``segmentation_s``: processor time of the one by A, the paper's parameters, all numbers of clusters tried.
    """
    start = time.process_time()
    chosen = segment_performers([performer], options=SegmentOptions(seed=seed), progress=progress)
    seconds = time.process_time() - start
    k = chosen.segmentation.chosen.n_clusters
    metrics = _figures(chosen, "") | {"segmentation_s": seconds}
    for name, share in _ALONE.items():
        options = SegmentOptions(seed=seed, correlation_share=share)
        free, options = _without_loners(performer, options, progress)
        metrics |= _figures(free, f"_{name}")
        if name == "correlation":
            metrics["threshold_correlation"] = options.threshold
        same = segment_performers([performer], options=replace(options, n_regions=k), progress=progress)
        figures = _figures(same, f"_{name}_at_k")
        figures.pop(f"regions_k_{name}_at_k")
        metrics |= figures | {f"loose_{name}_at_k": float(len(same.segmentation.chosen.loose))}
    return Segmented(chosen, metrics)


def _without_loners(
    performer: PerformerData, options: SegmentOptions, progress: Progress | None
) -> tuple[SegmentResult, SegmentOptions]:
    """Segment with the highest threshold at which every vertex has affinity to another."""
    for threshold in _THRESHOLDS[:-1]:
        tried = replace(options, threshold=threshold)
        with suppress(ValueRangeError):
            return segment_performers([performer], options=tried, progress=progress), tried
    tried = replace(options, threshold=_THRESHOLDS[-1])
    return segment_performers([performer], options=tried, progress=progress), tried


def _figures(found: SegmentResult, suffix: str) -> dict[str, float]:
    clustering = found.segmentation.chosen
    return {
        f"regions_k{suffix}": float(clustering.n_clusters),
        f"symmetry{suffix}": float(found.symmetry),
        f"in_one_piece{suffix}": float(np.mean(found.pieces == 1)),
        f"ragged{suffix}": len(clustering.moved) / len(clustering.labels),
    }
