"""Fixtures for all tests: seeded randomness, test data, the two faces."""

import os
import tempfile
import zlib
from pathlib import Path

import numpy as np
import pytest
from PIL import Image


def pytest_addoption(parser):
    parser.addoption("--update-golden", action="store_true", help="renew the golden pictures; commit them on their own")


@pytest.fixture
def golden(request):
    """Compare a picture with tests/golden/NAME.png; on failure leave the picture and the difference in a folder."""

    def compare(name, picture, mean=1.0, most=40):
        assert max(picture.shape[:2]) <= 256
        path = Path(__file__).parent / "golden" / f"{name}.png"
        if request.config.getoption("--update-golden"):
            path.parent.mkdir(exist_ok=True)
            Image.fromarray(picture).save(path)
        expected = np.asarray(Image.open(path).convert("RGB"))
        assert picture.shape == expected.shape
        difference = np.abs(picture.astype(int) - expected)
        # a pixel on an edge may change side on another processor: the largest 0.1 % are left out of `most`
        worst = np.partition(difference.ravel(), -1 - difference.size // 1000)[-1 - difference.size // 1000]
        if difference.mean() > mean or worst > most:
            folder = Path(os.environ.get("FACEWRIGHT_ARTIFACTS", tempfile.gettempdir())) / "facewright-golden"
            folder.mkdir(parents=True, exist_ok=True)
            Image.fromarray(picture).save(folder / f"{name}.png")
            Image.fromarray(np.clip(difference * 4, 0, 255).astype(np.uint8)).save(folder / f"{name}.difference.png")
            pytest.fail(f"{name} differs by {difference.mean():.2f} (mean) and {worst} (most); see {folder}")

    return compare


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
