"""The Python snippets of README and guides run as they stand, page by page, in an empty folder."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAGES = [
    p for p in [ROOT / "README.md", *sorted((ROOT / "docs" / "guides").glob("*.md"))] if "```python" in p.read_text()
]


@pytest.mark.slow
@pytest.mark.parametrize("page", [pytest.param(p, id=p.stem) for p in PAGES])
def test_snippets_run(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    if "apps.animate" in page.read_text():
        pytest.importorskip("av", reason="needs the video extra")
    if any("portrait.jpg" in snippet for snippet in re.findall(r"```python\n(.*?)```", page.read_text(), re.DOTALL)):
        pytest.importorskip("mediapipe", reason="needs the landmarks extra")
        _prepare_photo(tmp_path)
    names = {}
    for snippet in re.findall(r"```python\n(.*?)```", page.read_text(), re.DOTALL):
        exec(compile(snippet, str(page), "exec"), names)


def _prepare_photo(folder):
    from facewright.apps.build_model import BuildModelRequest, build_model
    from facewright.apps.demo import astronaut_portrait
    from facewright.io.image import write_image

    write_image(folder / "portrait.jpg", astronaut_portrait())
    build_model(BuildModelRequest(folder / "face.fwbm", n_people=6, n_identity=5, n_unseen=0))
