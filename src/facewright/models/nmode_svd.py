"""N-mode singular value decomposition of a face tensor along identity and expression (FaceWarehouse eq. 8)."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from facewright.errors import ShapeError, ValueRangeError
from facewright.numeric.check import check_choice, check_shape

Progress = Callable[[str, int, int], None]

# Columns of one product whose factors are views of a resident tensor. More would let the sum inside a product, which
# is in single precision, drift; fewer would suffer on a busy machine, where each product waits for all threads.
IN_MEMORY_COLUMNS = 40_000
# Share of the largest eigenvalue that is rounding noise in a Gram matrix of float32 products with double sums over
# products (measured: 3e-9 at 150 x 47 x 33,744, 2e-8 at 20 x 12 x 45,000). Below ten times this, double is used.
SINGLE_NOISE_FLOOR = 4e-8


class NModeSVD(NamedTuple):
    """Truncated decomposition T = C x2 U_id x3 U_exp; the vertex mode is not factored.

    Attributes
    ----------
    core : ndarray of shape (I, E, V, 3), float32
        C of eq. 8, identity-major and C-contiguous: ``core.reshape(I, -1)`` is its mode-2 unfolding, free of cost.
    identity_factors : ndarray of shape (N, I), float64
        U_id, orthonormal columns.
    expression_factors : ndarray of shape (S, E), float64
        U_exp, orthonormal columns.
    identity_singular_values, expression_singular_values : ndarray of shape (N,) and (S,), float64
        All singular values of the two unfoldings, kept or not; those of the mode that is taken second belong to
        the tensor already truncated along the first.
    """

    core: NDArray[np.float32]
    identity_factors: NDArray[np.float64]
    expression_factors: NDArray[np.float64]
    identity_singular_values: NDArray[np.float64]
    expression_singular_values: NDArray[np.float64]


def nmode_svd(
    tensor: Any,
    n_identity: int,
    n_expression: int,
    *,
    order: str = "identity",
    precision: str = "auto",
    block_mb: float = 64.0,
    progress: Progress | None = None,
) -> NModeSVD:
    r"""Decompose a tensor of N people x S expressions along both, and keep the leading components.

    The left singular vectors of an unfolding are the eigenvectors of its small Gram matrix (N x N or S x S). One
    mode is decomposed and projected first, the other on the smaller rest (sequential truncation). The second
    projection works in place, so that beside the tensor only one intermediate exists.

    Parameters
    ----------
    tensor : array_like of shape (N, S, V, 3), or iterable of arrays of shape (N, S, v, 3)
        An ndarray, a ``numpy.memmap``, a `TensorFile`, anything with ``shape`` that gives ``tensor[:, :, a:b]``, or
        an iterable over consecutive vertex blocks that can be walked twice (a list, or an object with ``__iter__``;
        not a generator). Not modified. Values in millimetres. A tensor that has methods ``gram(mode, double,
        progress)`` and ``project(factors, mode, progress)`` is asked for its products instead of its values, so that
        they may be computed elsewhere; `gram_matrix` and `project_mode` say what they are.
    n_identity, n_expression : int
        I <= N and E <= S, components to keep.
    order : {"identity", "expression"}
        Which mode goes first. Identity leaves an intermediate (I, S, V, 3) that does not grow with the number of
        people; expression leaves (N, E, V, 3), with a little less arithmetic where S / E is large.
    precision : {"auto", "single", "double"}
        Products that make the Gram matrices. Sums over blocks are always double. "auto" starts with single and
        repeats in double where a kept eigenvalue is not well above the rounding noise.
    block_mb : float
        Size of a block of the tensor where one must be read or converted.
    progress : callable(stage, done, total), optional

    Returns
    -------
    NModeSVD

    Raises
    ------
    ShapeError
        If the tensor is not (N, S, V, 3), or blocks disagree.
    ValueRangeError
        If a count is out of range, a value is NaN or infinite, or the iterable can be walked only once.

    Notes
    -----
    FaceWarehouse 3.3, eq. 8: C = T x2 U_id^T x3 U_exp^T; eq. 9 is the truncation. Differs from the paper: the second
    mode is decomposed after the first was truncated (Vannieuwenhoven et al. 2012), with the same error bound.
    """
    check_choice("order", order, ("identity", "expression"))
    check_choice("precision", precision, ("auto", "single", "double"))
    source = _open(tensor, block_mb)
    N, S = source.n_people, source.n_shapes
    for name, kept, size in (("n_identity", n_identity, N), ("n_expression", n_expression, S)):
        if not 1 <= kept <= size:
            raise ValueRangeError(f"{name} must be in [1, {size}], got {kept}.")
    first = 0 if order == "identity" else 1
    counts = (n_identity, n_expression)

    factors: list[Any] = [None, None]
    values: list[Any] = [None, None]
    factors[first], values[first] = _leading(source, first, counts[first], precision, progress)
    rest = source.project(factors[first], first, progress)
    second = 1 - first
    factors[second], values[second] = _leading(_Resident(rest), second, counts[second], precision, progress)
    _project_in_place(rest, factors[second], second)
    shape = (n_identity, n_expression, rest.shape[2])
    rest.resize(shape, refcheck=False)  # gives the tail back to the system; nothing is copied
    return NModeSVD(rest.reshape(n_identity, n_expression, -1, 3), *factors, *values)


def gram_matrix(tensor: Any, mode: int, *, precision: str = "single", block_mb: float = 64.0) -> NDArray[np.float64]:
    """Return the Gram matrix of a tensor's unfolding: (N, N) for `mode` 0 (identity), (S, S) for 1 (expression)."""
    check_choice("mode", mode, (0, 1))
    return _open(tensor, block_mb).gram(mode, precision == "double", None)


def project_mode(
    tensor: Any, factors: NDArray[np.float64], mode: int, *, block_mb: float = 64.0
) -> NDArray[np.float32]:
    """Return a tensor times transposed factors (N, I) along mode 0 or (S, E) along 1: (I, S, 3V) or (N, E, 3V)."""
    check_choice("mode", mode, (0, 1))
    source = _open(tensor, block_mb)
    check_shape("factors", factors, (source.n_people, source.n_shapes)[mode], "kept")
    return source.project(factors, mode, None)


# --- sources -----------------------------------------------------------------------------------------------------


@dataclass
class _Source:
    """A tensor seen as consecutive blocks of columns (N, S, k); a column is one coordinate of one vertex."""

    n_people: int
    n_shapes: int
    n_columns: int | None  # unknown for an iterable until it has been walked once

    def blocks(self, double: bool) -> Iterator[tuple[slice, NDArray[Any]]]:
        raise TypeError

    def gram(self, mode: int, double: bool, progress: Progress | None) -> NDArray[np.float64]:
        return _gram(self, mode, double, progress)

    def project(self, factors: NDArray[np.float64], mode: int, progress: Progress | None) -> NDArray[np.float32]:
        return _project(self, factors, mode, progress)


class _Elsewhere(_Source):
    """A tensor whose products are computed by itself, wherever that is."""

    def __init__(self, tensor: Any) -> None:
        N, S, V, _ = tensor.shape
        super().__init__(N, S, 3 * V)
        self.tensor = tensor

    def gram(self, mode: int, double: bool, progress: Progress | None) -> NDArray[np.float64]:
        gram = np.asarray(self.tensor.gram(mode, double, progress), dtype=np.float64)
        size = (self.n_people, self.n_shapes)[mode]
        check_shape("gram", gram, size, size)
        _check_gram(gram)
        return gram

    def project(self, factors: NDArray[np.float64], mode: int, progress: Progress | None) -> NDArray[np.float32]:
        shape = [self.n_people, self.n_shapes, cast(int, self.n_columns)]
        shape[mode] = factors.shape[1]
        rest = self.tensor.project(factors, mode, progress)
        check_shape("projected tensor", rest, *shape)
        return rest


class _Resident(_Source):
    """A float array (N, S, K) in memory: blocks are views."""

    def __init__(self, array: NDArray[Any], block_mb: float = 64.0) -> None:
        super().__init__(array.shape[0], array.shape[1], array.shape[2])
        self.array, self.block_mb = array, block_mb

    def blocks(self, double: bool) -> Iterator[tuple[slice, NDArray[Any]]]:
        wanted = np.float64 if double else np.float32
        width = IN_MEMORY_COLUMNS
        if self.array.dtype != wanted:
            width = _columns_per_block(self.n_people * self.n_shapes * np.dtype(wanted).itemsize, self.block_mb)
        for start in range(0, self.array.shape[2], width):
            columns = slice(start, min(start + width, self.array.shape[2]))
            yield columns, self.array[:, :, columns].astype(wanted, copy=False)


class _Sliced(_Source):
    """Anything with a shape and slices along the vertices: memory maps, Zarr, strided arrays."""

    def __init__(self, array: Any, block_mb: float) -> None:
        N, S, V, _ = array.shape
        super().__init__(N, S, 3 * V)
        self.array, self.n_vertices, self.block_mb = array, V, block_mb

    def blocks(self, double: bool) -> Iterator[tuple[slice, NDArray[Any]]]:
        wanted = np.float64 if double else np.float32
        bytes_per_column = self.n_people * self.n_shapes * np.dtype(wanted).itemsize
        step = max(1, _columns_per_block(bytes_per_column, self.block_mb) // 3)
        for start in range(0, self.n_vertices, step):
            stop = min(start + step, self.n_vertices)
            block = np.array(self.array[:, :, start:stop], dtype=wanted, order="C")
            yield slice(3 * start, 3 * stop), block.reshape(self.n_people, self.n_shapes, -1)


class _Iterated(_Source):
    """An iterable over vertex blocks (N, S, v, 3), walked once per pass."""

    def __init__(self, iterable: Iterable[Any]) -> None:
        if iter(iterable) is iterable:
            raise ValueRangeError(
                "tensor must be an array or an iterable that can be walked more than once (a list or an object with "
                f"__iter__), got {type(iterable).__name__}, which is used up after one pass."
            )
        first = next(iter(iterable), None)
        if first is None:
            raise ShapeError("tensor must have at least one vertex block, got an empty iterable.")
        shape = np.shape(first)
        _check_tensor_shape("first block of tensor", shape)
        super().__init__(shape[0], shape[1], None)
        self.iterable = iterable

    def blocks(self, double: bool) -> Iterator[tuple[slice, NDArray[Any]]]:
        start = 0
        for number, given in enumerate(self.iterable):
            block = np.asarray(given, dtype=np.float64 if double else np.float32)
            _check_tensor_shape(f"block {number} of tensor", block.shape)
            if block.shape[:2] != (self.n_people, self.n_shapes):
                expected = (self.n_people, self.n_shapes, "v", 3)
                raise ShapeError(f"block {number} of tensor must have shape {expected}, got {block.shape}.")
            flat = block.reshape(self.n_people, self.n_shapes, -1)
            yield slice(start, start + flat.shape[2]), flat
            start += flat.shape[2]
        if self.n_columns not in (None, start):
            raise ShapeError(f"tensor must have {self.n_columns} columns in each pass, got {start}.")
        self.n_columns = start


def _open(tensor: Any, block_mb: float) -> _Source:
    if not block_mb > 0:
        raise ValueRangeError(f"block_mb must be positive, got {block_mb}.")
    if not hasattr(tensor, "shape"):
        return _Iterated(tensor)
    _check_tensor_shape("tensor", tensor.shape)
    if hasattr(tensor, "gram") and hasattr(tensor, "project"):
        return _Elsewhere(tensor)
    plain = type(tensor) is np.ndarray and tensor.strides[3] * 3 == tensor.strides[2]
    if plain and tensor.dtype.kind == "f":
        N, S, V, _ = tensor.shape
        return _Resident(tensor.reshape(N, S, 3 * V), block_mb)
    return _Sliced(tensor, block_mb)


def _check_tensor_shape(name: str, shape: tuple[int, ...]) -> None:
    if len(shape) != 4 or shape[3] != 3 or 0 in shape:
        raise ShapeError(f"{name} must have shape (people, expressions, vertices, 3), got {tuple(shape)}.")


def _columns_per_block(bytes_per_column: int, block_mb: float) -> int:
    return max(1, int(block_mb * 1e6 / bytes_per_column))


# --- arithmetic --------------------------------------------------------------------------------------------------


def _leading(
    source: _Source, mode: int, count: int, precision: str, progress: Progress | None
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the leading left singular vectors of the mode's unfolding and all its singular values."""
    gram = source.gram(mode, precision == "double", progress)
    values, vectors = np.linalg.eigh(gram)
    if precision == "auto" and values[-count] < 10 * SINGLE_NOISE_FLOOR * values[-1]:
        values, vectors = np.linalg.eigh(source.gram(mode, True, progress))
    vectors = vectors[:, ::-1][:, :count]
    # An eigenvector's sign is arbitrary: make its largest entry positive, so that results repeat.
    largest = np.take_along_axis(vectors, np.abs(vectors).argmax(axis=0)[None], axis=0)[0]
    return vectors * np.where(largest < 0, -1.0, 1.0), np.sqrt(np.maximum(values[::-1], 0.0))


def _gram(source: _Source, mode: int, double: bool, progress: Progress | None) -> NDArray[np.float64]:
    size = (source.n_people, source.n_shapes)[mode]
    gram = np.zeros((size, size))
    for columns, block in source.blocks(double):
        # A @ A.T is recognised by NumPy: BLAS syrk computes one triangle. Short sums in single, the long one in double.
        for index in range(block.shape[1 - mode]):
            rows = block[:, index] if mode == 0 else block[index]
            gram += rows @ rows.T
        _report(progress, ("identity", "expression")[mode] + " modes", columns.stop, source.n_columns)
    _check_gram(gram)
    return gram


def _check_gram(gram: NDArray[np.float64]) -> None:
    if not np.isfinite(gram).all():
        raise ValueRangeError("tensor must be finite, got NaN or infinite values; fill missing cells first.")


def _project(
    source: _Source, factors: NDArray[np.float64], mode: int, progress: Progress | None
) -> NDArray[np.float32]:
    """Multiply the tensor by the transposed factors along `mode`; (I, S, K) or (N, E, K)."""
    shape = [source.n_people, source.n_shapes, cast(int, source.n_columns)]
    shape[mode] = factors.shape[1]
    result = np.empty(shape, dtype=np.float32)
    transposed = np.ascontiguousarray(factors.T, dtype=np.float32)
    for columns, block in source.blocks(double=False):
        if mode == 0 and block.shape[2] == shape[2] and block.flags.c_contiguous:  # the free unfolding, at once
            np.matmul(transposed, block.reshape(len(block), -1), out=result.reshape(len(result), -1))
        elif mode == 0:  # batched over expressions; the swapped axes are strides, not copies
            np.matmul(transposed, block.swapaxes(0, 1), out=result.swapaxes(0, 1)[:, :, columns])
        else:
            np.matmul(transposed, block, out=result[:, :, columns])
        _report(progress, "core tensor", columns.stop, source.n_columns)
    return result


def _project_in_place(rest: NDArray[np.float32], factors: NDArray[np.float64], mode: int) -> None:
    """Multiply along `mode` and leave the result, packed, at the start of the same memory."""
    transposed = np.ascontiguousarray(factors.T, dtype=np.float32)
    n_rows, n_shapes, n_columns = rest.shape
    kept = factors.shape[1]
    if mode == 0:
        scratch = np.empty((kept, min(IN_MEMORY_COLUMNS, n_columns)), dtype=np.float32)
        for shape in range(n_shapes):
            for start in range(0, n_columns, IN_MEMORY_COLUMNS):
                columns = slice(start, min(start + IN_MEMORY_COLUMNS, n_columns))
                out = scratch[:, : columns.stop - start]
                np.matmul(transposed, rest[:, shape, columns], out=out)
                rest[:kept, shape, columns] = out
        return
    scratch = np.empty((kept, n_columns), dtype=np.float32)
    packed = rest.reshape(-1)
    for row in range(n_rows):  # row r of the result ends where or before row r of the input does
        np.matmul(transposed, rest[row], out=scratch)
        packed[row * scratch.size : (row + 1) * scratch.size] = scratch.reshape(-1)


def _report(progress: Progress | None, stage: str, done: int, total: int | None) -> None:
    if progress is not None:
        progress(stage, done, total or done)
