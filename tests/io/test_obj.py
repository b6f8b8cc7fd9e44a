"""OBJ: what is written comes back, every legal form is read, mistakes are named with file and line."""

import numpy as np
import pytest

from facewright.errors import FileFormatError, ShapeError, StoreError, ValueRangeError
from facewright.io.obj import read_obj, write_obj

SQUARE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0.5], [2, 2, 2]], dtype=np.float32)


def _read(tmp_path, text):
    path = tmp_path / "mesh.obj"
    path.write_text(text, newline="")
    return read_obj(path)


def test_round_trip_keeps_order_polygons_seams_and_colours(tmp_path, rng):
    vertices = rng.normal(size=(50, 3)).astype(np.float32) * 100
    faces = np.array([[0, 1, 2, 3], [4, 5, 6, -1], [7, 8, 9, 10], [49, 20, 10, -1]])
    uv = rng.random((20, 2)).astype(np.float32)
    uv_faces = np.array([[3, 2, 1, 0], [4, 5, 6, -1], [19, 18, 17, 16], [1, 2, 3, -1]])
    colors = rng.integers(0, 256, (50, 3), dtype=np.uint8)
    path = tmp_path / "mesh.obj"
    write_obj(path, vertices, faces, uv=uv, uv_faces=uv_faces, vertex_colors=colors, texture="skin.png", comment="a\nb")
    mesh = read_obj(path)
    np.testing.assert_array_equal(mesh.vertices.astype(np.float32), vertices)
    np.testing.assert_array_equal(mesh.polygons, faces)
    np.testing.assert_array_equal(mesh.uv, uv)
    np.testing.assert_array_equal(mesh.uv_polygons, uv_faces)
    np.testing.assert_array_equal(mesh.vertex_colors, colors)
    assert mesh.texture == tmp_path / "skin.png"
    assert mesh.faces.tolist()[:3] == [[0, 1, 2], [0, 2, 3], [4, 5, 6]]
    assert mesh.uv_faces.tolist()[:3] == [[3, 2, 1], [3, 1, 0], [4, 5, 6]]
    assert sorted(p.name for p in tmp_path.iterdir()) == ["mesh.mtl", "mesh.obj"]


def test_triangles_need_no_polygons(tmp_path):
    write_obj(tmp_path / "t.obj", SQUARE, [[0, 1, 2], [0, 2, 3]])
    mesh = read_obj(tmp_path / "t.obj")
    assert mesh.polygons is None and mesh.uv is None and mesh.uv_faces is None and mesh.texture is None
    assert mesh.faces.tolist() == [[0, 1, 2], [0, 2, 3]]
    assert mesh.faces.dtype == np.int32 and mesh.vertices.dtype == np.float64


@pytest.mark.parametrize(
    "face",
    [
        "f 1 2 3",
        "f 1/1 2/2 3/3",
        "f 1//1 2//1 3//1",
        "f 1/1/1 2/2/1 3/3/1",
        "f -3 -2 -1",
        "f -3/-3 -2/-2 -1/-1",
        "f 1/ 2/ 3/",
    ],
)
def test_every_corner_form_gives_the_same_triangle(tmp_path, face):
    mesh = _read(tmp_path, f"v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nvn 0 0 1\n{face}\n")
    assert mesh.faces.tolist() == [[0, 1, 2]]
    if face in ("f 1/1 2/2 3/3", "f 1/1/1 2/2/1 3/3/1", "f -3/-3 -2/-2 -1/-1"):
        assert mesh.uv_faces.tolist() == [[0, 1, 2]]
    else:
        assert mesh.uv_faces is None
    if face in ("f 1//1 2//1 3//1", "f 1/1/1 2/2/1 3/3/1"):
        assert mesh.normals.tolist() == [[0, 0, 1]] * 3
    else:
        assert mesh.normals is None


def test_forms_may_be_mixed_in_one_file(tmp_path):
    text = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nvt 0 0\nvt 1 1\nf 1 2 3\nf 2/1 3/2 4/1\nf 1//1 2 3/2/1\nvn 0 0 1\n"
    mesh = _read(tmp_path, text)
    assert mesh.faces.tolist() == [[0, 1, 2], [1, 2, 3], [0, 1, 2]]
    assert mesh.uv_faces is None  # not on every corner


def test_relative_indices_count_from_the_line_they_stand_in(tmp_path):
    mesh = _read(tmp_path, "v 0 0 0\nv 1 0 0\nv 0 1 0\nf -3 -2 -1\nv 0 0 1\nf -4 -1 2\nv 5 5 5\n")
    assert mesh.faces.tolist() == [[0, 1, 2], [0, 3, 1]]


def test_blanks_comments_continuations_and_line_ends(tmp_path):
    text = (
        "# head\r\n  v 0 0 0 # first\r\nv\t1 0 0\r\nv 0 1 \\\r\n 0\r\no thing\r\ng part\r\ns off\r\nf 1 \\\r\n2 3\r\n"
    )
    mesh = _read(tmp_path, text)
    assert mesh.vertices.tolist() == [[0, 0, 0], [1, 0, 0], [0, 1, 0]] and mesh.faces.tolist() == [[0, 1, 2]]


def test_point_cloud_without_faces(tmp_path):
    mesh = _read(tmp_path, "v 0 0 0\nv 1 0 0 1.0\n")
    assert mesh.vertices.shape == (2, 3) and mesh.faces.shape == (0, 3)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "without any 'v x y z'"),
        ("hello\nworld\n", "without any 'v x y z'"),
        ("v 0 0\n", "line 1 must hold 3 finite"),
        ("v\n", "without any"),
        ("v 0 0 0\nv 0 x 0\n", "line 2 must hold 3 finite"),
        ("v 0 0 0\nv 0 nan 0\n", "line 2 must hold 3 finite"),
        ("v 0 0 0\nv 0 1e999 0\n", "line 2 must hold 3 finite"),
        ("v 0 0 0\nv 1 0 0\nf 1 2\n", "line 3 must list at least 3"),
        ("v 0 0 0\nv 1 0 0\nf 1 2 3\n", "line 3 must index the 2 'v'"),
        ("v 0 0 0\nv 1 0 0\nf 0 1 2\n", "line 3 must index the 2 'v'"),
        ("v 0 0 0\nv 1 0 0\nf 1 2 -3\n", "line 3 must index the 2 'v'"),
        ("v 0 0 0\nv 1 0 0\nf 1/1 2/1 1/1\n", "line 3 must index the 0 'vt'"),
        ("v 0 0 0\n\\\n\nf 1 2.5 3\n", "line 4 must list corners"),
        ("v 0 0 0\nf 1 a 3\n", "line 2 must list corners"),
        ("v 0 0 0\nf 1/1/1/1 1 1\n", "line 2 must list corners"),
        ("v 0 0 0\nf /1 1 1\n", "line 2 must list corners"),
        ("v 0 0 0\nvt\nf 1 1 1\n", "line 2 must hold 2 finite"),
    ],
)
def test_mistakes_are_named_with_file_and_line(tmp_path, text, message):
    with pytest.raises(FileFormatError, match=message) as caught:
        _read(tmp_path, text)
    assert "mesh.obj" in str(caught.value) and "\n" not in str(caught.value)


def test_binary_and_missing_files_are_refused(tmp_path):
    (tmp_path / "b.obj").write_bytes(b"\x89PNG\r\n\0\0\0")
    with pytest.raises(FileFormatError, match="binary"):
        read_obj(tmp_path / "b.obj")
    with pytest.raises(StoreError, match="No such file"):
        read_obj(tmp_path / "none.obj")


@pytest.mark.parametrize(
    ("arguments", "error"),
    [
        ({"vertices": SQUARE[:, :2], "faces": [[0, 1, 2]]}, ShapeError),
        ({"vertices": SQUARE * np.nan, "faces": [[0, 1, 2]]}, ValueRangeError),
        ({"vertices": SQUARE, "faces": [[0, 1, 5]]}, ValueRangeError),
        ({"vertices": SQUARE, "faces": [[0, 1]]}, ValueRangeError),
        ({"vertices": SQUARE, "faces": [[0, 1, -1]]}, ValueRangeError),
        ({"vertices": SQUARE, "faces": [[0, 1, 2]], "uv": SQUARE}, ShapeError),
        ({"vertices": SQUARE, "faces": [[0, 1, 2]], "uv": SQUARE[:2, :2]}, ValueRangeError),
        ({"vertices": SQUARE, "faces": [[0, 1, 2]], "uv": SQUARE[:, :2], "uv_faces": [[0, 1, 2, 3]]}, ValueRangeError),
        ({"vertices": SQUARE, "faces": [[0, 1, 2]], "vertex_colors": SQUARE[:3]}, ShapeError),
    ],
)
def test_writer_refuses_arrays_that_do_not_fit(tmp_path, arguments, error):
    with pytest.raises(error):
        write_obj(tmp_path / "x.obj", **arguments)
    assert not list(tmp_path.iterdir())


def test_real_scans_read(test_data):
    james = read_obj(test_data / "scans/james.obj")
    assert james.vertices.shape == (6393, 3) and james.faces.shape == (12228, 3) and james.uv.shape == (6680, 2)
    pose = read_obj(test_data / "rigging_example/training_poses/0.obj")
    assert pose.vertices.shape == (6706, 3) and pose.polygons.shape == (6560, 4) and len(pose.faces) == 13120
