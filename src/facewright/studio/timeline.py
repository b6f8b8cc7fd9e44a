"""The timeline of a page: keyframes to grab, a playhead to scrub; drawn in ``timeline.js``."""

from __future__ import annotations

from collections.abc import Callable

from nicegui import events, ui


class Timeline(ui.element, component="timeline.js"):
    """Show keyframes in time.

    Parameters
    ----------
    on_seek : callable
        Called with a time, seconds, while the playhead is dragged.
    on_move : callable
        Called with a keyframe's number and its new time.
    """

    def __init__(self, on_seek: Callable[[float], None], on_move: Callable[[int, float], None]) -> None:
        super().__init__()
        self._props.update(times=[], time=0.0, span=4.0, selected=-1)

        def moved(event: events.GenericEventArguments) -> None:
            on_move(int(event.args["index"]), float(event.args["time"]))

        self.on("seek", lambda event: on_seek(float(event.args)), throttle=0.03, leading_events=True)
        self.on("move", moved)

    def set(self, times: list[float], time: float, selected: int) -> None:
        """Show keyframes at `times`, the playhead at `time`, one keyframe (or -1) as chosen."""
        span = max(4.0, 1.25 * max([time, *times]))
        self._props.update(times=times, time=time, span=span, selected=selected)
        self.update()
