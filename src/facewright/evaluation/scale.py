"""Suite `scale`: subjects per minute with one and two workers, and the memory of the N-mode SVD over a database."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

from facewright.errors import FacewrightError, ValueRangeError
from facewright.evaluation.database_svd import measure_database_svd, svd_reference_error
from facewright.faces.face import Face

Progress = Callable[[str, int, int], None]

SVD_PEOPLE = (150, 1000)
EXPRESSIONS = ("neutral", "smile", "mouth_stretch", "jaw_left", "grin")
FRAMES = 6
COMPONENTS = (50, 25)


def run(
    face: Face,
    seed: int,
    progress: Progress | None = None,
    *,
    subjects: int = 3,
    expressions: Sequence[str] = EXPRESSIONS,
    frames: int = FRAMES,
    svd_people: Sequence[int] = SVD_PEOPLE,
    scratch: Path | None = None,
) -> dict[str, float]:
    """Build databases of simulated captures and decompose databases of generated people.

    Parameters
    ----------
    face : Face
        Of captures and generated people.
    seed : int
        Seed of both.
    progress : callable(stage, done, total), optional
    subjects : int
        Captured people in each build; with two workers one more where it is odd, so that both have the same to do.
    expressions : sequence of str
        What each of them acts. Few, to keep the suite short: a whole subject has 20, and takes four times as long.
    frames : int
        Frames of each recording.
    svd_people : sequence of int
        Sizes of the databases of generated people.
    scratch : path, optional
        Folder for databases, up to 7 GB at 1,000 people and 11,248 vertices; a temporary one by default.

    Returns
    -------
    dict of str to float
        `subjects_per_minute_1_worker` and `_2_workers`: `facewright build` from recordings with landmark sidecars to
        blendshapes, `frames` frames of `expressions` each, the start of the workers left out; one worker computes
        with all cores, two with half of them each. `build_seconds_1_worker` and `_2_workers` are what they took.
        `svd_extra_peak_mb_150` and `_1000`: highest resident memory of a fresh process that decomposes the skin of so
        many generated people from a store on disk into 50 x 25 components, above that before it began; the core and
        the projected tensor, which it must hold, are `svd_must_hold_mb` of it. `svd_seconds_150` and `_1000`: time of
        that; `svd_growth_mb` is how much more memory the larger one took. `svd_reference_error` is the largest
        relative difference of the small database's singular values to those of a plain SVD of its unfolding.

    Raises
    ------
    StoreError
        If the disk has not enough room for the databases.
    FacewrightError
        If a subject fails.
    """
    if subjects < 1 or frames < 1 or "neutral" not in expressions or len(expressions) < 2:
        raise ValueRangeError("subjects and frames must be positive, expressions hold the neutral and another one.")
    with tempfile.TemporaryDirectory(dir=scratch, prefix="facewright-scale-") as folder:
        metrics = _build_rates(face, seed, subjects, tuple(expressions), frames, Path(folder), progress)
        for people in sorted(svd_people):
            metrics |= measure_database_svd(face.skin(), people, seed, COMPONENTS, Path(folder), progress)
    least, most = min(svd_people), max(svd_people)
    metrics["svd_growth_mb"] = metrics[f"svd_extra_peak_mb_{most}"] - metrics[f"svd_extra_peak_mb_{least}"]
    metrics["svd_reference_error"] = svd_reference_error(face.skin(), seed)
    return metrics


def _build_rates(
    face: Face,
    seed: int,
    subjects: int,
    expressions: tuple[str, ...],
    frames: int,
    folder: Path,
    progress: Progress | None,
) -> dict[str, float]:
    from facewright.apps.simulate_captures import SimulateCapturesRequest, simulate_captures

    captures = folder / "captures"
    request = SimulateCapturesRequest(
        captures,
        n_subjects=subjects + subjects % 2,
        face=face.name,
        n_frames=frames,
        expressions=expressions,
        seed=seed,
        landmarks="refined",
    )
    simulate_captures(request, progress)
    metrics: dict[str, float] = {}
    for workers in (1, 2):
        count = subjects if workers == 1 else subjects + subjects % 2
        seconds = _build_seconds(face.name, captures, folder / f"{workers}.zarr", workers, count, expressions, progress)
        key = f"{workers}_worker{'s' if workers > 1 else ''}"
        metrics[f"subjects_per_minute_{key}"] = 60 * count / seconds
        metrics[f"build_seconds_{key}"] = seconds
    return metrics


def _build_seconds(
    face: str,
    captures: Path,
    database: Path,
    workers: int,
    count: int,
    expressions: tuple[str, ...],
    progress: Progress | None,
) -> float:
    from facewright.apps.build import BuildRequest, build
    from facewright.warehouse.process_subject import ProcessOptions

    names = tuple(sorted(path.name for path in captures.iterdir())[:count])
    options = ProcessOptions(face=face, least_expressions=len(expressions) - 1)
    stage = f"building with {workers} worker{'s' if workers > 1 else ''}"

    def on_step(step: object) -> None:
        if progress is not None:
            progress(stage, step.done, step.total)  # type: ignore[attr-defined]

    request = BuildRequest(captures, str(database), options, workers=workers, retries=0, only=names)
    result = build(request, on_step=on_step)
    if result.report.failed:
        name, outcome = next(iter(result.report.failed.items()))
        raise FacewrightError(f"subject {name} must be built to measure the speed, got: {outcome.reason}")
    return result.report.seconds
