import json

import numpy as np
import pytest

from facewright.errors import FileFormatError, ShapeError, StoreError, ValueRangeError
from facewright.io.points import read_points, write_points


def test_pts_are_one_based(tmp_path):
    (tmp_path / "a.pts").write_text("version: 1\nn_points:  2\n{\n1 1\n10.5 20.25\n}\n")
    np.testing.assert_array_equal(read_points(tmp_path / "a.pts").points, [[0, 0], [9.5, 19.25]])


@pytest.mark.parametrize("suffix", [".pts", ".json"])
def test_round_trip(tmp_path, rng, suffix):
    points = rng.uniform(0, 1000, (68, 2))
    write_points(tmp_path / f"a{suffix}", points)
    np.testing.assert_allclose(read_points(tmp_path / f"a{suffix}").points, points, atol=1e-6)


def test_null_marks_missing_points(tmp_path):
    content = {"format": "facewright landmarks", "version": 1, "points": [[1, 2], None, [3, 4]]}
    (tmp_path / "a.json").write_text(json.dumps(content))
    file = read_points(tmp_path / "a.json")
    np.testing.assert_array_equal(file.confidence, [1, 0, 1])
    assert np.isnan(file.points[1]).all()


@pytest.mark.parametrize("version", [1, 2, 3])
def test_ljson_has_y_before_x(tmp_path, version):
    flat = {"landmarks": {"points": [[2.0, 1.0], [None, None], [4.0, 3.0]]}, "version": version}
    nested = {"groups": {"PTS": {"landmarks": flat["landmarks"]}}, "version": 3}
    old = {"version": 1, "groups": [{"label": "all", "landmarks": [{"point": [2.0, 1.0]}, {"point": [4.0, 3.0]}]}]}
    (tmp_path / "a.ljson").write_text(json.dumps({1: old, 2: flat, 3: nested}[version]))
    file = read_points(tmp_path / "a.ljson")
    np.testing.assert_array_equal(file.points[file.confidence > 0], [[1, 2], [3, 4]])


def test_reads_a_real_3d_ljson(test_data):
    assert read_points(test_data / "scans" / "james.ljson").points.shape == (68, 3)


BAD = {
    "empty.pts": "",
    "truncated.pts": "version: 1\nn_points: 2\n{\n1 2\n",
    "count.pts": "version: 1\nn_points: 3\n{\n1 2\n3 4\n}\n",
    "nan.pts": "version: 1\nn_points: 2\n{\n1 2\nnan nan\n}\n",
    "inf.pts": "version: 1\nn_points: 1\n{\n1 inf\n}\n",
    "words.pts": "version: 1\nn_points: 1\n{\nleft right\n}\n",
    "columns.pts": "version: 1\nn_points: 1\n{\n1 2 3\n}\n",
    "ragged.pts": "version: 1\nn_points: 2\n{\n1 2\n3\n}\n",
    "version.pts": "version: 9\nn_points: 1\n{\n1 2\n}\n",
    "none.pts": "version: 1\nn_points: 0\n{\n}\n",
    "a.txt": "1 2",
    "cut.json": '{"format": "facewright landmarks", "ver',
    "foreign.json": '{"points": [[1, 2]]}',
    "list.json": "[1, 2]",
    "newer.json": '{"format": "facewright landmarks", "version": 2, "points": [[1, 2]]}',
    "nan.json": '{"format": "facewright landmarks", "version": 1, "points": [[1, NaN]]}',
    "deep.json": '{"format": "facewright landmarks", "version": 1, "points": [[[1], 2]]}',
    "nopoints.json": '{"format": "facewright landmarks", "version": 1}',
    "confidence.json": '{"format": "facewright landmarks", "version": 1, "points": [[1, 2]], "confidence": [2]}',
    "confidences.json": '{"format": "facewright landmarks", "version": 1, "points": [[1, 2]], "confidence": [1, 1]}',
    "scheme.json": '{"format": "facewright landmarks", "version": 1, "points": [[1, 2]], "scheme": 68}',
    "version.ljson": '{"version": 7}',
    "groups.ljson": '{"version": 3, "groups": {"a": {}, "b": {}}}',
    "none.ljson": '{"version": 2, "landmarks": {"points": []}}',
}


@pytest.mark.parametrize("name", BAD)
def test_refuses_bad_files_and_names_them(tmp_path, name):
    (tmp_path / name).write_text(BAD[name])
    with pytest.raises(FileFormatError, match=name):
        read_points(tmp_path / name)


def test_refuses_other_bytes_and_missing_files(tmp_path):
    (tmp_path / "a.pts").write_bytes(b"\xff\xfe\x00\x01" * 10)
    with pytest.raises(FileFormatError):
        read_points(tmp_path / "a.pts")
    with pytest.raises(StoreError, match=r"no\.pts"):
        read_points(tmp_path / "no.pts")


def test_writing_refuses_what_reading_would(tmp_path):
    points = np.array([[1.0, 2.0], [np.nan, 3.0]])
    with pytest.raises(ValueRangeError):
        write_points(tmp_path / "a.json", points)
    with pytest.raises(ValueRangeError, match=r"\.json"):
        write_points(tmp_path / "a.pts", points, confidence=np.array([1.0, 0.0]))
    with pytest.raises(ValueRangeError):
        write_points(tmp_path / "a.csv", points[:1])
    with pytest.raises(ShapeError):
        write_points(tmp_path / "a.json", points, confidence=np.ones(3))
    assert not list(tmp_path.iterdir())
    write_points(tmp_path / "a.json", points, confidence=np.array([1.0, 0.0]))
    assert read_points(tmp_path / "a.json").confidence.tolist() == [1.0, 0.0]


@pytest.mark.parametrize("text", ["1,2,3\n4,5,6\n", "x;y;z\n1; 2; 3\n4; 5; 6\n", "nose 1 2 3\n# end\nchin\t4 5 6\n"])
def test_tables_of_points(tmp_path, text):
    (tmp_path / "a.csv").write_text(text)
    np.testing.assert_array_equal(read_points(tmp_path / "a.csv").points, [[1, 2, 3], [4, 5, 6]])


@pytest.mark.parametrize("text", ["1,2,3\n4,5\n", "1,2,x\n", "1\n2\n", "1,2,nan\n", "a,b\n"])
def test_broken_tables_are_refused(tmp_path, text):
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(FileFormatError, match=r"a\.csv"):
        read_points(tmp_path / "a.csv")


def test_points_in_space_round_trip(tmp_path, rng):
    points = rng.uniform(-0.1, 0.1, (74, 3))  # metres
    confidence = np.ones(74)
    confidence[3] = 0
    points[3] = np.nan
    write_points(tmp_path / "a.json", points, "fw74", confidence)
    file = read_points(tmp_path / "a.json")
    np.testing.assert_allclose(file.points, points, atol=1e-8)
    assert file.confidence[3] == 0
    with pytest.raises(ShapeError):
        write_points(tmp_path / "a.pts", points[:3])


def test_labelled_points_come_in_ibug_order(tmp_path):
    sizes = {"chin": 17, "leye": 6, "reye": 6, "leyebrow": 5, "nose": 9, "reyebrow": 5, "mouth": 20}
    labels, start = [], 0
    for label, size in sizes.items():
        labels.append({"label": label, "mask": list(range(start, start + size))})
        start += size
    points = [[float(k), 0.0, 0.0] for k in range(68)]
    content = {"version": 3, "groups": {"LJSON": {"labels": labels, "landmarks": {"points": points}}}}
    (tmp_path / "a.ljson").write_text(json.dumps(content))
    order = read_points(tmp_path / "a.ljson").points[:, 0].astype(int).tolist()
    brows, eyes = [*range(29, 34), *range(43, 48)], [*range(17, 29)]
    assert order == [*range(17), *brows, *range(34, 43), *eyes, *range(48, 68)]
    labels[0]["label"] = "something else"
    (tmp_path / "a.ljson").write_text(json.dumps(content))
    assert read_points(tmp_path / "a.ljson").points[:, 0].astype(int).tolist() == list(range(68))
