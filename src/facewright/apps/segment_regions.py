"""Divide a face into regions that move together, from recorded performances (Tena et al. 2011, 4.2)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from facewright.apps.region_pictures import draw_regions, region_of_faces
from facewright.errors import ValueRangeError
from facewright.models.region_affinity import (
    CORRELATION_SHARE,
    CORRELATION_THRESHOLD,
    RADIUS_MM,
    nearness,
    region_affinity,
    still_coordinates,
    vertex_correlation,
)
from facewright.models.region_boundaries import share_boundaries
from facewright.models.region_files import write_regions
from facewright.models.region_segmentation import (
    MAX_REGIONS,
    RAGGED_SHARE,
    RESTARTS,
    Segmentation,
    cluster_pieces,
    segment_regions,
)
from facewright.models.region_symmetry import cluster_symmetry, mirrored_clusters, mirrored_regions, nearest_mirror

if TYPE_CHECKING:
    from facewright.models.performer_data import PerformerData
    from facewright.models.regions import Regions

Progress = Callable[[str, int, int], None]

#: The paper's 15 frames a second "to reduce redundancy".
FRAMES_PER_SECOND = 15.0
_LITTLE_MM = 0.5  # root mean square motion below which marker noise decides what moves alike
_ROUNDING = 1e-3  # of a frame: clips of just that rate keep all their frames


@dataclass(frozen=True)
class SegmentOptions:
    """Parameters of the segmentation; the paper's are the defaults.

    Parameters
    ----------
    correlation_share : float
        lambda of eq. (12): 1 is correlation alone, 0 distance alone.
    threshold : float
        Correlations below it count nothing.
    radius_mm : float
        r of eq. (11).
    frames_per_second : float
        Rate that recordings are thinned to.
    restarts : int
        Runs of k-means for each number of regions.
    n_regions : int, optional
        Exactly so many; else as many as stay compact.
    max_regions : int
    ragged_share : float
        Share of a region's vertices at ragged borders that join neighbours; 0 takes the paper by the letter.
    symmetric : bool
        Whether left and right are treated alike: the affinity is averaged with its mirror image, and clusters that
        pair up are made each other's images. The paper does neither.
    seed : int
        Of k-means.
    """

    correlation_share: float = CORRELATION_SHARE
    threshold: float = CORRELATION_THRESHOLD
    radius_mm: float = RADIUS_MM
    frames_per_second: float = FRAMES_PER_SECOND
    restarts: int = RESTARTS
    n_regions: int | None = None
    max_regions: int = MAX_REGIONS
    ragged_share: float = RAGGED_SHARE
    symmetric: bool = False
    seed: int = 0


@dataclass(frozen=True, eq=False)
class SegmentRequest:
    """What to segment.

    Parameters
    ----------
    data : sequence of path
        Performers' registered data, `facewright mocap import`; of one mesh.
    out : path
        The file of regions to write (JSON).
    picture : path, optional
        A picture to write.
    clips : sequence of str
        Only these clips; all where empty.
    options : SegmentOptions
    """

    data: Sequence[Path]
    out: Path
    picture: Path | None = None
    clips: Sequence[str] = ()
    options: SegmentOptions = SegmentOptions()


@dataclass(frozen=True, eq=False)
class SegmentResult:
    """Regions and how they came about.

    Parameters
    ----------
    regions : Regions
        With shared boundaries.
    segmentation : Segmentation
    pieces : ndarray of shape (M,), int32
        Of how many islands each cluster consists.
    symmetry : float
        Adjusted Rand index of the clusters and their mirror images.
    n_frames : int
        Frames used.
    remarks : tuple of str
        What the user should know.
    paths : tuple of path
        Files written.
    """

    regions: Regions
    segmentation: Segmentation
    pieces: NDArray[np.int32]
    symmetry: float
    n_frames: int
    remarks: tuple[str, ...]
    paths: tuple[Path, ...]


def segment_data(request: SegmentRequest, progress: Progress | None = None) -> SegmentResult:
    """Read performers' data, segment their common mesh, write the regions and, if asked for, a picture.

    Raises
    ------
    FileFormatError
        If a file cannot be read.
    ValueRangeError, DegenerateError
        If the meshes differ, there are too few frames, a parameter is out of range, or no two clusters are compact.
    """
    from facewright.io.image import write_image
    from facewright.models.sequence_store import load_performer

    if not request.data:
        raise ValueRangeError("at least one performer's data must be given, got none.")
    performers = [load_performer(path) for path in request.data]
    result = segment_performers(performers, request.clips, request.options, progress)
    write_regions(result.regions, request.out)
    paths = [request.out]
    if request.picture is not None:
        first = performers[0]
        face_region = region_of_faces(result.regions, first.faces)
        write_image(request.picture, draw_regions(first.neutral, first.faces, face_region))
        paths.append(request.picture)
    return SegmentResult(**{**result.__dict__, "paths": tuple(paths)})


def segment_performers(
    performers: Sequence[PerformerData],
    clips: Sequence[str] = (),
    options: SegmentOptions | None = None,
    progress: Progress | None = None,
) -> SegmentResult:
    """Segment the mesh of performers in correspondence; correlations are of displacements from each one's neutral.

    Raises
    ------
    ValueRangeError, DegenerateError
        See `segment_data`.
    """
    options = options or SegmentOptions()
    first = performers[0]
    for other in performers[1:]:
        if not np.array_equal(other.faces, first.faces):
            raise ValueRangeError(
                f"performers must be registered to one mesh, got {first.n_vertices} vertices of {first.name} and "
                f"{other.n_vertices} of {other.name} with other triangles: import both with the same template and "
                "version."
            )
    moves = np.concatenate([_thinned(each, clips, options.frames_per_second) for each in performers])
    correlation = vertex_correlation(moves)
    near = nearness(first.reference, first.faces, options.radius_mm)
    affinity = region_affinity(
        correlation, near, share=options.correlation_share, threshold=options.threshold
    )  # Eq. (12)
    mirror = first.mirror if first.mirror is not None else nearest_mirror(first.reference, first.faces)
    if options.symmetric:
        affinity = _both_sides(affinity, mirror)
    found = segment_regions(
        affinity,
        first.reference,
        first.faces,
        np.random.default_rng(options.seed),
        n_regions=options.n_regions,
        restarts=options.restarts,
        max_regions=options.max_regions,
        ragged_share=options.ragged_share,
        progress=progress,
    )
    labels = found.chosen.labels
    if options.symmetric:
        labels = mirrored_clusters(labels, mirror, first.reference[:, 0])
    regions = share_boundaries(labels, first.faces)
    if options.symmetric:
        regions = mirrored_regions(regions, labels, mirror)
    return SegmentResult(
        regions,
        found,
        cluster_pieces(labels, first.faces),
        cluster_symmetry(labels, mirror),
        len(moves),
        tuple(_remarks(moves, found, options)),
        (),
    )


def _both_sides(affinity: NDArray[np.float64], mirror: NDArray[np.int32]) -> NDArray[np.float64]:
    if not np.array_equal(mirror[mirror], np.arange(len(mirror))):
        raise ValueRangeError("symmetric regions need a mesh whose vertices mirror each other, got one without.")
    return 0.5 * (affinity + affinity[np.ix_(mirror, mirror)])


def _thinned(performer: PerformerData, clips: Sequence[str], rate: float) -> NDArray[np.float32]:
    """Return displacements (T, N, 3) of a performer's clips at no more than `rate` frames a second."""
    if not rate > 0:
        raise ValueRangeError(f"frames_per_second must be positive, got {rate}.")
    kept = []
    for name in clips or performer.clip_names:
        clip = performer.clip(name)
        slot = np.floor((clip.times - clip.times[0]) * rate + _ROUNDING)
        kept.append(clip.vertices[np.r_[True, np.diff(slot) > 0]])
    if not kept:
        raise ValueRangeError(f"{performer.name} must have at least one clip, got none.")
    return np.concatenate(kept) - performer.neutral


def _remarks(moves: NDArray[np.float32], found: Segmentation, options: SegmentOptions) -> list[str]:
    remarks = []
    still = int(still_coordinates(moves).all(axis=1).sum())
    if still:
        remarks.append(f"{still} of {moves.shape[1]} vertices never move: their correlation counts as none.")
    moved = float(np.sqrt((moves.astype(np.float64) ** 2).sum(axis=2).mean()))
    if moved < _LITTLE_MM:
        remarks.append(
            f"the face moves by {moved:.2f} mm (root mean square), little more than noise: give a performance, for "
            "what moves together does not show at rest."
        )
    if found.refused is None and options.n_regions is None:
        remarks.append(f"up to {options.max_regions} regions all are compact: --max-regions ended the search.")
    if not found.chosen.compact:
        remarks.append(
            f"{len(found.chosen.loose)} of {found.chosen.n_clusters} regions are not compact: many of their vertices "
            "lie in no triangle of theirs."
        )
    return remarks
