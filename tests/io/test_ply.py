"""PLY: round trips in all three encodings, lists of any shape, truncated and foreign files refused."""

import struct

import numpy as np
import pytest

from facewright.errors import FileFormatError, ShapeError, StoreError, ValueRangeError
from facewright.io.ply import PlyList, read_ply, read_ply_elements, write_ply

POLYGONS = np.array([[0, 1, 2, -1], [0, 1, 2, 3], [3, 2, 1, -1], [4, 3, 2, 1]])


@pytest.mark.parametrize("ascii", [False, True])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("faces", [None, POLYGONS, POLYGONS[:1, :3], POLYGONS[1::2]])
def test_round_trip(tmp_path, rng, ascii, dtype, faces):
    vertices = rng.normal(size=(5, 3)).astype(dtype)
    normals = rng.normal(size=(5, 3)).astype(np.float32)
    colors = rng.integers(0, 256, (5, 3), dtype=np.uint8)
    path = tmp_path / "mesh.ply"
    write_ply(path, vertices, faces, normals=normals, vertex_colors=colors, ascii=ascii, comments=("made by a test",))
    mesh = read_ply(path)
    assert mesh.vertices.dtype == dtype
    np.testing.assert_array_equal(mesh.vertices, vertices)
    np.testing.assert_allclose(mesh.normals, normals, rtol=1e-6)
    np.testing.assert_array_equal(mesh.vertex_colors, colors)
    if faces is None:
        assert mesh.faces.shape == (0, 3)
    elif faces.shape[1] == 3:
        np.testing.assert_array_equal(mesh.faces, faces)
    else:
        np.testing.assert_array_equal(mesh.polygons, faces)
        assert len(mesh.faces) == ((faces >= 0).sum(axis=1) - 2).sum()


@pytest.mark.parametrize("order", ["<", ">"])
def test_elements_and_lists_of_any_shape(tmp_path, order):
    name = {"<": "little", ">": "big"}[order]
    header = (
        f"ply\nformat binary_{name}_endian 1.0\nobj_info x\nelement vertex 3\nproperty double x\nproperty float y\n"
        "property short z\nelement face 2\nproperty uchar flag\nproperty list uchar ushort vertex_index\n"
        "property list int float texcoord\nelement extra 1\nproperty uint n\nend_header\n"
    )
    body = b"".join(struct.pack(order + "dfh", i, 2 * i, -i) for i in range(3))
    body += struct.pack(order + "BB3Hi6f", 7, 3, 0, 1, 2, 6, 0, 0, 1, 0, 0, 1)
    body += struct.pack(order + "BB4Hi8f", 8, 4, 0, 1, 2, 1, 8, 0, 0, 1, 0, 0, 1, 1, 0)
    body += struct.pack(order + "I", 99)
    path = tmp_path / "mesh.ply"
    path.write_bytes(header.encode() + body)
    mesh = read_ply(path)
    assert mesh.vertices.tolist() == [[0, 0, 0], [1, 2, -1], [2, 4, -2]]
    assert mesh.polygons.tolist() == [[0, 1, 2, -1], [0, 1, 2, 1]]
    np.testing.assert_array_equal(mesh.uv[mesh.uv_faces[2]], [[0, 0], [0, 1], [1, 0]])
    elements = read_ply_elements(path)
    assert elements["extra"]["n"].tolist() == [99] and elements["face"]["flag"].tolist() == [7, 8]
    assert isinstance(elements["face"]["texcoord"], PlyList)


def test_text_forms(tmp_path):
    header = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
    header += "property float s\nproperty float t\nproperty float red\nproperty float green\nproperty float blue\n"
    header += "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
    path = tmp_path / "mesh.ply"
    path.write_text(header + "0 0 0 0 0 1 0 0\n1 0 0 1 0 0 1 0\n\n0 1 0 0 1 0 0 0.5\n3 0 1 2\n")
    mesh = read_ply(path)
    assert mesh.vertex_colors.tolist() == [[255, 0, 0], [0, 255, 0], [0, 0, 128]]
    assert mesh.uv.tolist() == [[0, 0], [1, 0], [0, 1]] and mesh.uv_faces.tolist() == [[0, 1, 2]]


@pytest.mark.parametrize("ascii", [False, True])
@pytest.mark.parametrize("share", [0.0, 0.02, 0.3, 0.9, 0.999])
def test_truncated_files_are_refused(tmp_path, rng, ascii, share):
    path = tmp_path / "mesh.ply"
    write_ply(path, rng.normal(size=(40, 3)), POLYGONS, ascii=ascii)
    data = path.read_bytes()
    cut = data[: int(len(data) * share)]
    if ascii and share > 0.99:
        cut = data[: data.rindex(b" ")]
    path.write_bytes(cut)
    with pytest.raises(FileFormatError, match=r"mesh\.ply"):
        read_ply(path)


@pytest.mark.parametrize(
    ("header", "body", "message"),
    [
        ("plot", b"", "must be a PLY file"),
        ("ply\nelement vertex 0\nend_header\n", b"", "must state a PLY format"),
        ("ply\nformat ascii 1.0\nelement vertex many\nend_header\n", b"", "line 3 must be a PLY header line"),
        ("ply\nformat ascii 1.0\nelement vertex 1\nproperty quad x\nend_header\n", b"", "line 4"),
        ("ply\nformat ascii 1.0\nelement point 0\nproperty float x\nend_header\n", b"", "element 'vertex'"),
        (
            "ply\nformat binary_little_endian 1.0\nelement vertex 999999999999\nproperty float x\nend_header\n",
            b"0",
            "truncated",
        ),
    ],
)
def test_foreign_headers_are_refused_before_anything_is_allocated(tmp_path, header, body, message):
    path = tmp_path / "mesh.ply"
    path.write_bytes(header.encode() + body)
    with pytest.raises(FileFormatError, match=message):
        read_ply(path)


@pytest.mark.parametrize(
    ("body", "message"),
    [
        ("0 0 0\n1 0 0\n0 nan 0\n3 0 1 2\n", "finite"),
        ("0 0 0\n1 0 0\n0 1 0\n3 0 1 3\n", "index its 3 vertices"),
        ("0 0 0\n1 0 0\n0 1 0\n2 0 1\n", "at least 3"),
        ("0 0 0\n1 0 0\n0 1 0\n-3 0 1 2\n", "longer than its line"),
        ("0 0 0\n1 0\n0 1 0\n3 0 1 2\n", "properties in each line"),
        ("0 0 0\n1 0 x\n0 1 0\n3 0 1 2\n", "properties in each line"),
    ],
)
def test_wrong_content_is_refused(tmp_path, body, message):
    header = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
    header += "element face 1\nproperty list char int vertex_indices\nend_header\n"
    path = tmp_path / "mesh.ply"
    path.write_text(header + body)
    with pytest.raises(FileFormatError, match=message):
        read_ply(path)


def test_missing_file_and_wrong_arrays(tmp_path):
    with pytest.raises(StoreError, match="No such file"):
        read_ply(tmp_path / "none.ply")
    with pytest.raises(ShapeError):
        write_ply(tmp_path / "a.ply", np.zeros((3, 2)))
    with pytest.raises(ShapeError):
        write_ply(tmp_path / "a.ply", np.zeros((3, 3)), normals=np.zeros((2, 3)))
    with pytest.raises(ValueRangeError):
        write_ply(tmp_path / "a.ply", np.zeros((3, 3)), [[0, 1, 3]])
    with pytest.raises(ValueRangeError):
        write_ply(tmp_path / "a.ply", np.full((3, 3), np.inf))
    assert not list(tmp_path.iterdir())


def test_real_depth_recording(test_data):
    cloud = read_ply(test_data / "truedepth_mannequin/Expected.ply")
    assert cloud.vertices.shape == (45428, 3) and cloud.vertex_colors.shape == (45428, 3)
    frame = read_ply_elements(test_data / "truedepth_mannequin/frame-000.ply")
    assert frame["depth"]["d"].shape == (76800,) and frame["color"]["r"].max() <= 1.0
