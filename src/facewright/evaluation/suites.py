"""Which suites there are, running one by name, and the targets their metrics are held against."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from importlib import import_module

from facewright.errors import ValueRangeError
from facewright.numeric.check import check_choice

Progress = Callable[[str, int, int], None]

SUITES = (
    "transfer",
    "rigging",
    "bilinear",
    "photo",
    "fusion",
    "scan",
    "registration",
    "subject",
    "scale",
    "edit",
    "component",
    "retarget",
    "regions",
)

# For the ICT face on two cores: metric -> ("<=", ">=", "<" or ">", number or another metric). What the papers and the
# best tools reach, or what a user needs; a suite without an entry here has baselines instead.
TARGETS: dict[str, dict[str, tuple[str, float | str]]] = {
    "transfer": {"per_expression_ms": ("<=", 15.0)},
    "rigging": {"seconds": ("<=", 6.0), "improvement": (">=", 0.30), "left_right_swaps": ("<=", 0.0)},
    "bilinear": {"ratio_to_limit": ("<=", 1.5), "extra_peak_mb": ("<=", 700.0), "fit_rms_mm": ("<=", 1.0)},
    "photo": {"surface_mm": ("<", "mean_face_mm"), "fit_ms": ("<=", 20.0), "astronaut_iod": ("<=", 0.03)},
    "fusion": {"fused_to_raw": ("<=", 0.5)},
    "scan": {
        "neutral_stage2_to_depth_rms_mm": ("<=", 0.39),
        "neutral_surface_rms_mm": ("<=", 0.8),
        "expressions_surface_rms_mm": ("<=", 1.0),
        "mouth_stretch_surface_rms_mm": ("<", "without_landmarks_mouth_stretch_surface_rms_mm"),
    },
    "registration": {
        "surface_rms_mm": ("<", "nricp_surface_rms_mm"),
        "correspondence_rms_mm": ("<", "nricp_correspondence_rms_mm"),
        "seconds": ("<", "nricp_seconds"),
    },
    "subject": {"seconds": ("<=", 60.0), "unseen_rms_mm": ("<", "generic_rms_mm")},
    "scale": {"svd_growth_mb": ("<=", 50.0)},
    "edit": {
        "psnr_db": (">", "tps_psnr_db"),
        "ssim": (">", "tps_ssim"),
        "landmarks_iod": ("<=", 0.03),
        "psnr_db_150_identities": (">", "psnr_db_15_identities"),
    },
    "component": {
        "psnr_db": (">", "paste_psnr_db"),
        "ssim": (">", "paste_ssim"),
        "asymmetric_psnr_db_150x47": (">", "asymmetric_psnr_db_15x10"),
    },
    "retarget": {
        "fps": (">=", 15.0),
        "coefficient_mae": ("<", "neutral_mae"),
        "active_mae": ("<", "neutral_active_mae"),
    },
    "regions": {
        "region_rms_mm": ("<", "holistic_rms_mm"),
        "region_spread_mm": ("<", "holistic_spread_mm"),
        "region_below": (">=", 1.0),
        "region_leak": ("<", "holistic_leak"),
        "drag_us_397": ("<=", 100.0),
        "drag_us_11248": ("<=", 700.0),
        "crease_ratio": ("<=", 1.1),
    },
}


def run_suite(
    suite: str, face_name: str, seed: int, *, subjects: int | None = None, progress: Progress | None = None
) -> dict[str, float]:
    """Run a suite by name.

    Parameters
    ----------
    suite : str
        One of `SUITES`.
    face_name : str
        See `facewright.faces.load_face`.
    seed : int
        Seed of everything random in it.
    subjects : int, optional
        People to measure on.
    progress : callable, optional
        Called with stage, done, total.

    Returns
    -------
    dict of str to float
        The suite's metrics.

    Raises
    ------
    ValueRangeError
        If the suite is unknown or takes no `subjects`.
    MissingFaceError
        If the face is not installed.
    """
    from facewright.faces import load_face

    check_choice("suite", suite, SUITES)
    run = import_module(f"facewright.evaluation.{suite}").run
    options = {}
    if subjects is not None:
        if "subjects" not in inspect.signature(run).parameters:
            raise ValueRangeError(f"subjects must be left out for the suite {suite}, got {subjects}.")
        options["subjects"] = subjects
    metrics = run(load_face(face_name), seed, progress=progress, **options)
    return {name: float(value) for name, value in metrics.items()}


def has_targets(suite: str, face_name: str, subjects: int | None = None) -> bool:
    """Tell whether a run may be held against `TARGETS`: face "ict", and as many people as the suite's own."""
    check_choice("suite", suite, SUITES)
    if face_name != "ict" or subjects is None:
        return face_name == "ict"
    run = import_module(f"facewright.evaluation.{suite}").run
    return bool(subjects == inspect.signature(run).parameters["subjects"].default)


def compare(suite: str, metrics: Mapping[str, float], *, targets: bool = True) -> list[tuple[str, float, str, str]]:
    """List metric, value, target and whether it is met ("yes", "no" or "") in the order of `metrics`.

    Parameters
    ----------
    suite : str
        One of `SUITES`.
    metrics : mapping of str to float
        What `run_suite` returned.
    targets : bool
        Whether the run was one that targets are for, see `has_targets`; without it both columns stay empty.
    """
    rows = []
    for name, value in metrics.items():
        sign, limit = TARGETS.get(suite, {}).get(name, ("", 0.0)) if targets else ("", 0.0)
        bound = metrics.get(limit) if isinstance(limit, str) else limit
        if not sign or bound is None:
            rows.append((name, value, "", ""))
            continue
        met = {"<=": value <= bound, "<": value < bound, ">=": value >= bound, ">": value > bound}[sign]
        rows.append((name, value, f"{sign} {limit}", "yes" if met else "no"))
    return rows
