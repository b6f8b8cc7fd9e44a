"""The whole error tree: every error a user can cause is a FacewrightError with one clear sentence."""


class FacewrightError(Exception):
    """Base of all errors that the library raises on purpose; the command line shows it and exits with 2."""


class ShapeError(FacewrightError, ValueError):
    """An array has the wrong shape; the message gives name, expected and found."""


class ValueRangeError(FacewrightError, ValueError):
    """A value is outside its domain (NaN, negative, unknown name); the message gives expected and found."""


class DegenerateError(FacewrightError, ValueError):
    """The input does not determine the answer (collinear points, zero-area triangles, singular system)."""


class TopologyError(FacewrightError, ValueError):
    """A mesh is not of the topology that the model or the operation needs."""


class FileFormatError(FacewrightError, ValueError):
    """A file is truncated, corrupt, foreign or of a newer version; the message names the file."""


class StoreError(FacewrightError, OSError):
    """A file or store cannot be read or written (missing, no space, no permission)."""


class NoFaceError(FacewrightError):
    """No face was found in a picture."""


class MissingExtraError(FacewrightError, ImportError):
    """An optional dependency is absent; the message says which extra to install."""


class MissingFaceError(FacewrightError, LookupError):
    """A face is unknown or not installed; the message says how to install it."""


class ConvergenceWarning(UserWarning):
    """An iteration stopped at its limit before it met its tolerance."""
