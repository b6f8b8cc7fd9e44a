import numpy as np

from facewright.evaluation.peak_memory import PeakMemory, highest_resident_mb, resident_mb


def test_peak_sees_memory_that_is_given_back():
    with PeakMemory(0.001) as memory:
        block = np.ones(20_000_000)
        block += 1
        del block
    assert 120 < memory.extra_mb < 260


def test_peak_of_nothing_is_small():
    with PeakMemory() as memory:
        pass
    assert memory.extra_mb < 20


def test_highest_is_at_least_current():
    assert 0 < resident_mb() <= highest_resident_mb() * 1.01
