"""Time the N-mode SVD against its arithmetic limit and against TensorLy, in one run."""

from __future__ import annotations

import importlib.util
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from facewright.errors import MissingExtraError
from facewright.evaluation.out_of_core import measure_out_of_core
from facewright.evaluation.peak_memory import PeakMemory
from facewright.models.nmode_svd import gram_matrix, nmode_svd

_CHUNK = 10  # people whose shapes are rearranged at a time, so that no second copy of the tensor is needed


def time_nmode(
    tensor: NDArray[np.float32], n_identity: int, n_expression: int, *, repeats: int = 6
) -> dict[str, float]:
    """Time the decomposition and the two Gram products of the full unfoldings alternately; the best of each counts.

    Returns
    -------
    dict
        `nmode_seconds`; `gram_seconds`, for each unfolding the fastest of the layouts and routines tried
        (`gram_identity_seconds`, `gram_expression_seconds`); `ratio_to_limit`; `extra_peak_mb`, the highest resident
        memory during a decomposition above that before it (the result included).
    """
    nmode: list[float] = []
    limits: list[list[float]] = []
    for _ in range(repeats):
        limits.append([min(gram_layout_seconds(tensor, mode).values()) for mode in (0, 1)])
        # Twice: the limit is the luckiest of three routines, which on a busy machine is an advantage of its own.
        nmode.extend(_seconds(lambda: nmode_svd(tensor, n_identity, n_expression)) for _ in range(2))
    with PeakMemory() as memory:  # apart from the timing, which the sampling thread would disturb
        nmode_svd(tensor, n_identity, n_expression)
    identity, expression = np.min(limits, axis=0)
    return {
        "nmode_seconds": min(nmode),
        "gram_seconds": identity + expression,
        "gram_identity_seconds": identity,
        "gram_expression_seconds": expression,
        "ratio_to_limit": min(nmode) / (identity + expression),
        "extra_peak_mb": memory.extra_mb,
    }


def gram_layout_seconds(tensor: NDArray[np.float32], mode: int) -> dict[str, float]:
    """Time the Gram product of one full unfolding (0 identity, 1 expression) in several layouts; copies not counted."""
    from scipy.linalg.blas import ssyrk

    N, S = tensor.shape[:2]
    if mode == 0:
        rows = tensor.reshape(N, -1)
        return {
            "syrk": _seconds(lambda: ssyrk(1.0, rows.T, trans=1)),
            "matmul": _seconds(lambda: rows @ rows.T),
            "blocks": _seconds(lambda: gram_matrix(tensor, 0)),
        }
    shapes = tensor.reshape(N, S, -1)
    major = 0.0
    for start in range(0, N, _CHUNK):
        rows = np.ascontiguousarray(shapes[start : start + _CHUNK].swapaxes(0, 1)).reshape(S, -1)
        major += _seconds(lambda rows=rows: ssyrk(1.0, rows.T, trans=1))  # type: ignore[misc]
    return {
        "expression-major syrk": major,
        "batched matmul": _seconds(lambda: np.matmul(shapes, shapes.swapaxes(1, 2)).sum(axis=0)),
        "blocks": _seconds(lambda: gram_matrix(tensor, 1)),
    }


def time_out_of_core(tensor: NDArray[np.float32], n_identity: int, n_expression: int) -> dict[str, float]:
    """Decompose the tensor from a file in a process of its own; `peak_mb` is that whole process."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "tensor.npy"
        np.save(path, tensor)
        figures = measure_out_of_core(path, n_identity, n_expression)
    return {"peak_mb": figures["peak_mb"], "out_of_core_seconds": figures["seconds"]}


def has_tensorly() -> bool:
    """Tell whether TensorLy is installed."""
    return importlib.util.find_spec("tensorly") is not None


def time_tensorly(tensor: NDArray[np.float32], n_identity: int, n_expression: int) -> dict[str, float]:
    """Time TensorLy's N-mode SVD of the same tensor and compare the two reconstruction errors.

    ``partial_tucker`` with ``n_iter_max=0``: its truncated SVDs of the unfoldings and the core, without the
    iterations that it makes by default; one run. `tensorly_error_ratio` is its reconstruction error over ours.

    Raises
    ------
    MissingExtraError
        If TensorLy is not installed.
    """
    if not has_tensorly():
        raise MissingExtraError("with_tensorly needs TensorLy: pip install tensorly.")
    import tensorly
    from tensorly.decomposition import partial_tucker

    tensorly.set_backend("numpy")
    flat = tensor.reshape(*tensor.shape[:2], -1)
    with PeakMemory(0.05) as memory:
        start = time.perf_counter()
        (core, _), _ = partial_tucker(flat, rank=[n_identity, n_expression], modes=[0, 1], n_iter_max=0, init="svd")
        seconds = time.perf_counter() - start
    total = _square_norm(flat)
    theirs = total - _square_norm(core)  # orthonormal factors: what the core does not hold is the error
    del core
    ours = total - _square_norm(nmode_svd(tensor, n_identity, n_expression).core)
    return {
        "tensorly_seconds": seconds,
        "tensorly_extra_peak_mb": memory.extra_mb,
        "tensorly_error_ratio": float(np.sqrt(max(theirs, 0.0) / max(ours, 1e-300))),
    }


def _square_norm(array: NDArray[np.floating]) -> float:
    return float(sum(np.square(part, dtype=np.float64).sum() for part in array))


def _seconds(work: Callable[[], Any]) -> float:
    start = time.perf_counter()
    work()
    return time.perf_counter() - start
