"""Motion capture files: round trips, dialects of tables, units and axes, refusals."""

import struct

import numpy as np
import pytest

from facewright.errors import FileFormatError, StoreError, ValueRangeError
from facewright.io.marker_data import MarkerData
from facewright.io.marker_units import turned_up, unit_named
from facewright.io.markers import read_markers, write_markers


@pytest.fixture
def markers(rng):
    positions = rng.normal(0.0, 60.0, (7, 30, 3)) + [0.0, 1200.0, 50.0]
    positions[2:4, 5] = np.nan
    return MarkerData(np.arange(7) / 120.0, tuple(f"M{k:03d}" for k in range(30)), positions)


@pytest.mark.parametrize("suffix", [".c3d", ".trc", ".csv"])
def test_round_trip(tmp_path, markers, suffix):
    if suffix == ".c3d":
        pytest.importorskip("ezc3d")
    write_markers(tmp_path / f"a{suffix}", markers)
    back = read_markers(tmp_path / f"a{suffix}")
    assert back.markers.labels == markers.labels and back.unit == "mm" and back.notes == ()
    assert np.allclose(back.markers.times, markers.times, atol=1e-5)
    assert np.array_equal(back.markers.seen, markers.seen)
    assert np.nanmax(np.abs(back.markers.positions - markers.positions)) < 2e-3
    assert back.up == ("y" if suffix == ".c3d" else None)


def test_c3d_of_many_labels_and_truncated(tmp_path, rng):
    pytest.importorskip("ezc3d")
    many = MarkerData(np.arange(2) / 60.0, tuple(f"p{k}" for k in range(300)), rng.normal(0, 60, (2, 300, 3)))
    write_markers(tmp_path / "many.c3d", many)
    assert read_markers(tmp_path / "many.c3d").markers.labels == many.labels
    whole = (tmp_path / "many.c3d").read_bytes()
    for size in (0, 3, 500, 600, len(whole) // 2):  # the library itself would crash the process on some of these
        (tmp_path / "cut.c3d").write_bytes(whole[:size])
        with pytest.raises(FileFormatError, match=r"C3D|truncated"):
            read_markers(tmp_path / "cut.c3d")
    (tmp_path / "text.c3d").write_text("Time,a_X,a_Y,a_Z\n" * 200)
    with pytest.raises(FileFormatError, match="C3D"):
        read_markers(tmp_path / "text.c3d")
    with pytest.raises(StoreError):
        read_markers(tmp_path / "none.c3d")
    broken = bytearray(whole)
    broken[2:4] = struct.pack("<H", 60000)  # more points than the file can hold
    (tmp_path / "cut.c3d").write_bytes(broken)
    with pytest.raises(FileFormatError, match="truncated"):
        read_markers(tmp_path / "cut.c3d")


DIALECTS = {
    "underscore": "Time,L_X,L_Y,L_Z,R_X,R_Y,R_Z\n0.0,1,2,3,4,5,6\n0.01,1,2,3,,,\n",
    "dots and semicolons": "frame;time;L.x;L.y;L.z;R.x;R.y;R.z\n1;0.0;1;2;3;4;5;6\n2;0.01;1;2;3;NaN;NaN;NaN\n",
    "bare letters, tabs": "t\tLX\tLY\tLZ\tRX\tRY\tRZ\n0\t1\t2\t3\t4\t5\t6\n0.01\t1\t2\t3\t\t\t\n",
    "nexus": (
        "Trajectories\n100\n,,face:L,,,face:R,,\nFrame,Sub Frame,X,Y,Z,X,Y,Z\n,,mm,mm,mm,mm,mm,mm\n"
        "1,0,1,2,3,4,5,6\n2,0,1,2,3,,,\n"
    ),
    "motive": (
        "Format Version,1.23,Take Name,a,Export Frame Rate,100.0,Length Units,Millimeters\n\n"
        ",Type,Marker,Marker,Marker,Marker,Marker,Marker\n,Name,face:L,face:L,face:L,face:R,face:R,face:R\n"
        ",ID,1,1,1,2,2,2\n,,Position,Position,Position,Position,Position,Position\n"
        "Frame,Time (Seconds),X,Y,Z,X,Y,Z\n0,0.0,1,2,3,4,5,6\n1,0.01,1,2,3,,,\n"
    ),
    "units in brackets": "Time,L_X (mm),L_Y (mm),L_Z (mm),R_X (mm),R_Y (mm),R_Z (mm)\n0.0,1,2,3,4,5,6\n0.01,1,2,3,,,\n",
}


@pytest.mark.parametrize("name", DIALECTS)
def test_csv_dialects(tmp_path, name):
    (tmp_path / "a.csv").write_text(DIALECTS[name])
    unit = None if name in ("nexus", "motive", "units in brackets") else "mm"
    found = read_markers(tmp_path / "a.csv", unit=unit)
    assert found.markers.labels == ("L", "R") and found.unit == "mm"
    assert np.allclose(found.markers.times, [0.0, 0.01])
    assert found.markers.positions[0].tolist() == [[1, 2, 3], [4, 5, 6]]
    assert found.markers.seen.tolist() == [[True, True], [True, False]]


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("hello\nworld\n", "header"),
        ("", "header"),
        ("Time,L_X,L_Y,L_Z\n", "header"),
        ("frame,L_X,L_Y,L_Z\n1,1,2,3\n2,1,2,3\n", "times or state its frame rate"),
        ("Time,L_X,L_Y,L_Z\n0,1,2,3\n0,1,2,3\n", "increase"),
        ("Time,L_X,L_Y,L_Z\n0,,,\n1,,,\n", "seen"),
        ("Time,L_X,L_Y,L_Z\n0,1,2,3,4,5\n", "marker"),
    ],
)
def test_tables_that_are_none_are_refused(tmp_path, text, match):
    (tmp_path / "a.csv").write_text(text)
    if "4,5" in text:  # columns beyond the header are no markers and do no harm
        assert read_markers(tmp_path / "a.csv", unit="mm").markers.labels == ("L",)
        return
    with pytest.raises(FileFormatError, match=match):
        read_markers(tmp_path / "a.csv", unit="mm")


def test_trc_refusals(tmp_path, markers):
    write_markers(tmp_path / "a.trc", markers)
    lines = (tmp_path / "a.trc").read_text().splitlines()
    for change, match in (
        (lambda l: ["x", *l[1:]], "PathFileType"),
        (lambda l: l[:6], "at least one frame"),
        (lambda l: [*l[:7], l[7].replace("\t", "\tabc", 3), *l[8:]], "numbers"),
        (lambda l: [*l[:7], l[7] + "\t1.0\t2.0", *l[8:]], "columns"),
    ):
        (tmp_path / "b.trc").write_text("\n".join(change(lines)) + "\n")
        with pytest.raises(FileFormatError, match=match):
            read_markers(tmp_path / "b.trc")


def test_units_are_guessed_and_said(tmp_path, markers):
    for unit, factor in (("mm", 1.0), ("cm", 0.1), ("m", 0.001)):
        table = ["Time," + ",".join(f"{n}_{a}" for n in markers.labels for a in "XYZ")]
        for time, row in zip(markers.times, factor * markers.positions.reshape(7, -1)):
            table.append(",".join([f"{time:.6f}", *("" if v != v else f"{v:.7f}" for v in row)]))
        (tmp_path / "a.csv").write_text("\n".join(table))
        found = read_markers(tmp_path / "a.csv")
        assert found.unit == unit and "unit" in found.notes[0]
        assert np.nanmax(np.abs(found.markers.positions - markers.positions)) < 0.01
    with pytest.raises(ValueRangeError, match="unit"):
        read_markers(tmp_path / "a.csv", unit="ell")
    tiny = "Time,a_X,a_Y,a_Z,b_X,b_Y,b_Z\n0,0,0,0,1e-6,0,0\n"
    (tmp_path / "b.csv").write_text(tiny)
    with pytest.raises(ValueRangeError, match="unit"):
        read_markers(tmp_path / "b.csv")
    assert unit_named(" Meters ") == "m" and unit_named("[mm]") == "mm" and unit_named("furlong") is None


def test_up_becomes_y_by_a_rotation():
    axes = np.eye(3)
    for k, up in enumerate(("x", "y", "z", "-x", "-y", "-z")):
        turned = turned_up(axes, up)
        assert np.isclose(np.linalg.det(turned), 1.0)
        assert turned[k % 3].tolist() == [0.0, 1.0 if k < 3 else -1.0, 0.0]
    with pytest.raises(ValueRangeError, match="up"):
        turned_up(axes, "w")


def test_repeated_and_empty_labels(tmp_path):
    (tmp_path / "a.csv").write_text("Time,L_X,L_Y,L_Z,L_X,L_Y,L_Z,E_X,E_Y,E_Z\n0,1,2,3,50,60,70,,,\n")
    found = read_markers(tmp_path / "a.csv", unit="mm")
    assert found.markers.labels == ("L", "L#2") and len(found.notes) == 2
    with pytest.raises(FileFormatError, match="must be a marker file"):
        read_markers(tmp_path / "a.xyz")
    with pytest.raises(ValueRangeError, match="end in"):
        write_markers(tmp_path / "a.xyz", found.markers)
