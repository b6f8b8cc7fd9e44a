"""Build a bilinear core from a tensor on disk in a fresh process and measure that process's memory.

Run as ``python -m facewright.evaluation.out_of_core TENSOR.npy I E``; writes one line of JSON.
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from pathlib import Path

from facewright.errors import FacewrightError
from facewright.evaluation.peak_memory import highest_resident_mb, resident_mb
from facewright.models.nmode_svd import nmode_svd
from facewright.models.tensor_file import TensorFile


def measure_out_of_core(path: Path, n_identity: int, n_expression: int) -> dict[str, float]:
    """Return `peak_mb` (whole process), `import_mb` (before the work) and `seconds` of a run in a new process.

    Raises
    ------
    FacewrightError
        If that process fails; the message ends with its last line.
    """
    command = [sys.executable, "-m", "facewright.evaluation.out_of_core", str(path), str(n_identity), str(n_expression)]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    if result.returncode:
        last = (result.stderr.strip().splitlines() or ["no message"])[-1]
        raise FacewrightError(f"the out-of-core run failed: {last}")
    return json.loads(result.stdout)


def main(arguments: list[str]) -> None:
    """Decompose the file and write the figures."""
    path, n_identity, n_expression = arguments
    before = resident_mb()
    start = time.perf_counter()
    nmode_svd(TensorFile(path), int(n_identity), int(n_expression))
    seconds = time.perf_counter() - start
    figures = {"peak_mb": highest_resident_mb(), "import_mb": before, "seconds": seconds}
    sys.stdout.write(json.dumps(figures) + "\n")


if __name__ == "__main__":
    main(sys.argv[1:])
