import numpy as np
import pytest

from facewright.apps import subject_pictures
from facewright.apps.subject_pictures import capture_row, subject_sheets
from facewright.camera.pinhole import Intrinsics, RigidMotion
from facewright.camera.rotation import FRONTAL
from facewright.errors import ValueRangeError
from facewright.imaging.rasterise import rasterise
from facewright.warehouse.subject import Subject

SIZE = (160, 200)
CAMERA = Intrinsics(300.0, 300.0, 99.5, 79.5)
POSE = RigidMotion(FRONTAL, np.array([0.0, 0.0, 600.0]))


def subject(face, depth_offset=0.0, *, records=True):
    """The mean face at rest and with the jaw open, seen from the front, with depth so far behind it."""
    meshes = np.stack([face.mean_shape, face.mean_shape + 0.5 * face.blendshape_deltas[18]])
    depths = []
    for mesh in meshes:
        seen = POSE.apply(mesh.astype(np.float64))
        depth = rasterise(CAMERA.project(seen), seen[:, 2], face.topology.faces, SIZE).depth
        depths.append(np.where(np.isfinite(depth), depth + depth_offset, 0.0).astype(np.float32))
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = POSE.rotation, POSE.translation
    return Subject(
        name="p",
        expressions=("neutral", "mouth_stretch"),
        meshes=meshes,
        blendshapes=np.concatenate([meshes[:1], meshes[0] + face.blendshape_deltas]),
        depth=np.stack(depths) if records else None,
        color=np.full((2, *SIZE, 3), 128, np.uint8) if records else None,
        intrinsics=np.tile([300.0, 300.0, 99.5, 79.5], (2, 1)),
        camera_from_model=np.stack([matrix, matrix]),
        landmarks=np.full((2, 74, 2), [100.0, 60.0]),
    )


def test_error_colours_tell_a_mesh_that_lies_on_its_depth_from_one_that_does_not(builtin_face):
    middle = np.s_[40:120, 60:100]
    near = capture_row(builtin_face, subject(builtin_face), "neutral", size=160)
    far = capture_row(builtin_face, subject(builtin_face, 3.5), "neutral", size=160)
    assert len(near) == 5
    assert all(picture.shape == (160, 160, 3) for picture in near)
    blue, red = near[-1][middle].mean(axis=(0, 1)), far[-1][middle].mean(axis=(0, 1))
    assert blue[2] > blue[0]
    assert red[0] > red[2]
    raw = np.full(SIZE, 600.0, np.float32)
    assert len(capture_row(builtin_face, subject(builtin_face), "neutral", raw, size=160)) == 6


def test_landmarks_are_drawn_where_they_are(builtin_face):
    marked = capture_row(builtin_face, subject(builtin_face), "neutral", size=160)[0].astype(int)
    green = (marked[..., 1] - marked[..., 0]) > 40
    assert 5 < green.sum() < 400


def test_what_is_not_there_is_refused(builtin_face):
    with pytest.raises(ValueRangeError, match="smile"):
        capture_row(builtin_face, subject(builtin_face), "smile")
    with pytest.raises(ValueRangeError, match="records"):
        capture_row(builtin_face, subject(builtin_face, records=False), "neutral")


def test_sheets_show_what_a_subject_has(builtin_face, monkeypatch):
    monkeypatch.setattr(subject_pictures, "SHOWN_BLENDSHAPES", ("jawOpen", "eyeBlink_L"))
    sheets = subject_sheets(builtin_face, subject(builtin_face, records=False))
    assert set(sheets) == {"expressions", "blendshapes"}
    sheets = subject_sheets(builtin_face, subject(builtin_face), size=120)
    assert list(sheets) == ["captures", "expressions", "blendshapes"]
    assert all(sheet.std() > 20 for sheet in sheets.values())
