"""Functions that the tests run in worker processes, which import them from here."""

import os
import time
from pathlib import Path

from facewright.errors import ValueRangeError
from facewright.numeric.threads import thread_count


def square(k):
    return k * k


def refuse_odd(k):
    if k % 2:
        raise ValueRangeError(f"odd {k}.")
    return k


def succeed_at_last(label, folder, attempts):
    """Fail until the given attempt; each attempt leaves a file."""
    number = len(list(Path(folder).glob(f"{label}-*"))) + 1
    (Path(folder) / f"{label}-{number}").touch()
    if number < attempts:
        raise OSError(5, "Input/output error")
    return number


def die_if(k, dies, folder):
    if dies:
        (Path(folder) / f"{k}-{os.getpid()}").touch()
        os._exit(1)
    time.sleep(0.05)
    return k


def environment(_k):
    import numpy as np

    time.sleep(0.2)
    np.ones((4, 4)) @ np.ones((4, 4))
    try:
        from threadpoolctl import threadpool_info

        blas = max((pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"), default=None)
    except ImportError:
        blas = None
    return {**os.environ, "thread_count": thread_count(), "blas": blas}


def nap(k):
    time.sleep(0.1)
    return k


def interrupt(_k):
    raise KeyboardInterrupt


def old_version():
    return "0.0.1"
