"""Local linear functions of a picture's colour, beside a naive loop."""

import numpy as np
import pytest

from facewright.errors import ShapeError
from facewright.imaging.guided_filter import fit_local_lines


def test_a_linear_function_of_the_colour_is_found(rng):
    picture = rng.random((20, 24, 3)).astype(np.float32)
    values = picture @ (0.5, -0.2, 0.3) + 0.1
    line = fit_local_lines(values, picture, 3, 1e-4)
    np.testing.assert_allclose(line.at(picture), values, atol=1e-3)
    np.testing.assert_allclose(line.slope[10, 10], (0.5, -0.2, 0.3), atol=1e-2)


def test_it_is_a_naive_loop_in_the_middle(rng):
    picture, values = rng.random((13, 15, 3)), rng.random((13, 15))
    radius, noise = 2, 0.1
    found = fit_local_lines(values, picture, radius, noise)
    slopes, levels = np.zeros((13, 15, 3)), np.zeros((13, 15))
    for y in range(radius, 13 - radius):
        for x in range(radius, 15 - radius):
            window = np.s_[y - radius : y + radius + 1, x - radius : x + radius + 1]
            colours, inside = picture[window].reshape(-1, 3), values[window].ravel()
            spread = np.cov(colours.T, bias=True) + noise**2 * np.eye(3)
            together = ((colours - colours.mean(0)) * (inside - inside.mean())[:, None]).mean(0)
            slopes[y, x] = np.linalg.solve(spread, together)
            levels[y, x] = inside.mean() - slopes[y, x] @ colours.mean(0)
    for y in range(2 * radius, 13 - 2 * radius):
        for x in range(2 * radius, 15 - 2 * radius):
            window = np.s_[y - radius : y + radius + 1, x - radius : x + radius + 1]
            np.testing.assert_allclose(found.slope[y, x], slopes[window].mean(axis=(0, 1)), atol=1e-5)
            assert found.level[y, x] == pytest.approx(levels[window].mean(), abs=1e-5)


def test_an_edge_snaps_to_the_picture():
    picture = np.zeros((30, 30, 3), np.float32)
    picture[:, 15:] = 1
    blurred = np.repeat(np.clip((np.arange(30) - 10) / 10, 0, 1)[None], 30, 0)
    found = fit_local_lines(blurred, picture, 4, 0.02).at(picture)
    assert found[15, 15] - found[15, 14] > 0.4


def test_sizes_must_match():
    with pytest.raises(ShapeError):
        fit_local_lines(np.zeros((4, 5)), np.zeros((5, 4, 3)), 1, 0.1)
