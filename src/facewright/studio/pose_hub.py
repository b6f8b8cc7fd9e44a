"""One session in the middle, any number of pages around it: drags come in, positions go out, the latest wins."""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import Callable, Coroutine
from typing import Any, Protocol

import numpy as np

from facewright.apps.pose_session import PoseSession
from facewright.apps.posed_character import PosedCharacter
from facewright.errors import FacewrightError, ValueRangeError
from facewright.studio.pose_body import PoseBody

FRAMES_PER_SECOND = 60.0

_DRAG, _POSE = 1, 1
_DRAG_BYTES = 28


class Line(Protocol):
    """Where frames and messages of one page go, such as a WebSocket."""

    async def send_bytes(self, data: bytes) -> None:
        """Send positions."""

    async def send_text(self, data: str) -> None:
        """Send a message."""


class Listener:
    """One page's end of the line: a task sends it the newest positions as fast as it takes them."""

    def __init__(self, hub: PoseHub, line: Line) -> None:
        self.hub, self.line = hub, line
        self.answered = 0  # number of this page's newest drag that the positions contain
        self.drag: tuple[int, int, int, np.ndarray] | None = None
        self.pose_changed = asyncio.Event()
        self.said: list[str] = []

    async def send(self) -> None:
        """Send for ever."""
        while True:
            await self.pose_changed.wait()
            self.pose_changed.clear()
            for text in self.said:
                await self.line.send_text(text)
            self.said.clear()
            self.hub.solve(self)
            await self.line.send_bytes(self.hub.frame(self.answered))


class PoseHub:
    """A session, the character it is shown on, and the pages that look at it.

    Parameters
    ----------
    session : PoseSession
    character : PosedCharacter
    clock : callable, optional
        Seconds, for playback.
    """

    def __init__(
        self, session: PoseSession, character: PosedCharacter, clock: Callable[[], float] = time.perf_counter
    ) -> None:
        self.session = session
        self.body = PoseBody(session, character)
        self.listeners: set[Listener] = set()
        self.on_change: list[Callable[[], None]] = []
        self.on_words: list[Callable[[str, str], None]] = []
        self.loop_playback = True
        self.solve_seconds = 0.0  # of the last drag
        self._clock = clock
        self._stale = True
        self._playing: asyncio.Task[None] | None = None
        self.show_pose()

    # Towards the pages

    def frame(self, answered: int = 0) -> bytes:
        """Return the positions of all kinds as one message: 4 uint32 and 4 float32 of header, then float32 xyz."""
        self._update()
        views = list(self.body.positions.values())
        head = np.array([_POSE, answered, len(views), len(views[0])], dtype="<u4").tobytes()
        state = np.array([self.session.state.time, self.solve_seconds, 0.0, 0.0], dtype="<f4").tobytes()
        return b"".join([head, state, *(view.tobytes() for view in views)])

    def _update(self) -> None:
        if self._stale:
            self.body.update(self.session)
            self._stale = False

    def pins_message(self) -> str:
        """Return where the pins are, as the pages draw them."""
        character = self.body.character
        pins = [
            [vertex, *(round(float(x), 3) for x in character.from_model(vertex, place))]
            for vertex, place in self.session.state.pins.items()
        ]
        return json.dumps({"pins": {kind: pins for kind in self.session.kinds}})

    def show_pose(self) -> None:
        """Let every page have the present positions."""
        self._stale = True
        for listener in self.listeners:
            listener.pose_changed.set()

    def changed(self) -> None:
        """Let every page have positions, pins and what its controls show."""
        message = self.pins_message()
        for listener in self.listeners:
            listener.said.append(message)
        self.show_pose()
        for call in list(self.on_change):
            call()

    def say(self, text: str, kind: str = "info") -> None:
        """Let every page say a sentence."""
        for call in list(self.on_words):
            call(text, kind)

    def set_character(self, character: PosedCharacter) -> None:
        """Show the pose on another character; pages must fetch its packet again."""
        self.body = PoseBody(self.session, character)
        self.changed()

    # From the pages

    async def serve(self, line: Line, receive: Callable[[], Coroutine[Any, Any, bytes | str | None]]) -> None:
        """Serve one page until `receive` returns None."""
        listener = Listener(self, line)
        self.listeners.add(listener)
        listener.said.append(self.pins_message())
        listener.pose_changed.set()
        sender = asyncio.create_task(listener.send())
        try:
            while (message := await receive()) is not None:
                self.take(listener, message)
        finally:
            self.listeners.discard(listener)
            sender.cancel()
            if self.session.dragging and not self.listeners:  # the page went away with a vertex in its hand
                self._attempt(self.session.release)

    def take(self, listener: Listener, message: bytes | str) -> None:
        """Take one message of a page: a drag, or something to do."""
        if isinstance(message, bytes):
            if len(message) != _DRAG_BYTES:
                return
            tag, number, vertex, kind = np.frombuffer(message, "<u4", 4)
            if tag == _DRAG:
                listener.drag = (int(number), int(vertex), int(kind), np.frombuffer(message, "<f4", 3, 16))
                listener.pose_changed.set()
            return
        self.solve(listener)
        try:
            request = json.loads(message)
            what = str(request["do"])
        except (ValueError, KeyError, TypeError):
            return
        self.do(what, request.get("vertex"))

    def solve(self, listener: Listener) -> None:
        """Solve a page's newest drag, if it has one that is not solved."""
        if listener.drag is None:
            return
        number, vertex, _, point = listener.drag
        listener.drag, listener.answered = None, number
        self.pause()
        begun = time.perf_counter()

        def drag() -> None:
            if not 0 <= vertex < self.session.model.n_vertices:
                raise ValueRangeError(f"vertex must lie in [0, {self.session.model.n_vertices}), got {vertex}.")
            self.session.drag(vertex, self.body.character.to_model(vertex, point))

        if self._attempt(drag):
            self._stale = True
            self._update()
            self.solve_seconds = time.perf_counter() - begun
            for other in self.listeners - {listener}:
                other.pose_changed.set()

    def do(self, what: str, vertex: Any = None) -> None:
        """Do what a page asks for by name, and tell all pages."""
        session = self.session
        deeds: dict[str, Callable[[], object]] = {
            "release": session.release,
            "cancel": session.cancel,
            "pin": lambda: session.pin(vertex),
            "unpin": lambda: session.unpin(vertex),
            "unpin all": session.unpin_all,
            "undo": session.undo if session.dragging or session.undo_label else lambda: None,
            "redo": session.redo if session.redo_label else lambda: None,
            "reset": session.reset,
            "play or pause": self.play_or_pause,
            "look again": lambda: None,
        }
        if what in ("pin", "unpin") and not isinstance(vertex, int):
            return
        if what in deeds:
            self.attempt(deeds[what])

    def attempt(self, deed: Callable[[], object]) -> bool:
        """Do something to the session and tell all pages; a mistake becomes a sentence. Returns whether it was done."""
        done = self._attempt(deed)
        self.changed()
        return done

    def _attempt(self, deed: Callable[[], object]) -> bool:
        try:
            said = deed()
        except FacewrightError as error:
            self.say(str(error), "negative")
            return False
        if isinstance(said, tuple):
            for sentence in said:
                self.say(str(sentence), "warning")
        return True

    # Playback

    @property
    def playing(self) -> bool:
        """Whether the timeline runs."""
        return self._playing is not None

    def play_or_pause(self) -> None:
        """Run the timeline from where it stands, or stop it."""
        if self._playing is not None:
            self.pause()
            return
        if len(self.session.keyframes) < 2:
            raise ValueRangeError("playback needs at least two keyframes: pose the face and set keys (K) at two times.")
        self._playing = asyncio.get_running_loop().create_task(self._play())

    def pause(self) -> None:
        """Stop the timeline where it stands."""
        if self._playing is not None:
            self._playing.cancel()
            self._playing = None

    async def _play(self) -> None:
        keys = self.session.keyframes
        start = self.session.state.time
        if start >= keys.duration or start < keys.times[0]:
            start = float(keys.times[0])
        begun = self._clock()
        while True:
            keys = self.session.keyframes
            if len(keys) < 2:
                break
            at = start + self._clock() - begun
            if at > keys.duration:
                if not self.loop_playback:
                    break
                begun, start = self._clock(), float(keys.times[0])
                at = start
            self.session.seek(at)
            self.show_pose()
            await asyncio.sleep(1.0 / FRAMES_PER_SECOND)
        self._playing = None
        self.session.seek(keys.duration)
        self.changed()
