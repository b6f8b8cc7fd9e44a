"""The arrays of a region-based model fit together."""

import importlib.util
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from facewright.errors import ShapeError, ValueRangeError

_spec = importlib.util.spec_from_file_location("reference_regions", Path(__file__).with_name("reference_regions.py"))
reference = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(reference)


def test_coefficients_are_stacked_region_by_region(rng):
    model = reference.small_model(rng, 4)
    assert model.offsets.tolist() == [0, 4, 8, 12]
    assert model.n_coefficients == 12
    assert model.n_vertices == reference.N


@pytest.mark.parametrize(
    ("change", "error"),
    [
        (lambda m: {"neutral": m.neutral[:-1]}, ShapeError),
        (lambda m: {"neutral": np.where(np.arange(m.n_vertices)[:, None] == 3, np.nan, m.neutral)}, ValueRangeError),
        (lambda m: {"faces": m.faces + 1}, ValueRangeError),
        (lambda m: {"bases": m.bases[:-1]}, ShapeError),
        (lambda m: {"bases": (m.bases[0][:, :-1], *m.bases[1:])}, ShapeError),
        (lambda m: {"bases": (m.bases[0] * np.nan, *m.bases[1:])}, ValueRangeError),
        (lambda m: {"means": (m.means[0][:-1], *m.means[1:])}, ShapeError),
        (lambda m: {"deviations": (m.deviations[0][:-1], *m.deviations[1:])}, ShapeError),
        (lambda m: {"lower": m.upper, "upper": m.lower}, ValueRangeError),
        (lambda m: {"coefficient_names": (("a",), *m.coefficient_names[1:])}, ValueRangeError),
    ],
)
def test_what_does_not_match_is_refused(rng, change, error):
    model = reference.small_model(rng)
    with pytest.raises(error):
        replace(model, **change(model))
