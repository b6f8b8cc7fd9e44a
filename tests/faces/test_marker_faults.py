import numpy as np

from facewright.faces.marker_faults import MarkerFaults, draw_faults, faulty_markers

TIMES = np.arange(1200) / 120.0


def test_dropouts_are_rare_last_a_while_and_favour_the_rim(rng):
    grid = np.stack(np.meshgrid(np.arange(15.0), np.arange(15.0), [0.0]), axis=-1).reshape(-1, 3)
    truth = np.repeat(10.0 * grid[None], len(TIMES), axis=0)
    faults = draw_faults(truth, TIMES, rng)
    unseen = 1 - faults.seen.mean(axis=0)
    assert 0.003 < unseen.mean() < 0.05 and faults.seen[0].all()
    rim = np.linalg.norm(grid - grid.mean(axis=0), axis=1) > 8.0
    assert unseen[rim].mean() > unseen[~rim].mean()
    starts = ((~faults.seen[1:]) & faults.seen[:-1]).sum()
    assert 5 < (~faults.seen).sum() / starts < 60  # frames each


def test_swaps_are_of_neighbours_and_do_not_overlap(rng):
    truth = np.repeat(rng.uniform(0, 100, (1, 80, 3)), len(TIMES), axis=0)
    swaps = [swap for _ in range(10) for swap in draw_faults(truth, TIMES, rng).swaps]
    assert 5 < len(swaps) < 50
    rank = np.argsort(np.argsort(np.linalg.norm(truth[0][:, None] - truth[0][None], axis=2), axis=1), axis=1)
    assert all(0 < rank[a, b] <= 3 and 1 <= start < stop <= len(TIMES) for a, b, start, stop in swaps)


def test_faults_do_what_they_say(rng):
    truth = rng.uniform(0, 100, (50, 6, 3))
    seen = np.ones((50, 6), bool)
    seen[10:20, 2] = False
    found = faulty_markers(truth, MarkerFaults(seen, ((2, 4, 15, 30),)), 0.2, rng)
    assert np.isnan(found[10:15, 2]).all() and np.isnan(found[15:20, 4]).all() and not np.isnan(found[15:20, 2]).any()
    assert np.abs(found[15:30, 2] - truth[15:30, 4]).max() < 1.2
    error = (found - truth)[30:]
    assert 0.17 < error.std() < 0.23 and not np.isnan(error).any()


def test_a_single_frame_and_a_single_marker_have_no_faults(rng):
    for shape, times in (((1, 4, 3), TIMES[:1]), ((5, 1, 3), TIMES[:5])):
        faults = draw_faults(np.zeros(shape), times, rng)
        assert faults.swaps == () and faults.seen[0].all()
