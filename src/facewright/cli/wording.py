"""Small pieces of sentences that several commands say."""

from __future__ import annotations


def counted(number: int, one: str, many: str | None = None) -> str:
    """Return a number with its noun.

    Examples
    --------
    >>> counted(1, "person", "people"), counted(3, "person", "people"), counted(1234, "frame")
    ('1 person', '3 people', '1234 frames')
    """
    return f"{number} {one if number == 1 else many or one + 's'}"


def megabytes(n_bytes: float) -> str:
    """Return a size that people read at a glance.

    Examples
    --------
    >>> megabytes(48_694_000), megabytes(2_500), megabytes(3.2e9)
    ('48.7 MB', '0.0 MB', '3.2 GB')
    """
    return f"{n_bytes / 1e9:.1f} GB" if n_bytes >= 1e9 else f"{n_bytes / 1e6:.1f} MB"
