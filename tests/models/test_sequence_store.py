"""A performer's data: checked, saved, loaded, refused when broken."""

from dataclasses import replace

import numpy as np
import pytest

from facewright.errors import FileFormatError, ShapeError, StoreError, ValueRangeError
from facewright.models.performer_data import PerformerClip, PerformerData
from facewright.models.sequence_store import load_performer, save_performer


@pytest.fixture
def data(rng):
    neutral = rng.normal(0, 50, (12, 3)).astype(np.float32)

    def clip(name, T):
        turn = np.linalg.qr(rng.normal(size=(T, 3, 3)))[0]
        turn *= np.sign(np.linalg.det(turn))[:, None, None]
        vertices = (neutral + rng.normal(0, 1, (T, 12, 3))).astype(np.float32)
        return PerformerClip(name, np.arange(T) / 30.0, vertices, turn, rng.normal(0, 9, (T, 3)))

    return PerformerData(
        name="M1",
        faces=rng.integers(0, 12, (20, 3)).astype(np.int32),
        neutral=neutral,
        reference=neutral * np.float32(0.9),
        clips=(clip("a", 4), clip("b", 1)),
        template="builtin",
        vertex_ids=np.arange(5, 17, dtype=np.int32),
        mirror=np.arange(12, dtype=np.int32)[::-1].copy(),
        statistics={"markers": 40, "clips": {"a": {"filled": 3}}},
    )


@pytest.mark.parametrize("mirrored", [True, False])
def test_round_trip(tmp_path, data, mirrored):
    if not mirrored:
        data = replace(data, mirror=None)
    save_performer(data, tmp_path / "a.fwms")
    back = load_performer(tmp_path / "a.fwms")
    for name in ("faces", "neutral", "reference", "vertex_ids"):
        assert np.array_equal(getattr(back, name), getattr(data, name))
        assert getattr(back, name).dtype == getattr(data, name).dtype
    assert (back.mirror is None) == (not mirrored)
    assert back.statistics == data.statistics and (back.name, back.template) == ("M1", "builtin")
    for one, other in zip(back.clips, data.clips, strict=True):
        assert one.name == other.name
        for name in ("times", "vertices", "rotations", "translations"):
            assert np.array_equal(getattr(one, name), getattr(other, name))


def test_what_it_gives(data):
    assert data.n_vertices == 12 and data.clip_names == ("a", "b")
    assert data.frames().shape == (5, 12, 3) and data.frames("b").shape == (1, 12, 3)
    assert np.array_equal(data.displacements("a"), data.clip("a").vertices - data.neutral)
    assert data.sequence("a").n_frames == 4
    a = data.clip("a")
    assert np.allclose(a.recorded()[2], a.vertices[2].astype(float) @ a.rotations[2].T + a.translations[2])
    with pytest.raises(ValueRangeError, match="clip must be one of a, b"):
        data.clip("c")


def test_broken_files_are_refused(tmp_path, data):
    path = tmp_path / "a.fwms"
    save_performer(data, path)
    whole = path.read_bytes()
    path.write_bytes(whole[:-7])
    with pytest.raises(FileFormatError, match="truncated"):
        load_performer(path)
    path.write_bytes(whole[:-7] + b"1234567")
    with pytest.raises(FileFormatError, match="corrupt"):
        load_performer(path)
    path.write_bytes(b"\x80\x04 pickle")
    with pytest.raises(FileFormatError, match="pickle"):
        load_performer(path)
    with pytest.raises(StoreError):
        load_performer(tmp_path / "none.fwms")
    with pytest.raises(ValueRangeError, match="JSON"):
        save_performer(replace(data, statistics={"a": object()}), path)


def test_data_that_do_not_fit_are_refused(data):
    with pytest.raises(ValueRangeError, match="different names"):
        replace(data, clips=(data.clips[0], data.clips[0]))
    with pytest.raises(ShapeError):
        replace(data, reference=data.reference[:-1])
    with pytest.raises(ValueRangeError):
        replace(data, faces=data.faces + 12)
    with pytest.raises(ValueRangeError):
        replace(data, mirror=data.mirror - 1)
    with pytest.raises(ShapeError):
        replace(data, clips=(replace(data.clips[0], vertices=data.clips[0].vertices[:, :5]),))
    with pytest.raises(ValueRangeError, match="increase"):
        replace(data.clips[0], times=np.zeros(4))
    with pytest.raises(ValueRangeError, match="finite"):
        replace(data.clips[1], vertices=np.full((1, 12, 3), np.nan, np.float32))
