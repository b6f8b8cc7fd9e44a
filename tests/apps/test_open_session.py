from dataclasses import replace

import numpy as np
import pytest

from facewright.apps.open_session import OpenSessionRequest, open_session
from facewright.apps.pose_session import PoseSession
from facewright.errors import FileFormatError, StoreError, ValueRangeError
from facewright.models.region_store import save_region_model


@pytest.fixture
def files(patch, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name, model in zip(("sheet.fwrm", "one.fwrm"), patch, strict=True):
        save_region_model(model, tmp_path / name)
    return tmp_path


def test_a_new_session_saves_beside_older_ones_and_an_old_one_goes_on(files):
    request = OpenSessionRequest(files / "sheet.fwrm", holistic=files / "one.fwrm", beta=2.0)
    first = open_session(request)
    assert first.character.name == "none" and first.title == "sheet.fwrm" and first.session.state.beta == 2.0
    first.session.drag(50, first.session.model.neutral[50] + [0, 5, 0])
    first.session.release()
    assert (files / "pose.fwpose").is_file()
    second = open_session(request)
    assert second.session.autosave.name == "pose-2.fwpose" and not second.session.coefficients().any()
    again = open_session(replace(request, file=files / "pose.fwpose", beta=0.5))
    np.testing.assert_array_equal(again.session.positions(), first.session.positions())
    assert again.session.state.beta == 2.0


def test_refuses(files, patch):
    with pytest.raises(FileFormatError, match="region model"):
        (files / "text.fwrm").write_text("hello")
        open_session(OpenSessionRequest(files / "text.fwrm"))
    with pytest.raises(StoreError):
        open_session(OpenSessionRequest(files / "none.fwrm"))
    with pytest.raises(StoreError, match="does not exist"):
        open_session(OpenSessionRequest(files / "sheet.fwrm", file=files / "no" / "x.fwpose"))
    with pytest.raises(ValueRangeError, match="one region"):
        open_session(OpenSessionRequest(files / "sheet.fwrm", holistic=files / "sheet.fwrm"))
    with pytest.raises(ValueRangeError, match="character"):
        open_session(OpenSessionRequest(files / "sheet.fwrm", "bob"))
    PoseSession(patch[1]).save(files / "other.fwpose")
    with pytest.raises(FileFormatError, match="another model"):
        open_session(OpenSessionRequest(files / "sheet.fwrm", file=files / "other.fwpose"))
