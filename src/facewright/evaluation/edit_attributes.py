"""How well attributes are known and obtained on people whom the model has not seen: R^2, slope and leakage."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from facewright.faces.attribute_editor import FORMS, AttributeEditor
from facewright.faces.attributes import attribute_points, measure_points
from facewright.faces.face import Face
from facewright.models.bilinear import BilinearModel

Progress = Callable[[str, int, int], None]

N_UNSEEN = 30
DEVIATIONS = 2.0
_NOISE_MM = 0.5  # of meshes against the model: what its components do not hold
_PREFIX = {"least change": "", "regression": "eq12_"}


def attribute_metrics(
    face: Face, model: BilinearModel, editor: AttributeEditor, seed: int, progress: Progress | None = None
) -> dict[str, float]:
    """Measure attributes on unseen people's meshes.

    Parameters
    ----------
    face : Face
        Whose skin the model is of.
    model : BilinearModel
    editor : AttributeEditor
        Of the model.
    seed : int
        Of the unseen people.
    progress : callable, optional
        Called with stage, done, total.

    Returns
    -------
    dict of str to float
        ``r2_face_length`` and so on: share of the variance of an attribute, as measured on the true meshes of 30 unseen
        people, that identity weights fitted to these meshes predict, by the linear map that the training people's
        weights and attributes give; ``r2_worst``; and when every attribute in turn is asked to change by 2 standard
        deviations and the resulting change of the mesh is added to the true mesh: ``obtained`` (the least share of the
        request), ``obtained_worst_miss`` (largest, standard deviations), ``leakage`` (mean absolute change of the
        others, per standard deviation asked for) and ``leakage_worst`` (largest mean change of any one by any other).
        The same with ``eq12_`` for eq. (12) of FaceWarehouse as it stands.
    """
    skin = face.skin()
    unseen = _unseen_neutrals(skin, seed)
    points = attribute_points(unseen, skin.topology)
    true = measure_points(points, editor.names)
    basis = model.expression(model.expression_weights[0])
    weights = _fit_neutrals(model, basis, unseen)
    metrics = _r_squared(model, editor, weights, true)
    basis_points = attribute_points(basis, skin.topology)
    for done, form in enumerate(FORMS, start=1):
        responses = np.empty((len(unseen), len(editor.names), len(editor.names)))
        for k, w in enumerate(weights):
            for j, name in enumerate(editor.names):
                step = editor.change(w, {name: DEVIATIONS}, form=form).weights - w
                after = measure_points((points[k] + np.tensordot(step, basis_points, 1))[None], editor.names)[0]
                responses[k, j] = (after - true[k]) / editor.standard_deviation / DEVIATIONS
        metrics |= {_PREFIX[form] + key: value for key, value in _summary(responses).items()}
        if progress is not None:
            progress("changing attributes", done, len(FORMS))
    return metrics


def _unseen_neutrals(skin: Face, seed: int) -> NDArray[np.float32]:
    from facewright.faces.simulate import simulate_neutrals

    return simulate_neutrals(skin, N_UNSEEN, np.random.default_rng((seed, 2)))


def _fit_neutrals(
    model: BilinearModel, basis: NDArray[np.float32], neutrals: NDArray[np.float32]
) -> NDArray[np.float64]:
    """Return the maximum a posteriori identity weights (N, I) of neutral meshes."""
    flat = basis.reshape(len(basis), -1).astype(np.float64)
    prior = _NOISE_MM**2 * model.identity_precision
    offset = neutrals.reshape(len(neutrals), -1).astype(np.float64) - model.identity_mean @ flat
    step = np.linalg.solve(flat @ flat.T + prior, flat @ offset.T).T
    return np.asarray(model.identity_mean + step)


def _r_squared(
    model: BilinearModel, editor: AttributeEditor, weights: NDArray[np.float64], true: NDArray[np.float64]
) -> dict[str, float]:
    """Predict attributes of unseen people by the linear map learned on the model's people."""
    people = model.identity_weights
    centre = people.mean(axis=0)
    slope = np.linalg.lstsq(people - centre, editor.measure(people) - editor.mean, rcond=1e-6)[0]
    predicted = editor.mean + (weights - centre) @ slope
    error = ((predicted - true) ** 2).sum(axis=0) / ((true - true.mean(axis=0)) ** 2).sum(axis=0)
    metrics = {f"r2_{name.replace(' ', '_')}": float(1.0 - e) for name, e in zip(editor.names, error)}
    return metrics | {"r2_worst": float(1.0 - error.max())}


def _summary(responses: NDArray[np.float64]) -> dict[str, float]:
    """Summarise the responses (N, A, A) of all attributes (last) to requests (middle), per deviation asked for."""
    diagonal = np.diagonal(responses, axis1=1, axis2=2)
    mean = responses.mean(axis=0)
    off = ~np.eye(len(mean), dtype=bool)
    return {
        "obtained": float(mean.diagonal().min()),
        "obtained_worst_miss": float(np.abs(diagonal - 1.0).max() * DEVIATIONS),
        "leakage": float(np.abs(responses[:, off]).mean()),
        "leakage_worst": float(np.abs(mean[off]).max()),
    }
