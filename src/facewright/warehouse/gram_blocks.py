"""Products of a database's tensor, computed over blocks of vertices as Dask tasks (FaceWarehouse eq. 8)."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from facewright.errors import FacewrightError, ValueRangeError
from facewright.models.nmode_svd import gram_matrix, project_mode
from facewright.warehouse.dask_cluster import Call, Cluster

Progress = Callable[[str, int, int], None]

_STAGES = ("identity modes", "expression modes")


@dataclass(frozen=True, eq=False)
class BlockedTensor:
    """A tensor that `nmode_svd` decomposes by tasks: each reads one block of vertices and multiplies it.

    Sums over blocks are taken in the blocks' order, so that the result does not depend on how many workers there are
    or which was faster. Memory does not grow with the number of people: a task holds one block, and the caller one
    Gram matrix and the projected tensor.

    Parameters
    ----------
    tensor : object with ``shape`` (N, S, V, 3) that gives ``tensor[:, :, a:b]``
        Millimetres. It travels to the workers and so must be small itself, as `Warehouse.blendshape_tensor` is.
    cluster : Cluster
        Where the tasks run, see `open_cluster`.
    block_mb : float
        Size of a block in single precision, about; blocks are whole chunks of the store (`block_vertices` of the
        tensor) unless one chunk is over twice that size.
    retries : int
        Further attempts at a block that could not be read.
    """

    tensor: Any
    cluster: Cluster
    block_mb: float = 64.0
    retries: int = 2

    def __post_init__(self) -> None:
        if not self.block_mb > 0 or self.retries < 0:
            raise ValueRangeError(
                f"block_mb must be positive and retries 0 or more, got {self.block_mb} and {self.retries}."
            )

    @property
    def shape(self) -> tuple[int, int, int, int]:
        """People, shapes, vertices, 3."""
        return self.tensor.shape

    def gram(self, mode: int, double: bool, progress: Progress | None) -> NDArray[np.float64]:
        """Return the Gram matrix of the unfolding along people (0) or shapes (1)."""
        size = self.shape[mode]
        gram = np.zeros((size, size))
        early: dict[int, NDArray[np.float64]] = {}  # products whose predecessors are still being computed
        precision = "double" if double else "single"
        due = 0
        for index, product in self._products(_gram_of_block, (mode, precision), _STAGES[mode], progress):
            early[index] = product
            while due in early:
                gram += early.pop(due)
                due += 1
        return gram

    def project(self, factors: NDArray[np.float64], mode: int, progress: Progress | None) -> NDArray[np.float32]:
        """Return the tensor times the transposed factors along `mode`, (I, S, 3V) or (N, E, 3V)."""
        shape = [*self.shape[:2], 3 * self.shape[2]]
        shape[mode] = factors.shape[1]
        result = np.empty(shape, dtype=np.float32)
        blocks = self.blocks()
        for index, product in self._products(_project_block, (factors, mode), "core tensor", progress):
            start, stop = blocks[index]
            result[:, :, 3 * start : 3 * stop] = product
        return result

    def blocks(self) -> list[tuple[int, int]]:
        """Return the vertex ranges of the tasks."""
        N, S, V, _ = self.shape
        step = max(1, int(self.block_mb * 1e6 / (N * S * 3 * np.dtype(np.float32).itemsize)))
        chunk = getattr(self.tensor, "block_vertices", 1)
        if 2 * step >= chunk:  # then no chunk is read twice
            step = max(chunk, step - step % chunk)
        return [(start, min(start + step, V)) for start in range(0, V, step)]

    def _products(
        self, function: Callable[..., Any], arguments: tuple[Any, ...], stage: str, progress: Progress | None
    ) -> Iterator[tuple[int, Any]]:
        blocks = self.blocks()
        calls: Iterator[Call] = (
            (f"block-{index}", (self.tensor, start, stop, *arguments)) for index, (start, stop) in enumerate(blocks)
        )
        for done, finished in enumerate(self.cluster.run(function, calls, retries=self.retries), start=1):
            if finished.error is not None:
                raise self._failure(finished.error, finished.worker_died) from finished.error
            if progress is not None:
                progress(stage, done, len(blocks))
            yield int(finished.label.rpartition("-")[2]), finished.value

    def _failure(self, error: Exception, worker_died: bool) -> Exception:
        if worker_died:
            return FacewrightError(
                f"a worker process died while it multiplied a block of {self.block_mb:g} MB; give it more memory or "
                "make blocks smaller."
            )
        return error


def _gram_of_block(tensor: Any, start: int, stop: int, mode: int, precision: str) -> NDArray[np.float64]:
    return gram_matrix(_read(tensor, start, stop), mode, precision=precision)


def _project_block(tensor: Any, start: int, stop: int, factors: NDArray[np.float64], mode: int) -> NDArray[np.float32]:
    return project_mode(_read(tensor, start, stop), factors, mode)


def _read(tensor: Any, start: int, stop: int) -> NDArray[np.float32]:
    return np.ascontiguousarray(tensor[:, :, start:stop], dtype=np.float32)
