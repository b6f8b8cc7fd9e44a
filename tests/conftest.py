"""Fixtures for all tests: seeded randomness, test data, the two faces."""

import os
import zlib
from pathlib import Path

import numpy as np
import pytest


@pytest.fixture
def rng(request):
    """A generator whose seed depends on the test's name (or FACEWRIGHT_SEED) and is printed on failure."""
    seed = int(os.environ.get("FACEWRIGHT_SEED", zlib.crc32(request.node.nodeid.encode())))
    print(f"rng seed {seed} (repeat with FACEWRIGHT_SEED={seed})")  # noqa: T201  pytest shows it on failure
    return np.random.default_rng(seed)


@pytest.fixture(scope="session")
def test_data():
    """Folder of real inputs; tests that need it skip where it is absent."""
    folder = os.environ.get("FACEWRIGHT_TEST_DATA", "")
    if not folder or not Path(folder).is_dir():
        pytest.skip("needs real test data: set FACEWRIGHT_TEST_DATA to the folder")
    return Path(folder)


@pytest.fixture(scope="session")
def ict_face():
    """The ICT-FaceKit face: from the test data where present, else as installed by the user."""
    from facewright.errors import MissingFaceError
    from facewright.faces import load_face

    compact = Path(os.environ.get("FACEWRIGHT_TEST_DATA", "") or "/nonexistent") / "ict_facekit.npz"
    try:
        return load_face(compact if compact.is_file() else "ict")
    except MissingFaceError:
        pytest.skip("needs ICT-FaceKit: `facewright faces install ict`, or FACEWRIGHT_TEST_DATA with ict_facekit.npz")


@pytest.fixture(scope="session")
def builtin_face():
    """The face that comes with the package."""
    from facewright.faces import load_face

    return load_face("builtin")
