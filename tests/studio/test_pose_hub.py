import asyncio
import json

import numpy as np
import pytest

from facewright.apps.pose_session import PoseSession
from facewright.apps.posed_character import load_character
from facewright.studio.pose_hub import PoseHub


class _Page:
    """A page at the other end of the line."""

    def __init__(self):
        self.frames, self.texts, self.inbox = [], [], asyncio.Queue()

    async def send_bytes(self, data):
        self.frames.append(data)

    async def send_text(self, data):
        self.texts.append(json.loads(data))

    async def receive(self):
        return await self.inbox.get()

    def drag(self, number, vertex, point, kind=0):
        head = np.array([1, number, vertex, kind], "<u4").tobytes()
        self.inbox.put_nowait(head + np.array(point, "<f4").tobytes())

    def ask(self, what, **details):
        self.inbox.put_nowait(json.dumps({"do": what, **details}))

    def newest(self):
        tag, answered, kinds, V = np.frombuffer(self.frames[-1], "<u4", 4)
        assert tag == 1
        values = np.frombuffer(self.frames[-1], "<f4", offset=32).reshape(kinds, V, 3)
        return int(answered), values


@pytest.fixture
def hub(face_models):
    session = PoseSession(face_models[0], holistic=face_models[1])
    return PoseHub(session, load_character("none", session.models))


def _run(hub, story, pages=1):
    """Let pages be served while a story happens."""

    async def main():
        made = [_Page() for _ in range(pages)]
        serving = [asyncio.create_task(hub.serve(page, page.receive)) for page in made]
        await asyncio.sleep(0.01)
        await story(*made)
        for page in made:
            page.inbox.put_nowait(None)
        await asyncio.gather(*serving)

    asyncio.run(main())


def test_drags_come_in_and_positions_go_out_to_every_page(hub):
    session = hub.session
    target = session.model.neutral[50] + [0, 4, 1]

    async def story(first, second):
        for number in range(1, 30):
            first.drag(number, 50, target)
        await asyncio.sleep(0.05)
        answered, views = first.newest()
        assert answered == 29
        np.testing.assert_array_equal(views[0], session.positions())
        np.testing.assert_array_equal(views[1], session.positions("holistic"))
        assert len(first.frames) < 10  # the latest wins
        np.testing.assert_array_equal(second.newest()[1], views)
        first.drag(30, 50, target + [0, 1, 0])
        first.ask("release")
        await asyncio.sleep(0.05)
        assert not session.dragging and session.undo_label == "drag"
        np.testing.assert_array_equal(second.newest()[1][0], session.positions())
        first.ask("pin", vertex=50)
        await asyncio.sleep(0.05)
        assert second.texts[-1]["pins"]["region"][0][0] == 50
        first.ask("undo")
        first.ask("undo")
        first.ask("undo")  # one too many: nothing
        await asyncio.sleep(0.05)
        assert not session.state.pins and session.undo_label is None

    _run(hub, story, pages=2)


def test_what_a_page_gets_wrong_is_one_sentence(hub):
    said = []
    hub.on_words.append(lambda text, kind: said.append((kind, text)))

    async def story(page):
        page.drag(1, 10**6, [0, 0, 0])
        await asyncio.sleep(0.02)
        page.drag(2, 5, [0, np.nan, 0])
        await asyncio.sleep(0.02)
        page.ask("pin", vertex=9999)
        page.ask("play or pause")
        page.ask("pin", vertex="me")
        page.ask("format the disk")
        page.inbox.put_nowait(b"\0" * 5)
        page.inbox.put_nowait("not JSON")
        page.inbox.put_nowait("[1]")
        await asyncio.sleep(0.02)

    _run(hub, story)
    assert [kind for kind, _ in said] == ["negative"] * 4
    assert (
        "vertex" in said[0][1] and "finite" in said[1][1] and "vertex" in said[2][1] and "two keyframes" in said[3][1]
    )
    assert not hub.session.dragging


def test_a_page_that_leaves_lets_go(hub):
    async def story(page):
        page.drag(1, 50, hub.session.model.neutral[50] + [0, 4, 1])
        await asyncio.sleep(0.05)
        assert hub.session.dragging

    _run(hub, story)
    assert not hub.session.dragging and not hub.listeners


def test_playback_shows_what_the_keyframes_say(hub):
    session = hub.session
    now = [0.0]
    hub._clock = lambda: now[0]
    session.set_key(0.0)
    session.drag(50, session.model.neutral[50] + [0, 4, 1])
    session.set_key(1.0)

    async def story(page):
        page.ask("play or pause")
        await asyncio.sleep(0.05)
        assert hub.playing
        for time in (0.25, 0.6):
            now[0] = time
            await asyncio.sleep(0.05)
            np.testing.assert_allclose(session.coefficients(), session.sample([time])[0])
            np.testing.assert_array_equal(page.newest()[1][0], session.positions())
        now[0] = 1.2  # and round again
        await asyncio.sleep(0.05)
        assert hub.playing and session.state.time < 0.5
        hub.loop_playback = False
        now[0] = 9.0
        await asyncio.sleep(0.06)
        assert not hub.playing and session.state.time == 1.0

    _run(hub, story)
