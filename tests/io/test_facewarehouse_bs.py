"""FaceWarehouse's own files: written ones come back; sizes that cannot be true are refused before they are used."""

import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from facewright.errors import FileFormatError, ShapeError, StoreError, ValueRangeError
from facewright.io.facewarehouse_bs import read_bs, read_face_tensor, read_land, write_bs, write_land


def test_shapes_come_back(tmp_path, rng):
    shapes = rng.normal(0, 100, (47, 30, 3)).astype(np.float32)
    path = tmp_path / "shape.bs"
    write_bs(path, shapes, 25)
    assert path.stat().st_size == 12 + 47 * 30 * 12
    assert struct.unpack("<iii", path.read_bytes()[:12]) == (46, 30, 25)
    found = read_bs(path)
    assert found.n_faces == 25 and found.shapes.dtype == np.float32
    np.testing.assert_array_equal(found.shapes, shapes)


def test_the_published_size(tmp_path):
    """47 shapes of 11,510 vertices are 6,491,652 bytes, as counted from published descriptions."""
    write_bs(tmp_path / "shape.bs", np.zeros((47, 11510, 3), np.float32), 11540)
    assert (tmp_path / "shape.bs").stat().st_size == 6_491_652


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"\x00" * 11,
        struct.pack("<iii", 46, 10, 9),
        struct.pack("<iii", 46, 10, 9) + b"\x00" * (46 * 10 * 12),  # one block too few
        struct.pack("<iii", 46, 10, 9) + b"\x00" * (48 * 10 * 12),
        struct.pack("<iii", 2**31 - 1, 2**31 - 1, 9) + b"\x00" * 24,
        struct.pack("<iii", -1, 10, 9),
        struct.pack("<iii", 46, -10, 9) + b"\x00" * 100,
        struct.pack(">iii", 46, 10, 9) + b"\x00" * (47 * 10 * 12),  # big-endian
        struct.pack("<iii", 1, 1, 1) + struct.pack("<6f", 0, 0, 0, float("nan"), 0, 0),
    ],
)
def test_false_sizes_and_values_are_refused(tmp_path, data):
    (tmp_path / "shape.bs").write_bytes(data)
    with pytest.raises(FileFormatError, match=r"shape\.bs must"):
        read_bs(tmp_path / "shape.bs")


def test_a_missing_file(tmp_path):
    for read in (read_bs, read_face_tensor, lambda path: read_land(path, (480, 640))):
        with pytest.raises(StoreError):
            read(tmp_path / "absent")
    with pytest.raises(ValueRangeError):
        write_bs(tmp_path / "x.bs", np.full((2, 3, 3), np.nan), 1)
    with pytest.raises(ShapeError):
        write_bs(tmp_path / "x.bs", np.zeros((2, 3)), 1)


def test_landmarks_count_from_below(tmp_path):
    """The share (0, 1) is the upper left corner of the picture, half a pixel from its first pixel's centre."""
    path = tmp_path / "pose_0.land"
    path.write_text("74\n" + "0 1\n1 0\n0.5 0.5\n" + "0.25 0.75\n" * 71)
    points = read_land(path, (480, 640))
    np.testing.assert_allclose(points[:3], [[-0.5, -0.5], [639.5, 479.5], [319.5, 239.5]])
    np.testing.assert_allclose(points[3], [159.5, 119.5])


@given(st.integers(1, 4000), st.integers(1, 4000), st.integers(0, 2**32 - 1))
def test_landmarks_come_back(tmp_path_factory, height, width, seed):
    path = tmp_path_factory.getbasetemp() / "points.land"
    points = np.random.default_rng(seed).uniform(0, 1, (74, 2)) * [width, height]
    write_land(path, points, (height, width))
    np.testing.assert_allclose(read_land(path, (height, width)), points, atol=1e-5)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "74",
        "73\n" + "0.5 0.5\n" * 73,
        "74\n" + "0.5 0.5\n" * 73,
        "74\n" + "nan 0.5\n" * 74,
        "74\n" + "320 240\n" * 74,
    ]
    + ["seventy", "74\n" + "0.5 0.5\n" * 74 + "1"],
)
def test_other_landmark_files_are_refused(tmp_path, text):
    (tmp_path / "a.land").write_text(text)
    with pytest.raises(FileFormatError, match=r"a\.land must"):
        read_land(tmp_path / "a.land", (480, 640))


def test_a_land_file_cannot_lack_points(tmp_path):
    points = np.zeros((74, 2))
    points[3] = np.nan
    with pytest.raises(ValueRangeError):
        write_land(tmp_path / "a.land", points, (480, 640))
    with pytest.raises(ValueRangeError, match="size"):
        write_land(tmp_path / "a.land", np.zeros((74, 2)), (0, 640))


@pytest.mark.parametrize("shape", [(5, 7), (3, 5, 7)])
def test_tensors_of_both_generations(tmp_path, rng, shape):
    values = rng.normal(size=shape)
    old, new = tmp_path / "old.tensor", tmp_path / "new.tensor"
    sizes = struct.pack(f"<{len(shape)}i", *shape)
    old.write_bytes(sizes + values.astype("<f4").tobytes())
    slabs = [values] if len(shape) == 2 else list(values)
    new.write_bytes(sizes + b"".join(np.asfortranarray(slab).tobytes(order="F") for slab in slabs))
    np.testing.assert_array_equal(read_face_tensor(old), values.astype(np.float32))
    np.testing.assert_array_equal(read_face_tensor(new), values)


@pytest.mark.parametrize(
    "data",
    [
        b"",
        struct.pack("<ii", 5, 7) + b"\x00" * 100,
        struct.pack("<iii", 2**31 - 1, 2**31 - 1, 2**31 - 1),
    ],
)
def test_tensors_of_no_kind_are_refused(tmp_path, data):
    (tmp_path / "a.tensor").write_bytes(data)
    with pytest.raises(FileFormatError, match=r"a\.tensor must"):
        read_face_tensor(tmp_path / "a.tensor")


def test_an_ambiguous_tensor_is_refused(tmp_path):
    """16 bytes that begin with 1, 1, 1 are one float32 of rank 3, or one float64 of rank 2."""
    (tmp_path / "a.tensor").write_bytes(struct.pack("<iii", 1, 1, 1) + b"\x00" * 4)
    with pytest.raises(FileFormatError, match=r"fit one kind of it, got f4 \(1, 1, 1\) and f8 \(1, 1\)"):
        read_face_tensor(tmp_path / "a.tensor")
