import numpy as np

from facewright.faces.eyeball import clearance, push_outside


def sphere(n=2000, radius=12.0):
    k = np.arange(n) + 0.5
    polar, turn = np.arccos(1 - 2 * k / n), np.pi * (1 + 5**0.5) * k
    return radius * np.stack([np.cos(turn) * np.sin(polar), np.sin(turn) * np.sin(polar), np.cos(polar)], axis=1)


def test_lid_points_inside_are_moved_out_along_rays_and_others_stay(rng):
    ball = sphere() + [30.0, 5.0, 80.0]
    directions = rng.normal(size=(50, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    radius = rng.uniform(8, 20, 50)
    lid = ball.mean(axis=0) + directions * radius[:, None]
    assert np.allclose(clearance(lid, ball), radius - 12.0, atol=0.01)
    out = push_outside(lid, ball, 1.0)
    distance = np.linalg.norm(out - ball.mean(axis=0), axis=1)
    assert distance.min() > 12.98
    assert np.allclose((out - ball.mean(axis=0)) / distance[:, None], directions)
    clear = radius > 13.02
    assert np.allclose(out[clear], lid[clear])
    assert np.allclose(push_outside(lid, ball, clearance(lid, ball)), lid)
