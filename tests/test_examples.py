"""Every example runs and leaves its pictures; the docs show no picture that an example does not make."""

import importlib.util
import inspect
import re
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

ROOT = Path(__file__).parents[1]
EXAMPLES = sorted((ROOT / "examples").glob("*/*.py"))
SLOW = {
    "bilinear_modes", "fit_astronaut", "captured_person", "fit_scan",
    "edit_astronaut", "transfer_astronaut", "animate_astronaut", "retarget_strip",
    "markers_to_regions", "wink_and_smirk", "beta_and_gamma", "keyframes",
}  # fmt: skip


def load(path):
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize(
    "path",
    [pytest.param(p, id=p.stem, marks=[pytest.mark.slow] if p.stem in SLOW else []) for p in EXAMPLES],
)
def test_example_runs(path, tmp_path):
    if "landmarks extra" in path.read_text():
        pytest.importorskip("mediapipe", reason="needs the landmarks extra")
    if "video extra" in path.read_text():
        pytest.importorskip("av", reason="needs the video extra")
    module = load(path)
    small = {"n_people": 6} if "n_people" in inspect.signature(module.main).parameters else {}
    module.main(tmp_path, **small)
    pictures = [*tmp_path.glob("*.png"), *tmp_path.glob("*.jpg")]
    assert pictures
    for picture in pictures:
        assert np.asarray(Image.open(picture).convert("L")).std() > 10, f"{picture.name} is nearly blank"


def test_pictures_in_the_docs_come_from_code():
    made = set()
    for script in [*EXAMPLES, *(ROOT / "tools").glob("*.py")]:
        made |= set(re.findall(r"([\w-]+\.(?:png|jpg))", script.read_text()))
    used = set()
    for page in [ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]:
        used |= {Path(link).name for link in re.findall(r"!\[[^\]]*\]\(([^)]+\.(?:png|jpg))\)", page.read_text())}
    assert used <= made, f"no code makes {sorted(used - made)}"
    shown = {p.name for p in (ROOT / "docs" / "images").iterdir()}
    assert shown <= made, f"no code makes {sorted(shown - made)}"
