"""Importing is quick and pulls nothing heavy; the public names stay."""

import importlib
import inspect
import pkgutil
import resource
import subprocess
import sys
from pathlib import Path

import pytest

import facewright

HEAVY = {
    "mediapipe",
    "cv2",
    "jax",
    "matplotlib",
    "trimesh",
    "pygltflib",
    "scipy",
    "numba",
    "skimage",
    "PIL",
    "rich",
    "typer",
}
LATE = {"mediapipe", "cv2", "jax", "matplotlib", "trimesh", "pygltflib"}  # not even by a module of ours
SURFACE = Path(__file__).parent / "api_surface.txt"


def _modules():
    return sorted(m.name for m in pkgutil.walk_packages(facewright.__path__, "facewright."))


def _cpu_seconds(*command):
    """CPU time of a process, the least of three: not disturbed by what else the machine does."""
    times = []
    for _ in range(3):
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        subprocess.run(command, check=True, capture_output=True, timeout=120)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        times.append(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
    return min(times)


def _loaded(statement):
    code = f"{statement}\nimport sys\nprint(*sorted({{m.partition('.')[0] for m in sys.modules}}))"
    return set(subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout.split())


def test_import_facewright_is_quick_and_light():
    assert _cpu_seconds(sys.executable, "-c", "import facewright") < 0.5
    assert not _loaded("import facewright") & HEAVY


def test_help_is_quick_and_light():
    help_page = "import sys; sys.argv = ['facewright', '--help']; from facewright.cli.main import run; run()"
    assert _cpu_seconds(sys.executable, "-c", help_page) < 1.0
    assert not _loaded("import facewright.cli.main") & (HEAVY - {"rich", "typer"})


def test_no_module_loads_a_heavy_library_at_import():
    """Libraries that are slow to load are imported inside the functions that use them."""
    assert not _loaded("\n".join(f"import {name}" for name in _modules())) & LATE


@pytest.mark.parametrize("name", _modules())
def test_every_module_tells_its_purpose(name):
    module = importlib.import_module(name)
    assert module.__doc__ and len(module.__doc__.strip().splitlines()[0]) > 10, f"{name} has no docstring"


def _surface():
    """List module:name of every public function and class, where it is defined."""
    found = []
    for name in _modules():
        if any(part.startswith("_") for part in name.split(".")) or name.startswith("facewright.cli"):
            continue
        module = importlib.import_module(name)
        found += [
            f"{name}:{key}"
            for key, value in vars(module).items()
            if not key.startswith("_")
            and getattr(value, "__module__", None) == name
            and (inspect.isclass(value) or callable(value))
        ]
    return sorted(found)


def test_no_public_name_vanishes():
    """A name that is renamed or removed must leave tests/api_surface.txt in the same change."""
    expected = SURFACE.read_text(encoding="utf-8").split()
    assert expected == sorted(set(expected))
    missing = sorted(set(expected) - set(_surface()))
    assert not missing, f"public names vanished: {', '.join(missing)}"


if __name__ == "__main__":  # python tests/test_imports.py renews the list
    SURFACE.write_text("\n".join(_surface()) + "\n", encoding="utf-8")
