"""N-mode SVD of a face tensor: ours beside its arithmetic limit and TensorLy, in one run.

python -m benchmarks.nmode_svd [--quick] [--people 150] [--vertices 11248] [--no-tensorly] [--repeats 3]

The tensor is random with a face-like spectrum (timing does not depend on what it holds). At the default size TensorLy
takes minutes and 8 GB; --quick takes 30 people, and seconds.
"""

from __future__ import annotations

import argparse

import numpy as np

from benchmarks.common import has_peer
from facewright.evaluation.nmode_timing import (
    gram_layout_seconds,
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
    parser.add_argument("--quick", action="store_true", help="30 people, one repeat")
    parser.add_argument("--people", type=int)
    parser.add_argument("--shapes", type=int, default=47)
    parser.add_argument("--vertices", type=int, default=11248)
    parser.add_argument("--repeats", type=int)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--no-tensorly", action="store_true")
    options = parser.parse_args()
    people = options.people or (30 if options.quick else 150)
    repeats = options.repeats or (1 if options.quick else 3)
    tensor = make_tensor(people, options.shapes, options.vertices, np.random.default_rng(options.seed))
    I, E = min(50, people), min(25, options.shapes)
    print(f"  tensor {tensor.shape}, {tensor.nbytes / 1e6:.0f} MB; kept {I} x {E}; times in seconds")

    for mode, name in enumerate(("identity", "expression")):
        for layout, seconds in gram_layout_seconds(tensor, mode).items():
            print(f"  {f'Gram of the {name} unfolding, {layout}':55s}{seconds:8.3f}")
    ours = time_nmode(tensor, I, E, repeats=repeats)
    print(f"  {'limit: the two Gram products':55s}{ours['gram_seconds']:8.3f}")
    print(
        f"  {'ours, in memory':55s}{ours['nmode_seconds']:8.3f}  {ours['extra_peak_mb']:.0f} MB extra, "
        f"ours/limit {ours['ratio_to_limit']:.2f}"
    )
    disk = time_out_of_core(tensor, I, E)
    print(f"  {'ours, from disk':55s}{disk['out_of_core_seconds']:8.3f}  {disk['peak_mb']:.0f} MB process", flush=True)
    if options.no_tensorly or not has_peer("tensorly"):
        return
    theirs = time_tensorly(tensor, I, E)
    print(
        f"  {'TensorLy partial_tucker':55s}{theirs['tensorly_seconds']:8.3f}  "
        f"{theirs['tensorly_extra_peak_mb']:.0f} MB extra, its error {theirs['tensorly_error_ratio']:.4f} of ours, "
        f"ours/peer {ours['nmode_seconds'] / theirs['tensorly_seconds']:.3f}"
    )


if __name__ == "__main__":
    main()
