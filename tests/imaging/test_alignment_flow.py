"""A picture of a face brought to another view of it."""

import numpy as np
import pytest

from facewright.errors import DegenerateError, ShapeError
from facewright.imaging.alignment_flow import align_picture
from facewright.imaging.component_mask import SkinPixels
from facewright.imaging.mesh_view import MeshView
from facewright.imaging.portrait import portrait_view
from facewright.imaging.rasterise import rasterise

SIZE = (260, 220)


def view_of(vertices, size=SIZE, **camera):
    seen, pixels = portrait_view(vertices, size, **camera)
    return MeshView(pixels, seen)


def painted(face, view, size):
    """Draw the skin with colours that depend on the place on it, smoothly."""
    skin = face.skin()
    x, y, z = skin.mean_shape.T
    colour = 128 + 60 * np.stack([np.sin(x / 9), np.sin(y / 11), np.cos((x + z) / 13)], axis=1)
    n = face.n_skin
    fragments = rasterise(view.pixels[:n], view.depth[:n], skin.topology.faces, size)
    return np.rint(fragments.interpolate(skin.topology.faces, colour)).astype(np.uint8)


def test_a_picture_in_its_own_view_is_itself(builtin_face):
    view = view_of(builtin_face.mean_shape)
    photo = painted(builtin_face, view, SIZE)
    pixels = SkinPixels.of(builtin_face, view, SIZE)
    aligned = align_picture(photo, view, builtin_face, pixels)
    inside = aligned.seen > 0.99
    assert inside.sum() > 0.6 * pixels.fragments.covered.sum()
    assert np.abs(aligned.image[inside].astype(int) - photo[inside]).max() <= 1
    assert aligned.shrinking == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize("scale", [0.6, 1.0, 2.5])
def test_another_pose_size_and_expression_are_undone(builtin_face, scale):
    smile = (
        builtin_face.mean_shape
        + 0.7 * builtin_face.blendshape_deltas[builtin_face.blendshape_names.index("mouthSmile_L")]
    )
    size = (round(SIZE[0] * scale), round(SIZE[1] * scale))
    source = view_of(smile, size, yaw_degrees=12, pitch_degrees=-6, distance_mm=600)
    target = view_of(builtin_face.mean_shape, yaw_degrees=-5)
    pixels = SkinPixels.of(builtin_face, target, SIZE)
    aligned = align_picture(painted(builtin_face, source, size), source, builtin_face, pixels)
    wanted = painted(builtin_face, target, SIZE)
    inside = (aligned.seen > 0.99) & pixels.fragments.covered
    assert inside.sum() > 0.5 * pixels.fragments.covered.sum()
    assert np.abs(aligned.image[inside].astype(int) - wanted[inside]).mean() < 2.0
    assert aligned.shrinking == pytest.approx(scale, rel=0.15)


def test_what_is_turned_away_is_not_seen(builtin_face):
    source = view_of(builtin_face.mean_shape, yaw_degrees=50)
    target = view_of(builtin_face.mean_shape)
    pixels = SkinPixels.of(builtin_face, target, SIZE)
    aligned = align_picture(painted(builtin_face, source, SIZE), source, builtin_face, pixels)
    masks = builtin_face.topology.masks
    seen = {}
    for side in ("left", "right"):
        x, y = target.pixels[masks[f"cheeks_{side}"]].mean(axis=0).round().astype(int)
        seen[side] = aligned.seen[y, x]
        assert (aligned.facing[y, x] > 0.4) == (seen[side] > 0.5)
    assert sorted(seen.values())[0] < 0.1 and sorted(seen.values())[1] > 0.9


def test_out_of_the_frame_is_not_seen(builtin_face):
    source = view_of(builtin_face.mean_shape)
    cut = MeshView(source.pixels - (0, 120), source.camera_vertices)
    photo = painted(builtin_face, cut, (SIZE[0] - 120, SIZE[1]))
    pixels = SkinPixels.of(builtin_face, source, SIZE)
    aligned = align_picture(photo, cut, builtin_face, pixels)
    assert (aligned.seen[:118] == 0).all() and aligned.seen[122:].max() == 1


def test_the_map_goes_on_smoothly_between_the_lips(builtin_face):
    opened = builtin_face.mean_shape + builtin_face.blendshape_deltas[builtin_face.blendshape_names.index("jawOpen")]
    source, target = view_of(opened, yaw_degrees=8), view_of(opened, yaw_degrees=-8)
    pixels = SkinPixels.of(builtin_face, target, SIZE)
    aligned = align_picture(painted(builtin_face, source, SIZE), source, builtin_face, pixels)
    y, x = np.mgrid[: SIZE[0], : SIZE[1]]
    shift = aligned.flow - np.stack([x, y], axis=-1)
    mouth = pixels.openings & (y > SIZE[0] / 2)
    assert mouth.sum() > 200
    around = shift[pixels.fragments.covered & (np.abs(y - y[mouth].mean()) < 25) & (np.abs(x - x[mouth].mean()) < 30)]
    assert (shift[mouth] >= around.min(axis=0) - 1e-3).all() and (shift[mouth] <= around.max(axis=0) + 1e-3).all()
    assert aligned.seen[mouth].min() > 0.5


def test_bad_input_is_refused(builtin_face):
    view = view_of(builtin_face.mean_shape)
    photo = painted(builtin_face, view, SIZE)
    pixels = SkinPixels.of(builtin_face, view, SIZE)
    with pytest.raises(ShapeError, match="photo"):
        align_picture(photo[..., 0], view, builtin_face, pixels)
    with pytest.raises(ShapeError, match="source"):
        align_picture(photo, MeshView(view.pixels[:9], view.camera_vertices[:9]), builtin_face, pixels)
    away = SkinPixels.of(builtin_face, MeshView(view.pixels + 9999, view.camera_vertices), SIZE)
    with pytest.raises(DegenerateError, match="skin"):
        align_picture(photo, view, builtin_face, away)
