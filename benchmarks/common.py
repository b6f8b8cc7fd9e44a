"""What the benchmarks share: the face, timing, peers that may be missing, and the table."""

from __future__ import annotations

import argparse
import importlib.metadata
import importlib.util
import os
import platform
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from time import perf_counter

from facewright.errors import MissingFaceError
from facewright.faces import load_face
from facewright.faces.face import Face

#: Import name of each peer: what pip calls it.
PEERS = {
    "cholespy": "cholespy",
    "eos": "eos-py",
    "open3d": "open3d-cpu",
    "pypardiso": "pypardiso",
    "rtree": "rtree",
    "sksparse": "scikit-sparse",
    "tensorly": "tensorly",
    "trimesh": "trimesh",
}
_HEADS = ("what", "ours ms", "peer", "peer ms", "ours/peer", "same answer")


@dataclass
class Table:
    """Times of ours and of peers; `show` prints them with ratio ours/peer: below 1, ours is faster."""

    rows: list[tuple[str, ...]] = field(default_factory=list)

    def ours(self, what: str, ours_ms: float, note: str = "") -> None:
        """Add a time of ours that has no peer."""
        self.rows.append((what, _figure(ours_ms), "", "", "", note))

    def versus(self, what: str, ours_ms: float, peer: str, peer_ms: float, note: str = "") -> None:
        """Add a time of ours and a peer's for the same work; `note` says how far the answers differ."""
        self.rows.append((what, _figure(ours_ms), peer, _figure(peer_ms), _figure(ours_ms / peer_ms), note))

    def show(self) -> None:
        """Print the table."""
        rows = [_HEADS, *self.rows]
        widths = [max(len(row[k]) for row in rows) for k in range(len(_HEADS))]
        for row in rows:
            cells = [text.rjust(w) if k in (1, 3, 4) else text.ljust(w) for k, (text, w) in enumerate(zip(row, widths))]
            print("  " + "  ".join(cells).rstrip())


def has_peer(*modules: str) -> bool:
    """Tell whether a peer is installed, and print how to install it if not."""
    missing = [PEERS[module] for module in modules if importlib.util.find_spec(module) is None]
    if missing:
        print(f"  not compared: {', '.join(missing)} not installed: pip install {' '.join(missing)}")
    return not missing


def best_ms(work: Callable[[], object], repeats: int) -> float:
    """Return the shortest time of a call, after one that does not count: what else the machine does only adds to it."""
    work()
    times = []
    for _ in range(repeats):
        start = perf_counter()
        work()
        times.append(perf_counter() - start)
    return 1e3 * min(times)


def benchmark_face() -> Face:
    """Return the ICT face from FACEWRIGHT_TEST_DATA or the store, the built-in one where it is absent; print which."""
    compact = Path(os.environ.get("FACEWRIGHT_TEST_DATA", "") or "/nonexistent") / "ict_facekit.npz"
    why = ""
    try:
        face = load_face(compact if compact.is_file() else "ict")
    except MissingFaceError:
        face = load_face("builtin")
        why = " (ICT-FaceKit is not installed: facewright faces install ict)"
    skin = face.skin().topology
    print(f"  face: {face.name}, {skin.n_vertices} vertices, {len(skin.faces)} triangles{why}")
    return face


def print_machine() -> None:
    """Print what the figures depend on besides the code."""
    load = ", ".join(f"{part:.1f}" for part in os.getloadavg())
    print(f"machine: {_cpu_model()}, {os.cpu_count()} cores, load average {load}")
    names = ["numpy", "scipy", "numba", *PEERS.values()]
    versions = [f"{name} {version}" for name in names if (version := _version(name))]
    print(f"versions: Python {platform.python_version()}, {', '.join(versions)}")


def quick_from_command_line(description: str | None) -> bool:
    """Parse the options that every benchmark has."""
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="smaller sizes, fewer repeats")
    return bool(parser.parse_args().quick)


def _cpu_model() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        lines = []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()


def _version(package: str) -> str | None:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return None


def _figure(value: float) -> str:
    return f"{value:.0f}" if value >= 100 else f"{value:.3g}"
