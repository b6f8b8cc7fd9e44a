"""What a worker process of a build does when it starts: Ctrl-C is for the process that started it."""

from __future__ import annotations

import signal
from contextlib import suppress


def dask_setup(_worker: object) -> None:
    """Ignore Ctrl-C, which a terminal sends to the workers as well; Dask calls this in each worker."""
    with suppress(ValueError):  # not in the main thread: nothing to ignore there
        signal.signal(signal.SIGINT, signal.SIG_IGN)
