"""The landmark detector takes renders of the built-in face for photographs of people."""

import numpy as np
import pytest

from facewright.faces.appearance import albedo_function, sample_appearance, visible_faces
from facewright.faces.expressions import EXPRESSION_WEIGHTS
from facewright.imaging.portrait import portrait_view, render_portrait
from facewright.imaging.render import Lights

SIZE = (480, 420)


def detection_errors(face, rng, n_people, n_expressions, yaw_degrees=20.0):
    """Mean landmark error of each render as a share of the inter-ocular distance; NaN where no face is found."""
    from facewright.landmarks.detector import open_detector

    detector = open_detector()
    faces, errors = visible_faces(face), []
    for _ in range(n_people):
        person = face.mean_shape + np.tensordot(rng.normal(size=len(face.identity_basis)), face.identity_basis, 1)
        look = sample_appearance(rng)
        for k in rng.choice(len(EXPRESSION_WEIGHTS), n_expressions, replace=False):
            shape = person + np.tensordot(EXPRESSION_WEIGHTS[k], face.blendshape_deltas, 1)
            view = {"yaw_degrees": rng.uniform(-yaw_degrees, yaw_degrees), "pitch_degrees": rng.uniform(-8, 8)}
            picture = render_portrait(
                shape,
                faces,
                SIZE,
                albedo=albedo_function(face, look, faces),
                lights=Lights(look.light_directions, look.light_colours, look.sky, look.ground),
                background=look.background,
                **view,
            ).image
            true = portrait_view(shape, SIZE, **view)[1][face.topology.landmarks["fw74"]]
            found = detector.detect(picture)
            if not found:
                errors.append(np.nan)
                continue
            gap = np.linalg.norm(found[0].convert("fw74").points - true, axis=1)[15:]  # contour points slide
            errors.append(gap.mean() / np.linalg.norm(true[27] - true[35]))
    return np.array(errors)


@pytest.mark.landmarks
def test_a_few_people_are_found(builtin_face, rng):
    pytest.importorskip("mediapipe")
    errors = detection_errors(builtin_face, rng, n_people=4, n_expressions=2)
    assert np.isfinite(errors).all()
    assert errors.mean() < 0.05


@pytest.mark.slow
@pytest.mark.landmarks
@pytest.mark.timeout(900)
def test_two_hundred_renders_are_all_found(builtin_face, rng):
    pytest.importorskip("mediapipe")
    errors = detection_errors(builtin_face, rng, n_people=20, n_expressions=10)
    assert np.isfinite(errors).sum() == 200
    assert errors.mean() < 0.05
