"""The demo's posing: picture and animation are written, and the region-based model keeps what was not pulled."""

import numpy as np
import pytest
from PIL import Image

from facewright.apps.demo_posing import PULLS, draw_posing


@pytest.mark.slow
def test_picture_and_animation(builtin_face, tmp_path):
    stages = []
    made = draw_posing(tmp_path, builtin_face, lambda stage, done, total: stages.append((stage, done, total)))
    assert made.n_regions > 3
    assert made.n_frames > 60
    assert ("posing", len(PULLS), len(PULLS)) in stages
    assert (tmp_path / "posed.glb").read_bytes()[:4] == b"glTF"
    sheet = np.asarray(Image.open(tmp_path / "posing.png").convert("L")).astype(float)
    half = len(sheet) // 2
    for row, least, most in ((0, 0.0, 5.0), (half, 8.0, 255.0)):  # the right eye stays open above, and not below
        rest, winking = (sheet[row + 80 : row + 110, start + 40 : start + 110] for start in (6, 6 + 2 * 256))
        assert least <= np.abs(rest - winking).mean() < most
