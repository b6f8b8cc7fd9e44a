"""The blendshapes of many people as one tensor that is read by blocks of vertices."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from facewright.errors import FileFormatError, StoreError
from facewright.warehouse.arrays import REMEDY, checked_description, import_zarr, shard_name
from facewright.warehouse.layout import BLOCK_VERTICES, array_chunks

if TYPE_CHECKING:
    from facewright.warehouse.entry import SubjectEntry
    from facewright.warehouse.objects import Objects

_LARGEST_SHARD = 2**40
_BATCH = 64  # subjects read at once: what a remote store answers at the same time


class BlendshapeTensor:
    """Blendshapes (N, 47, V, 3) of N subjects in a warehouse, float32, millimetres, read where they are asked for.

    Give it to `nmode_svd` or `fit_bilinear` as their tensor. Memory is that of the block asked for, and of one block of
    128 vertices where the blocks asked for, one after the other, end within one; blocks of a multiple of
    `block_vertices` avoid even that. Each chunk's checksum is looked at. The subjects are those at the time
    it was made: if one is written again meanwhile, reading it is refused. It can be pickled and sent to workers.

    Parameters
    ----------
    objects : Objects
        Of the store.
    entries : sequence of SubjectEntry
        The subjects, each with blendshapes of one shape.
    """

    block_vertices = BLOCK_VERTICES
    dtype = np.dtype(np.float32)

    def __init__(self, objects: Objects, entries: Sequence[SubjectEntry]) -> None:
        self._objects = objects
        self.names = tuple(entry.name for entry in entries)
        self._keys = [f"{entry.folder}/blendshapes/{shard_name(3)}" for entry in entries]
        shape, _, _ = checked_description(entries[0].arrays["blendshapes"], f"blendshapes of {self.names[0]!r}")
        self.shape: tuple[int, int, int, int] = (len(entries), shape[0], shape[1], shape[2])
        self._chunk = array_chunks("blendshapes", shape)[1]
        self._indices: NDArray[np.uint64] | None = None  # (N, chunks, 2): start and size of each chunk in its shard
        self._kept: tuple[int, slice, NDArray[np.float32]] | None = None

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_kept": None, "_indices": None}  # small on the way to a worker

    def __len__(self) -> int:
        return self.shape[0]

    def __getitem__(self, index: tuple[slice, slice, slice]) -> NDArray[np.float32]:
        """Return ``self[m:n, :, a:b]``, (n - m, 47, b - a, 3), read from the store.

        Raises
        ------
        StoreError
            If the store cannot be read, or a subject was written again or removed meanwhile.
        FileFormatError
            If a chunk is missing or corrupt; the message names the subject.
        """
        N, S, V, _ = self.shape
        plain = isinstance(index, tuple) and len(index) == 3 and all(isinstance(axis, slice) for axis in index)
        if not plain or index[1] != slice(None) or any(axis.step not in (None, 1) for axis in index):
            raise IndexError("a tensor of a warehouse is read as tensor[m:n, :, a:b].")
        first, last, _ = index[0].indices(N)
        start, stop, _ = index[2].indices(V)
        people = slice(first, max(first, last))
        block = np.empty((people.stop - first, S, max(stop - start, 0), 3), dtype=np.float32)
        if not block.size:
            return block
        begin = start // self._chunk
        end = -(-stop // self._chunk)
        before = self._kept  # read once: several threads may share a tensor
        if before is not None and before[:2] == (begin, people):
            self._place(block, before[2], begin, start, stop)
            begin += 1
        straddles = stop % self._chunk != 0 and stop < V
        for number in range(begin, end):
            if number == end - 1 and straddles:  # the next block begins in this chunk: keep it
                self._kept = None
                kept = np.empty((len(block), S, self._chunk, 3), dtype=np.float32)
                self._read(kept, people, number, 0, self._chunk)
                self._kept = (number, people, kept)
                self._place(block, kept, number, start, stop)
            else:
                low = max(start - number * self._chunk, 0)
                high = min(stop - number * self._chunk, self._chunk)
                offset = number * self._chunk + low - start
                self._read(block[:, :, offset : offset + high - low], people, number, low, high)
        if not straddles:
            self._kept = None
        return block

    def _place(
        self, block: NDArray[np.float32], chunk: NDArray[np.float32], number: int, start: int, stop: int
    ) -> None:
        """Copy what `block`, of the vertices [start, stop), needs of a whole chunk."""
        base = number * self._chunk
        low, high = max(start, base), min(stop, base + self._chunk)
        block[:, :, low - start : high - start] = chunk[:, :, low - base : high - base]

    def _read(self, out: NDArray[np.float32], people: slice, number: int, low: int, high: int) -> None:
        """Read vertices [low, high) of chunk `number` of some people."""
        indices = self._load_indices()
        S = self.shape[1]
        for begin in range(people.start, people.stop, _BATCH):
            batch = range(begin, min(begin + _BATCH, people.stop))
            spans = [(int(indices[n, number, 0]), int(indices[n, number, 1])) for n in batch]
            parts = self._objects.get_ranges([(self._keys[n], at, at + size) for n, (at, size) in zip(batch, spans)])
            for n, part, (_, size) in zip(batch, parts, spans):
                if part is None or len(part) != size:
                    raise self._gone(n)
                values = self._decode(n, part, S * self._chunk * 3)
                out[n - people.start] = values.reshape(S, self._chunk, 3)[:, low:high]

    def _decode(self, n: int, part: bytes, size: int) -> NDArray[np.float32]:
        import google_crc32c
        from numcodecs.blosc import Blosc

        body, checksum = memoryview(part)[:-4], int.from_bytes(part[-4:], "little")
        if google_crc32c.value(bytes(body)) != checksum:
            raise self._corrupt(n)
        values = np.frombuffer(Blosc().decode(body), dtype="<f4")
        if values.size != size or not np.isfinite(values[:3]).all():
            raise self._corrupt(n)
        return values

    def _load_indices(self) -> NDArray[np.uint64]:
        """Read where in its shard each chunk of each person lies: the shards' last bytes."""
        if self._indices is not None:
            return self._indices
        import_zarr()  # tells what to install
        import google_crc32c

        n_chunks = -(-self.shape[2] // self._chunk)
        size = 16 * n_chunks + 4
        indices = np.empty((len(self), n_chunks, 2), dtype=np.uint64)
        for begin in range(0, len(self), _BATCH):
            batch = range(begin, min(begin + _BATCH, len(self)))
            for n, tail in zip(batch, self._objects.get_ranges([(self._keys[n], -size, 0) for n in batch])):
                if tail is None:
                    raise self._gone(n)
                if len(tail) != size or google_crc32c.value(tail[:-4]) != int.from_bytes(tail[-4:], "little"):
                    raise self._corrupt(n)
                indices[n] = np.frombuffer(tail, dtype="<u8", count=2 * n_chunks).reshape(n_chunks, 2)
                if indices[n].max() > _LARGEST_SHARD:  # a chunk that was never written says 2^64 - 1
                    raise self._corrupt(n)
        self._indices = indices
        return indices

    def _gone(self, n: int) -> StoreError | FileFormatError:
        """Tell apart a subject that was replaced from one that is damaged."""
        from facewright.warehouse.layout import group_content, subject_key

        name = self.names[n]
        document = self._objects.get([subject_key(name)])[0]
        token = None if document is None else group_content(document, self._objects.url).get("token")
        if f"/{token}/" in self._keys[n]:
            return FileFormatError(
                f"{self._objects.url}: blendshapes of subject {name!r} are missing or truncated; {REMEDY}"
            )
        return StoreError(
            f"{self._objects.url}: subject {name!r} was written again or removed while its blendshapes were read; "
            "start again."
        )

    def _corrupt(self, n: int) -> FileFormatError:
        return FileFormatError(
            f"{self._objects.url}: blendshapes of subject {self.names[n]!r} are corrupt: a chunk does not match its "
            f"checksum; {REMEDY}"
        )
