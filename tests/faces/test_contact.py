import numpy as np

from facewright.faces.contact import Contact


def slit():
    """Two flat strips above and below a slit along x."""
    x, y = np.meshgrid(np.arange(0.0, 21.0), np.arange(0.0, 13.0))
    top = np.stack([x.ravel(), y.ravel() + 0.5, 0 * x.ravel()], axis=1)
    points = np.concatenate([top, top * [1, -1, 1]])
    cell = (np.arange(12)[:, None] * 21 + np.arange(20)).ravel()
    faces = np.concatenate([np.stack([cell, cell + 1, cell + 22], 1), np.stack([cell, cell + 22, cell + 21], 1)])
    return points, np.concatenate([faces, faces + len(top)]), np.arange(21), np.arange(21) + len(top)


def test_a_smooth_change_of_the_gap_is_met_and_shared():
    points, faces, upper, lower = slit()
    contact = Contact(points, faces, upper, lower, sigma_mm=3.0)
    wanted = np.zeros((21, 3))
    wanted[:, 1] = 1.0 + np.sin(np.linspace(0, np.pi, 21))
    moved = points.copy()
    contact.change(moved, wanted)
    assert np.abs(contact.offsets(moved) - contact.offsets(points) - wanted).max() < 0.03
    assert np.allclose(moved[upper] - points[upper], points[lower] - moved[lower])
    far = np.abs(points[:, 1]) > 12
    assert np.abs(moved - points)[far].max() < 0.01
    assert np.abs(np.diff(moved[:, 1][:21])).max() < 0.3  # no spikes


def test_one_side_can_make_the_whole_change_and_batches_agree(rng):
    points, faces, upper, lower = slit()
    contact = Contact(points, faces, upper, lower, sigma_mm=3.0, upper_share=1.0)
    batch = np.stack([points, points]).astype(np.float32)
    wanted = np.zeros((2, 21, 3))
    wanted[1, :, 2] = 0.5
    contact.change(batch, wanted)
    assert np.array_equal(batch[0], points.astype(np.float32))
    assert np.array_equal(batch[1, lower], points[lower].astype(np.float32))
    assert np.abs(contact.offsets(batch[1])[:, 2] - 0.5).max() < 0.03


def test_no_change_moves_nothing():
    points, faces, upper, lower = slit()
    moved = points.copy()
    Contact(points, faces, upper, lower, sigma_mm=3.0).change(moved, np.zeros((21, 3)))
    assert np.array_equal(moved, points)
