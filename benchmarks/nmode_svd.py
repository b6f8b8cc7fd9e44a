"""N-mode SVD of a face tensor: ours beside its arithmetic limit and TensorLy, in one run.

python benchmarks/nmode_svd.py [--people 150] [--vertices 11248] [--no-tensorly] [--repeats 3]

The tensor is random with a face-like spectrum (timing does not depend on what it holds). At the default size TensorLy
takes minutes and 8 GB; with --people 30 everything takes seconds.
"""

from __future__ import annotations

import argparse
import os
import platform

import numpy as np

from facewright.evaluation.nmode_timing import (
    gram_layout_seconds,
    has_tensorly,
    time_nmode,
    time_out_of_core,
    time_tensorly,
)


def make_tensor(n_people: int, n_shapes: int, n_vertices: int, rng: np.random.Generator) -> np.ndarray:
    """Mean, identity, expression and their product, with detail; filled person by person."""
    mean = 50 * rng.standard_normal((n_vertices, 3), dtype=np.float32)
    identity = rng.standard_normal((100, n_vertices * 3), dtype=np.float32)
    identity *= (3 * 0.96 ** np.arange(100, dtype=np.float32))[:, None]
    expression = rng.standard_normal((n_shapes, n_vertices, 3), dtype=np.float32)
    expression[0] = 0
    tensor = np.empty((n_people, n_shapes, n_vertices, 3), dtype=np.float32)
    for person in tensor:
        neutral = mean + (rng.standard_normal(100, dtype=np.float32) @ identity).reshape(-1, 3)
        amplitude = rng.uniform(0.7, 1.2, size=(n_shapes, 1, 1)).astype(np.float32)
        np.add(neutral, amplitude * expression, out=person)
        person += 0.1 * rng.standard_normal(person.shape, dtype=np.float32)
    return tensor


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--people", type=int, default=150)
    parser.add_argument("--shapes", type=int, default=47)
    parser.add_argument("--vertices", type=int, default=11248)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--no-tensorly", action="store_true")
    options = parser.parse_args()

    print(f"{platform.processor() or platform.machine()}, {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}")
    print(f"NumPy {np.__version__}, Python {platform.python_version()}")
    tensor = make_tensor(options.people, options.shapes, options.vertices, np.random.default_rng(options.seed))
    I, E = min(50, options.people), min(25, options.shapes)
    print(f"tensor {tensor.shape}, {tensor.nbytes / 1e6:.0f} MB; kept {I} x {E}")

    for mode, name in enumerate(("identity", "expression")):
        for layout, seconds in gram_layout_seconds(tensor, mode).items():
            print(f"  Gram of the {name} unfolding, {layout:24s} {seconds:8.3f} s")
    ours = time_nmode(tensor, I, E, repeats=options.repeats)
    print(f"ours, in memory               {ours['nmode_seconds']:8.3f} s, {ours['extra_peak_mb']:6.0f} MB extra")
    print(f"limit: the two Gram products  {ours['gram_seconds']:8.3f} s")
    print(f"ratio to limit                {ours['ratio_to_limit']:8.2f}")
    disk = time_out_of_core(tensor, I, E)
    print(f"ours, from disk               {disk['out_of_core_seconds']:8.3f} s, {disk['peak_mb']:6.0f} MB process")
    if options.no_tensorly or not has_tensorly():
        print("TensorLy: not run (pip install tensorly)" if not has_tensorly() else "TensorLy: not run")
        return
    theirs = time_tensorly(tensor, I, E)
    print(
        f"TensorLy partial_tucker       {theirs['tensorly_seconds']:8.3f} s, "
        f"{theirs['tensorly_extra_peak_mb']:6.0f} MB extra, error {theirs['tensorly_error_ratio']:.4f} of ours"
    )
    print(f"TensorLy / ours               {theirs['tensorly_seconds'] / ours['nmode_seconds']:8.1f}")


if __name__ == "__main__":
    main()
