"""A face tensor in a .npy file, read by vertex blocks with bounded memory."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from facewright.errors import FileFormatError, StoreError


class TensorFile:
    """A tensor (N, S, V, 3) in a .npy file that gives ``file[:, :, a:b]``.

    Unlike a memory map, whose pages count as resident until the system takes them back, only the block that is asked
    for is ever in memory.

    Parameters
    ----------
    path : str or path
        A .npy file of C-ordered float32 or float64, as `numpy.save` writes it.

    Raises
    ------
    StoreError
        If the file cannot be read.
    FileFormatError
        If it is not such a file, or shorter or longer than its header says.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)
        try:
            with self.path.open("rb") as file:
                try:
                    version = np.lib.format.read_magic(file)
                    read = {
                        (1, 0): np.lib.format.read_array_header_1_0,
                        (2, 0): np.lib.format.read_array_header_2_0,
                    }[version]
                    shape, fortran, dtype = read(file)
                except (ValueError, KeyError, EOFError) as error:
                    raise FileFormatError(f"{self.path} must be a .npy file, got {error}.") from error
                self._offset = file.tell()
                size = os.fstat(file.fileno()).st_size
        except OSError as error:
            raise StoreError(f"{self.path} cannot be read: {error.strerror or error}.") from error
        if len(shape) != 4 or shape[3] != 3 or fortran or dtype not in (np.float32, np.float64):
            order = "Fortran" if fortran else "C"
            raise FileFormatError(
                f"{self.path} must hold a C-ordered float tensor (N, S, V, 3), got {dtype} {shape} in {order} order."
            )
        self.shape: tuple[int, int, int, int] = shape
        self.dtype = dtype
        n_values = 1
        for axis in shape:
            n_values *= axis
        expected = self._offset + n_values * dtype.itemsize
        if size != expected:
            raise FileFormatError(f"{self.path} must have {expected} bytes for shape {shape}, got {size}.")

    def __getitem__(self, index: tuple[slice, slice, slice]) -> NDArray[np.floating]:
        """Return ``self[:, :, a:b]``, read from the file."""
        if len(index) != 3 or index[0] != slice(None) or index[1] != slice(None) or index[2].step not in (None, 1):
            raise IndexError("a tensor file is read as file[:, :, a:b].")
        N, S, V, _ = self.shape
        start, stop, _ = index[2].indices(V)
        block = np.empty((N * S, max(stop - start, 0) * 3), dtype=self.dtype)
        row_bytes, first = V * 3 * self.dtype.itemsize, start * 3 * self.dtype.itemsize
        try:
            with self.path.open("rb", buffering=0) as file:
                for row, target in enumerate(block):
                    file.seek(self._offset + row * row_bytes + first)
                    if file.readinto(target) != target.nbytes:
                        raise FileFormatError(f"{self.path} was shortened while it was read.")
        except OSError as error:
            raise StoreError(f"{self.path} cannot be read: {error.strerror or error}.") from error
        return block.reshape(N, S, -1, 3)
