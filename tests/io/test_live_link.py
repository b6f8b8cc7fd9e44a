"""Face curves as text: the real recording, other spellings, and what must be refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from facewright.errors import FileFormatError, StoreError, ValueRangeError
from facewright.io.live_link import (
    ANGLE_COLUMNS,
    CURVE_COLUMNS,
    SHAPE_COLUMNS,
    FaceCurves,
    read_face_curves,
    write_live_link,
)
from facewright.io.timecode import timecode

HEADER = ",".join(("Timecode", "BlendShapeCount", *CURVE_COLUMNS))


def row(time: str, value: float = 0.25, angle: float = 0.1) -> str:
    return ",".join([time, "61", *[f"{value}"] * len(SHAPE_COLUMNS), *[f"{angle}"] * len(ANGLE_COLUMNS)])


def written(folder: Path, *lines: str, encoding: str = "utf-8") -> Path:
    path = folder / "curves.csv"
    path.write_text("\n".join(lines) + "\n", encoding=encoding)
    return path


def test_real_recording(test_data: Path) -> None:
    curves = read_face_curves(test_data / "curves" / "alex_rom_3.csv")
    assert curves.values.shape == (4030, 61)
    assert curves.tracked.all()
    assert curves.times[0] == 0
    # 13:13:04:31.652 to 13:15:18:54.561 on a base of 60.
    assert curves.times[-1] == pytest.approx(134.38, abs=0.02)
    assert np.mean(np.abs(np.diff(curves.times) - 1 / 30) < 1e-3) > 0.999  # three rows were dropped by the app
    assert len(curves.notes) == 1 and "clipped" in curves.notes[0] and "EyeLookInRight" in curves.notes[0]


def test_signs_of_the_eyes_are_those_of_the_real_recording(test_data: Path) -> None:
    curves = read_face_curves(test_data / "curves" / "alex_rom_3.csv")

    def follows(angle: str, shape: str) -> float:
        return float(np.corrcoef(curves.column(angle), curves.column(shape))[0, 1])

    assert follows("LeftEyeYaw", "EyeLookInLeft") > 0.6 > -0.6 > follows("LeftEyeYaw", "EyeLookOutLeft")
    assert follows("RightEyeYaw", "EyeLookOutRight") > 0.6 > -0.6 > follows("RightEyeYaw", "EyeLookInRight")
    assert follows("LeftEyePitch", "EyeLookDownLeft") > 0.6 > -0.6 > follows("LeftEyePitch", "EyeLookUpLeft")


def test_written_recording_reads_the_same(tmp_path: Path, rng: np.random.Generator) -> None:
    values = rng.uniform(0, 1, (7, 61))
    values[:, len(SHAPE_COLUMNS) :] -= 0.5
    tracked = np.array([True, True, False, True, False, True, True])
    values[~tracked] = 0
    curves = FaceCurves(np.arange(7) / 29.97, values, tracked)
    write_live_link(tmp_path / "a.csv", curves)
    lines = (tmp_path / "a.csv").read_text().splitlines()
    assert lines[0] == HEADER and lines[0].count(",") == 62
    assert lines[3].endswith(",0") and lines[3].count(",") == 1  # an untracked row ends at its count
    again = read_face_curves(tmp_path / "a.csv")
    np.testing.assert_allclose(again.values, values, atol=1e-9)
    np.testing.assert_allclose(again.times, curves.times, atol=1e-4)
    np.testing.assert_array_equal(again.tracked, tracked)
    assert "2 of 7 rows are untracked" in again.notes[0]


@pytest.mark.parametrize(
    "header, delimiter, encoding",
    [
        ("Timecode,BlendshapeCount,eyeBlinkLeft,jawOpen", ",", "utf-8"),
        ("timeCode;BlendShapeCount;eyeBlink_L;jaw_open", ";", "utf-8-sig"),
        ("time\tblendShapeCount\tblendShapes.EyeBlinkLeft\tblendShapes.JawOpen", "\t", "utf-16"),
        ('"Timestamp","Blend Shape Count","Eye Blink Left","Jaw Open"', ",", "utf-8"),
    ],
)
def test_other_spellings(tmp_path: Path, header: str, delimiter: str, encoding: str) -> None:
    rows = [delimiter.join(cells) for cells in (("0.0", "2", "0.5", "0.75"), ("0.5", "0"), ("1.0", "2", "0", "1"))]
    curves = read_face_curves(written(tmp_path, header, *rows, encoding=encoding))
    np.testing.assert_array_equal(curves.column("EyeBlinkLeft"), [0.5, 0, 0])
    np.testing.assert_array_equal(curves.column("JawOpen"), [0.75, 0, 1])
    np.testing.assert_array_equal(curves.tracked, [True, False, True])
    np.testing.assert_array_equal(curves.times, [0, 0.5, 1])
    assert any("50 of the 52 shapes are absent" in note for note in curves.notes)


def test_audio2face(tmp_path: Path) -> None:
    header = "timeCode," + ",".join(f"blendShapes.{name}" for name in SHAPE_COLUMNS) + ",extra"
    cells = ",".join(["0.1"] * len(SHAPE_COLUMNS))
    path = written(tmp_path, header, f"3.0,{cells},9", f"3.0333,{cells},9")
    curves = read_face_curves(path)
    assert curves.tracked.all()
    np.testing.assert_allclose(curves.times, [0, 0.0333])
    np.testing.assert_allclose(curves.values[:, :52], 0.1)
    assert "unknown and left out" in curves.notes[0] and "'extra'" in curves.notes[0]


@pytest.mark.parametrize("base", [24, 25, 30, 50, 60])
def test_base_of_the_time_code_is_found(tmp_path: Path, base: int) -> None:
    rows = [row(f"10:00:{k // base:02d}:{k % base:02d}.000") for k in range(0, 3 * base + 5, 1 if base < 50 else 2)]
    curves = read_face_curves(written(tmp_path, HEADER, *rows))
    np.testing.assert_allclose(np.diff(curves.times), (1 if base < 50 else 2) / base, atol=1e-9)


def test_times_pass_midnight_and_repeat(tmp_path: Path) -> None:
    rows = [row("23:59:59:58.000"), row("23:59:59:58.000", 0.9), row("00:00:00:00.000")]
    curves = read_face_curves(written(tmp_path, HEADER, *rows))
    np.testing.assert_allclose(curves.times, [0, 2 / 60], atol=1e-9)
    assert curves.values[0, 0] == 0.25
    assert "repeat the time" in curves.notes[0]


def test_frame_numbers_and_no_time(tmp_path: Path) -> None:
    numbered = read_face_curves(written(tmp_path, "frame,jawOpen", "7,0.1", "8,0.2", "9,0.3"), frames_per_second=25)
    np.testing.assert_allclose(numbered.times, [0, 0.04, 0.08])
    bare = read_face_curves(written(tmp_path, "jawOpen", "0.1", "0.2"))
    np.testing.assert_allclose(bare.times, [0, 1 / 30])
    assert any("no time" in note for note in bare.notes)


def test_values_outside_are_clipped_and_said(tmp_path: Path) -> None:
    curves = read_face_curves(written(tmp_path, HEADER, row("0", 1.02, -2.0), row("1.5", -0.01)))
    assert curves.values[0, 0] == 1 and curves.values[1, 0] == 0
    assert curves.column("HeadYaw")[0] == -2  # angles are not
    assert "104 values" in curves.notes[0] and "1.02" in curves.notes[0]


def test_cut_last_row_is_left_out(tmp_path: Path) -> None:
    curves = read_face_curves(written(tmp_path, HEADER, row("0"), row("1"), "2,61,0.5,0.2"))
    assert len(curves.times) == 2
    assert "line 4" in curves.notes[0]


@pytest.mark.parametrize(
    "lines, sentence",
    [
        ((), "empty"),
        ((HEADER,), "at least one row"),
        (("a,b,c", "1,2,3"), "names ARKit's shapes"),
        ((HEADER, row("0"), "1,61,0.5", row("2")), "line 3"),
        ((HEADER, row("0"), row("1").replace("0.25", "x", 1)), "got 'x' for EyeBlinkLeft in line 3"),
        ((HEADER, row("0"), row("1").replace("0.25", "nan", 1)), "must hold numbers"),
        ((HEADER, row("5"), row("1")), "increase"),
        ((HEADER, row("soon")), "got 'soon' in line 2"),
        ((HEADER + ",eyeBlink_L", row("0") + ",1"), "once"),
    ],
)
def test_refused(tmp_path: Path, lines: tuple[str, ...], sentence: str) -> None:
    with pytest.raises(FileFormatError, match=sentence):
        read_face_curves(written(tmp_path, *lines))


def test_foreign_files_are_refused(tmp_path: Path, rng: np.random.Generator) -> None:
    with pytest.raises(StoreError):
        read_face_curves(tmp_path / "none.csv")
    with pytest.raises(StoreError):
        read_face_curves(tmp_path)
    (tmp_path / "a.csv").write_bytes(rng.bytes(4000))
    with pytest.raises(FileFormatError):
        read_face_curves(tmp_path / "a.csv")


def test_curves_out_of_range_are_refused() -> None:
    with pytest.raises(ValueRangeError, match=r"\[0, 1\]"):
        FaceCurves(np.zeros(1), np.full((1, 61), 1.5), np.ones(1, bool))
    with pytest.raises(ValueRangeError, match="increase"):
        FaceCurves(np.zeros(2), np.zeros((2, 61)), np.ones(2, bool))


@settings(max_examples=60, deadline=None)
@given(st.binary(max_size=300))
def test_any_bytes_are_read_or_refused_by_a_sentence(tmp_path_factory: pytest.TempPathFactory, data: bytes) -> None:
    path = tmp_path_factory.mktemp("fuzz") / "f.csv"
    path.write_bytes(HEADER.encode() + b"\n" + data)
    try:
        read_face_curves(path)
    except FileFormatError as error:
        assert str(error).endswith(".")


@given(st.floats(0, 90_000))
def test_time_code_keeps_a_hundred_thousandth_second(seconds: float) -> None:
    hours, minutes, whole, frames = timecode(seconds).split(":")
    assert 3600 * int(hours) + 60 * int(minutes) + int(whole) + float(frames) / 60 == pytest.approx(seconds, abs=1e-5)
