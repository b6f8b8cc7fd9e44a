"""Golden pictures: what the renderer and the built-in face look like must not change by accident."""

import numpy as np
import pytest

from facewright.faces.appearance import albedo_function, sample_appearance, visible_faces
from facewright.faces.expressions import expression_weights
from facewright.imaging.portrait import render_portrait

VIEWS = {
    "neutral_front": ("neutral", 0.0),
    "neutral_profile": ("neutral", -80.0),
    "mouth_stretch": ("mouth_stretch", 25.0),
    "grin": ("grin", -20.0),
    "eyes_closed": ("eyes_closed", 10.0),
}


@pytest.mark.parametrize("name", VIEWS)
def test_builtin_face(name, builtin_face, golden):
    expression, yaw = VIEWS[name]
    vertices = builtin_face.mean_shape + np.tensordot(
        expression_weights(expression).astype(np.float32), builtin_face.blendshape_deltas, axes=1
    )
    faces = visible_faces(builtin_face)
    albedo = albedo_function(builtin_face, sample_appearance(np.random.default_rng(11)), faces)
    golden(name, render_portrait(vertices, faces, (224, 192), albedo=albedo, yaw_degrees=yaw).image)


def test_golden_comparison_fails_on_a_changed_picture(golden, tmp_path, monkeypatch, request):
    if request.config.getoption("--update-golden"):
        pytest.skip("would overwrite the golden picture")
    monkeypatch.setenv("FACEWRIGHT_ARTIFACTS", str(tmp_path))
    with pytest.raises(pytest.fail.Exception, match="differs by"):
        golden("grin", np.zeros((224, 192, 3), np.uint8))
    assert (tmp_path / "facewright-golden" / "grin.difference.png").is_file()
