"""Facts and sheets of recordings."""

import json

import numpy as np
import pytest
from PIL import Image

from facewright.apps.show_capture import ShowCaptureRequest, depth_picture, show_capture
from facewright.camera.pinhole import Intrinsics
from facewright.capture.frame import RGBDFrame
from facewright.capture.tum_writer import write_tum_recording
from facewright.errors import FileFormatError, ValueRangeError

SIZE = (30, 40)


@pytest.fixture
def folder(tmp_path):
    """Eleven frames; half of the pixels have depth, in the last a tenth."""

    def frames():
        for i in range(11):
            depth = np.full(SIZE, 600.0 + i, np.float32)
            depth[:, 20 if i < 10 else 4 :] = 0
            yield RGBDFrame(np.full((*SIZE, 3), 10 * i, np.uint8), depth, Intrinsics(40, 41, 19.5, 14.5), 2 + i / 30)

    write_tum_recording(tmp_path / "smile", frames())
    return tmp_path / "smile"


def test_facts(folder):
    facts = show_capture(ShowCaptureRequest(folder))
    json.dumps(facts)
    assert facts["kind"] == "tum" and facts["frames"] == 11 and (facts["width"], facts["height"]) == (40, 30)
    assert facts["seconds"] == pytest.approx(10 / 30)
    assert facts["nearest_mm"] == pytest.approx(605, abs=0.2)
    assert facts["depth_share"] == pytest.approx((10 * 0.5 + 0.1) / 11)
    assert facts["depth_share_least"] == pytest.approx(0.1)
    assert facts["warnings"] == [] and "picture" not in facts


def test_sheet(folder, tmp_path):
    seen = []
    request = ShowCaptureRequest(folder, tmp_path / "sheet.png", n_frames=8)
    facts = show_capture(request, lambda *step: seen.append(step))
    assert facts["picture"] == str(tmp_path / "sheet.png") and seen[-1] == ("reading frames", 11, 11)
    sheet = np.asarray(Image.open(tmp_path / "sheet.png"))
    assert sheet.shape == (2 * (480 + 6 + 22) + 6, 4 * (320 + 6) + 6, 3)  # eight in two rows
    first = sheet[6:246, 6:326]
    assert (first == 0).all()  # colour of frame 0
    depth = sheet[246:486, 6:326]
    assert depth[:, :150].min() > 20 and (depth[:, 170:] == 0).all()


def test_turns_are_noted_where_that_is_asked(folder):
    assert show_capture(ShowCaptureRequest(folder, quarter_turns=3))["width"] == 30
    assert show_capture(ShowCaptureRequest(folder))["width"] == 40
    show_capture(ShowCaptureRequest(folder, quarter_turns=3, save_turn=True))
    facts = show_capture(ShowCaptureRequest(folder))
    assert facts["width"] == 30 and facts["quarter_turns"] == 3


def test_damaged_frame_is_found_and_nothing_is_written(folder, tmp_path):
    picture = sorted((folder / "depth").iterdir())[7]
    picture.write_bytes(picture.read_bytes()[:80])
    with pytest.raises(FileFormatError, match="truncated"):
        show_capture(ShowCaptureRequest(folder, tmp_path / "sheet.png", quarter_turns=1, save_turn=True))
    assert not (tmp_path / "sheet.png").exists()
    assert "quarter_turns" not in (folder / "camera.json").read_text()


def test_requests_are_checked(folder):
    with pytest.raises(ValueRangeError, match="n_frames"):
        ShowCaptureRequest(folder, n_frames=0)
    with pytest.raises(ValueRangeError, match="save_turn"):
        ShowCaptureRequest(folder, save_turn=True)


def test_near_is_light_and_none_is_black():
    picture = depth_picture(np.array([[0.0, 500.0, 600.0, 849.0, 5000.0]]), 500.0, 850.0).sum(axis=2)[0]
    assert picture[0] == 0 and picture[1] > picture[2] > picture[3] > picture[0]
    assert picture[4] > 0
