"""Decompose a database of generated people in a fresh process and measure that process's memory.

Run as ``python -m facewright.evaluation.database_svd STORE I E``; writes one line of JSON.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from facewright.errors import FacewrightError, StoreError
from facewright.evaluation.peak_memory import highest_resident_mb, resident_mb
from facewright.faces.face import Face

Progress = Callable[[str, int, int], None]

_BYTES = 4  # of a coordinate in the store, hardly compressible
_N_SHAPES = 47
_REFERENCE_PEOPLE = 8


def measure_database_svd(
    face: Face, people: int, seed: int, components: tuple[int, int], folder: Path, progress: Progress | None = None
) -> dict[str, float]:
    """Fill a database with generated people, decompose it in a new process, remove it.

    Returns
    -------
    dict
        `svd_extra_peak_mb_<people>`, `svd_seconds_<people>`, and `svd_must_hold_mb`: core and projected tensor.

    Raises
    ------
    StoreError
        If the disk has not enough room.
    FacewrightError
        If the process fails; the message ends with its last line.
    """
    store = folder / f"generated-{people}.zarr"
    needed = 1.1 * people * _N_SHAPES * face.topology.n_vertices * 3 * _BYTES
    free = shutil.disk_usage(folder).free
    if free < needed:
        raise StoreError(f"{folder} must have {needed / 1e9:.1f} GB free for {people} people, got {free / 1e9:.1f}.")
    fill(store, face, people, seed, progress)
    n_identity, n_expression = min(components[0], people), components[1]
    command = [sys.executable, "-m", __name__, str(store), str(n_identity), str(n_expression)]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    if result.returncode:
        last = (result.stderr.strip().splitlines() or ["no message"])[-1]
        raise FacewrightError(f"the decomposition of {people} people failed: {last}")
    figures = json.loads(result.stdout)
    shutil.rmtree(store)
    projected = n_identity * _N_SHAPES * face.topology.n_vertices * 3 * 4
    return {
        f"svd_extra_peak_mb_{people}": figures["peak_mb"] - figures["before_mb"],
        f"svd_seconds_{people}": figures["seconds"],
        "svd_must_hold_mb": projected / 1e6,
    }


def fill(store: Path, face: Face, people: int, seed: int, progress: Progress | None = None) -> None:
    """Make a database of generated people; they are written by two threads, which compression and the disk allow."""
    from concurrent.futures import ThreadPoolExecutor

    from facewright.warehouse.generated import GeneratedSubjects
    from facewright.warehouse.store import Warehouse

    warehouse = Warehouse.create(store, face)
    generated = GeneratedSubjects(face, people, seed)

    def write(number: int) -> None:
        warehouse.write_subject(generated.subject(number))

    with ThreadPoolExecutor(2) as pool:
        for done, _ in enumerate(pool.map(write, range(people)), start=1):
            if progress is not None:
                progress(f"generating {people} people", done, people)


def svd_reference_error(face: Face, seed: int) -> float:
    """Return the largest relative difference of singular values to LAPACK's, for a small database in memory."""
    from facewright.models.nmode_svd import nmode_svd
    from facewright.warehouse.dask_cluster import open_cluster
    from facewright.warehouse.generated import GeneratedSubjects
    from facewright.warehouse.gram_blocks import BlockedTensor

    generated = GeneratedSubjects(face, _REFERENCE_PEOPLE, seed)
    tensor = np.stack([generated.shapes(number) for number in range(_REFERENCE_PEOPLE)])
    with open_cluster() as cluster:
        svd = nmode_svd(BlockedTensor(tensor, cluster, 8.0), _REFERENCE_PEOPLE, 1, precision="double")
    flat = tensor.reshape(_REFERENCE_PEOPLE, -1).astype(np.float64)
    expected = np.linalg.svd(flat, compute_uv=False)
    return float(np.max(np.abs(svd.identity_singular_values / expected - 1)))


def main(arguments: list[str]) -> None:
    """Decompose the store and write the figures."""
    from facewright.models.nmode_svd import nmode_svd
    from facewright.warehouse.dask_cluster import open_cluster
    from facewright.warehouse.gram_blocks import BlockedTensor
    from facewright.warehouse.store import Warehouse

    path, n_identity, n_expression = arguments
    with open_cluster() as cluster:
        tensor = BlockedTensor(Warehouse.open(path).blendshape_tensor(), cluster)
        tensor.tensor[0:1, :, 0:1]  # loads the libraries that read the store
        before = resident_mb()
        start = time.perf_counter()
        nmode_svd(tensor, int(n_identity), int(n_expression))
        seconds = time.perf_counter() - start
    figures = {"peak_mb": highest_resident_mb(), "before_mb": before, "seconds": seconds}
    sys.stdout.write(json.dumps(figures) + "\n")


if __name__ == "__main__":
    main(sys.argv[1:])
