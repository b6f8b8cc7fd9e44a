"""How much memory a piece of work needs."""

from __future__ import annotations

import os
import sys
import threading
import time
from pathlib import Path
from types import TracebackType


def resident_mb() -> float:
    """Return the resident memory of this process, MB (10^6 bytes)."""
    statm = Path("/proc/self/statm")
    if statm.is_file():
        return int(statm.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6
    return highest_resident_mb()


def highest_resident_mb() -> float:
    """Return the highest resident memory that this process ever had, MB."""
    status = Path("/proc/self/status")
    if status.is_file():  # getrusage would count the parent's memory from before exec
        for line in status.read_text().splitlines():
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) * 1024 / 1e6
    import resource

    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak * (1 if sys.platform == "darwin" else 1024) / 1e6


class PeakMemory:
    """Context that samples resident memory from a thread; `extra_mb` is the peak above the start.

    Examples
    --------
    >>> import numpy as np
    >>> with PeakMemory() as memory:
    ...     ones = np.ones(30_000_000)  # 240 MB
    >>> 150 < memory.extra_mb < 350
    True
    """

    def __init__(self, interval_s: float = 0.005) -> None:
        self.interval_s = interval_s
        self.extra_mb = 0.0

    def __enter__(self) -> PeakMemory:
        self._start = resident_mb()
        self._done = threading.Event()
        self._thread = threading.Thread(target=self._sample, daemon=True)
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._look()
        self._done.set()
        self._thread.join()

    def _look(self) -> None:
        self.extra_mb = max(self.extra_mb, resident_mb() - self._start)

    def _sample(self) -> None:
        while not self._done.is_set():
            self._look()
            time.sleep(self.interval_s)
