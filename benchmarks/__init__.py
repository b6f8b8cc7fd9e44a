"""Our code beside peers from the package index, in one run: ``python -m benchmarks``."""
