"""A small bilinear model and people inside it, for fitting tests."""

import numpy as np
import pytest


@pytest.fixture(scope="session")
def small_model(builtin_face):
    """Bilinear model of 16 people who are exact mixtures of the face's modes and generic shapes."""
    from facewright.models.bilinear import fit_bilinear

    face = builtin_face.skin()
    rng = np.random.default_rng(5)
    I = len(face.identity_basis)
    neutrals = face.mean_shape + np.tensordot(rng.normal(size=(16, I)), face.identity_basis, 1)
    shapes = np.concatenate([np.zeros((1, *face.mean_shape.shape)), face.blendshape_deltas])
    amplitudes = rng.uniform(0.8, 1.2, (16, 47, 1, 1))
    tensor = (neutrals[:, None] + amplitudes * shapes[None]).astype(np.float32)
    return fit_bilinear(tensor, 14, 24, topology=face.topology, expression_names=("neutral", *face.blendshape_names))


@pytest.fixture(scope="session")
def fitter(small_model):
    from facewright.fitting.image import PhotoFitter

    return PhotoFitter(small_model)


@pytest.fixture
def make_photo(small_model):
    """Return a function (rng, perspective) -> identity, beta, vertices, project, rotation, true landmarks, size."""
    from facewright.apps.true_landmarks import true_landmarks
    from facewright.camera.pinhole import Intrinsics, RigidMotion
    from facewright.camera.rotation import rotation_from_head_angles
    from facewright.faces.expressions import random_expression_weights

    def make(rng, distance=900.0, focal=1400.0):
        w_id = small_model.sample_identity(rng)
        beta = random_expression_weights(rng, 1)[0]
        vertices = small_model.synthesise(w_id, small_model.expression_from_blendshapes(beta))
        rotation = rotation_from_head_angles(*rng.uniform([-30, -15, -15], [30, 15, 15]))
        intrinsics = Intrinsics.for_image((640, 640), focal)
        motion = RigidMotion(rotation, np.array([10.0, -5.0, distance]) - rotation @ [0, 0, 40.0])
        landmarks = true_landmarks(small_model.topology, small_model.mean_face, vertices, intrinsics, motion)
        return vertices, beta, intrinsics, motion, landmarks

    return make
