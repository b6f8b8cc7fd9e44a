"""Where face geometry comes from: the built-in face, ICT-FaceKit, simulated people."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from facewright.faces.face import Face
    from facewright.faces.load import FaceInfo, list_faces, load_face

__all__ = ["Face", "FaceInfo", "list_faces", "load_face"]


def __getattr__(name: str) -> Any:
    # Resolved on first use, so that importing the package stays light.
    if name == "Face":
        from facewright.faces.face import Face

        return Face
    if name in __all__:
        from facewright.faces import load

        return getattr(load, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
