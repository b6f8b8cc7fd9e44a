"""The server of a page: routes for its binary line, and NiceGUI around it."""

from __future__ import annotations

import socket
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from facewright.apps.pose_session import PoseSession
from facewright.apps.posed_character import PosedCharacter
from facewright.errors import MissingExtraError, ValueRangeError
from facewright.studio.pose_hub import PoseHub

#: Where pages are served unless another port is asked for.
PORT = 8437


@dataclass(frozen=True)
class StudioOptions:
    """How a page is served.

    Parameters
    ----------
    port : int
        TCP port; 0 takes a free one.
    host : str
        Address to listen at; only this machine by default.
    show : bool
        Open a browser.
    title : str
        Name of the model, shown on the page.
    folder : Path
        Where exports go unless another place is typed.
    """

    port: int = PORT
    host: str = "127.0.0.1"
    show: bool = True
    title: str = ""
    folder: Path = Path()


def check_studio() -> None:
    """Raise MissingExtraError where NiceGUI is not installed."""
    try:
        import nicegui  # noqa: F401
    except ImportError as error:
        raise MissingExtraError('the page needs NiceGUI: install it by pip install "facewright[studio]".') from error


def serve_pose_page(
    session: PoseSession, character: PosedCharacter, options: StudioOptions, ready: Callable[[str], None] | None = None
) -> None:
    """Serve the posing page until it is interrupted.

    Parameters
    ----------
    session : PoseSession
        One for all browser tabs.
    character : PosedCharacter
        What the pose is shown on at first.
    options : StudioOptions
    ready : callable, optional
        Called with the page's address once it answers.

    Raises
    ------
    MissingExtraError
        If NiceGUI is not installed.
    ValueRangeError
        If the port is taken.
    """
    check_studio()
    port = _free_port(options.host, options.port)
    from nicegui import app, ui

    from facewright.studio.pose_page import PosePage

    hub = PoseHub(session, character)
    _add_routes(app, hub)

    def root() -> None:
        PosePage(hub, options.title, options.folder)

    if ready is not None:
        app.on_startup(lambda: ready(f"http://{options.host}:{port}/"))
    with suppress(KeyboardInterrupt):  # the way to end it
        _run(ui, root, port, options)


def _run(ui: Any, root: Callable[[], None], port: int, options: StudioOptions) -> None:
    ui.run(
        root,
        host=options.host,
        port=port,
        title="facewright pose",
        dark=True,
        show=options.show,
        reload=False,
        show_welcome_message=False,
        favicon=str(Path(__file__).parent / "static" / "icon.svg"),
        ws_max_size=1 << 20,
        access_log=False,
        reconnect_timeout=30.0,  # a busy browser is no lost one
    )


def _add_routes(app: Any, hub: PoseHub) -> None:
    """Add the binary routes of a hub: the face that stays, and the line of what moves."""
    from starlette.responses import Response
    from starlette.websockets import WebSocket, WebSocketDisconnect

    async def body() -> Response:
        return Response(hub.body.packet(hub.session), media_type="application/octet-stream", headers=_FRESH)

    async def stream(socket: WebSocket) -> None:
        origin = socket.headers.get("origin")
        if origin is not None and urlsplit(origin).netloc != socket.headers.get("host"):
            await socket.close(code=1008)  # a page of another site
            return
        await socket.accept()

        async def receive() -> bytes | str | None:
            try:
                message = await socket.receive()
            except (WebSocketDisconnect, RuntimeError):
                return None
            if message["type"] != "websocket.receive":
                return None
            return message.get("bytes") or message.get("text") or ""

        await hub.serve(socket, receive)

    # Annotations are text here, and FastAPI must see the class.
    stream.__annotations__["socket"] = WebSocket
    body.__annotations__.clear()
    app.add_api_route("/pose/body.bin", body, include_in_schema=False, response_model=None)
    app.add_api_websocket_route("/pose/stream", stream)


_FRESH = {"Cache-Control": "no-store"}


def _free_port(host: str, port: int) -> int:
    """Return the port, or a free one for 0, after trying to listen there."""
    with socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((host, port))
        except (OSError, OverflowError) as error:
            reason = getattr(error, "strerror", None) or error
            raise ValueRangeError(
                f"the page must be able to listen at {host}:{port}, got: {reason}; give another --port, or 0 for any."
            ) from error
        return int(probe.getsockname()[1])
