"""The 3D view of a posed face as an element of a page; the work is done in ``pose_view.js``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import nicegui
from nicegui import ui

_THREE = Path(nicegui.__file__).parent / "elements" / "scene" / "dist"
_OURS = Path(__file__).parent / "static"


class PoseView(
    ui.element, component="pose_view.js", esm={"nicegui-scene": str(_THREE), "facewright-studio": str(_OURS)}
):
    """Show a `PoseHub`'s face and let it be dragged.

    Parameters
    ----------
    address : str
        Where the hub's routes begin, such as ``/pose``.
    """

    def __init__(self, address: str) -> None:
        super().__init__()
        self._props["address"] = address

    def show(self, kinds: Sequence[str]) -> None:
        """Show these kinds of models side by side."""
        self.run_method("show", list(kinds))

    def set_look(self, **changes: bool) -> None:
        """Change how the face is drawn: `regions`, `paint`, `handles`, `wires`."""
        self.run_method("setLook", changes)

    def look_from(self, yaw_degrees: float, pitch_degrees: float) -> None:
        """Look from a direction; (0, 0) is the front."""
        self.run_method("lookFrom", yaw_degrees, pitch_degrees)

    def reload(self) -> None:
        """Fetch the face again."""
        self.run_method("reload")
