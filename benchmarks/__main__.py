"""Run the benchmarks one after another, each in a process of its own: python -m benchmarks [NAME ...] [--quick]."""

from __future__ import annotations

import argparse
import subprocess
import sys
import time
from pathlib import Path

from benchmarks.common import print_machine

BENCHMARKS = {
    "geometry": "closest points, geodesics, deformation transfer; peers: trimesh, Open3D",
    "rasteriser": "which triangle each pixel sees; peer: Open3D",
    "registration": "similarity of point pairs, and ICP of a scan; peer: trimesh",
    "sparse_solvers": "factor and solve the systems of this project; peers: SciPy, CHOLMOD, Pardiso",
    "photo_fit": "a face fitted to the landmarks of a photo; peer: eos",
    "nmode_svd": "N-mode SVD of a face tensor; its arithmetic limit; peer: TensorLy",
}


def main() -> int:
    epilog = "\n".join(f"  {name:16s}{what}" for name, what in BENCHMARKS.items())
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks",
        description="Time our code beside peers. The benchmarks, all of which run where none is named:",
        epilog=epilog,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("names", nargs="*", metavar="NAME", help="benchmarks to run")
    parser.add_argument("--quick", action="store_true", help="smaller sizes, fewer repeats; about three minutes")
    parser.add_argument("--list", action="store_true", help="list the benchmarks and stop")
    options = parser.parse_args()
    unknown = [name for name in options.names if name not in BENCHMARKS]
    if unknown:
        parser.error(f"NAME must be one of {', '.join(BENCHMARKS)}, got {unknown[0]}")
    if options.list:
        print(epilog)
        return 0
    print_machine()
    print("ours/peer below 1: ours is faster. Times in milliseconds.")
    failed = []
    for name in options.names or BENCHMARKS:
        print(f"\n{name}: {BENCHMARKS[name]}", flush=True)
        start = time.perf_counter()
        command = [sys.executable, "-m", f"benchmarks.{name}", *(["--quick"] if options.quick else [])]
        code = subprocess.run(command, cwd=Path(__file__).resolve().parent.parent, check=False).returncode
        print(f"  took {time.perf_counter() - start:.0f} s", flush=True)
        if code:
            print(f"  FAILED with exit code {code}", flush=True)
            failed.append(name)
    if failed:
        print(f"\nFAILED: {', '.join(failed)}")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
