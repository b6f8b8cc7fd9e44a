"""The page of `facewright pose`: a face to pull into shape, its behaviour, pins, timeline and export."""

from __future__ import annotations

from pathlib import Path

from nicegui import Client, events, ui

from facewright.apps.pose_session import BETA, GAMMA
from facewright.studio.pose_dialogs import export_dialog
from facewright.studio.pose_hub import PoseHub
from facewright.studio.pose_view import PoseView
from facewright.studio.timeline import Timeline

CSS = Path(__file__).parent / "static" / "pose.css"

#: (label, beta, gamma, what it does) of the presets, after the paper's Fig. 2.
PRESETS = (
    ("Local", BETA, GAMMA, "The paper's values: the region follows, its neighbours give way a little."),
    ("Soft", 2.0, 0.0025, "Motion spreads: boundaries stay together and shapes are free, nearly as a holistic model."),
    ("Stiff", 0.5, 0.25, "Shapes resist: small, careful changes close to the hand."),
)
_BETA_TOP, _GAMMA_LOW, _GAMMA_HIGH = 10.0, 1e-4, 1.0


class PosePage:
    """One browser tab on a hub's session.

    Parameters
    ----------
    hub : PoseHub
    title : str
        Name of the model.
    folder : Path
        Where exports go.
    """

    def __init__(self, hub: PoseHub, title: str, folder: Path) -> None:
        self.hub = hub
        self.folder = folder
        self.client: Client = ui.context.client
        self.shown = "region"
        self._quiet = False  # while controls are set from the session, not by a hand
        ui.add_css(CSS)
        ui.dark_mode(True)
        ui.colors(primary="#f2b84b", dark_page="#14161c", positive="#5fb878", negative="#d9534f", warning="#d99a2b")
        with ui.element("div").classes("studio"):
            self._bar(title)
            with ui.element("div").classes("studio-view"):
                self.view = PoseView("/pose")
                self.view.on("shortcut", self._on_shortcut)
            with ui.column().classes("studio-side"):
                self._behaviour()
                self._display()
                self._pins()
            self._timeline()
            self._status()
        hub.on_change.append(self.refresh)
        hub.on_words.append(self.say)
        self.client.on_delete(self._leave)
        self.refresh()

    # Parts of the page

    def _bar(self, title: str) -> None:
        session = self.hub.session
        with ui.element("div").classes("studio-bar"):
            ui.html("face<b>wright</b>", sanitize=False).classes("brand")
            ui.label(title).classes("model")
            self.undo = self._button("undo", "Undo (Ctrl+Z)", lambda: self.hub.do("undo"))
            self.redo = self._button("redo", "Redo (Ctrl+Shift+Z)", lambda: self.hub.do("redo"))
            self._button("restart_alt", "Back to the neutral face; keyframes stay", lambda: self.hub.do("reset"))
            ui.element("div").classes("rule")
            with ui.row().classes("from gap-0 no-wrap"):
                for label, tip, yaw in (
                    ("Front", "From the front (F)", 0.0),
                    ("¾", "From three quarters", 35.0),
                    ("Side", "From the side", 80.0),
                ):
                    button = ui.button(
                        label, on_click=lambda y=yaw: self.view.look_from(y, 4.0 if y else 0.0), color=None
                    )
                    button.props("flat dense no-caps").tooltip(tip)
            ui.element("div").classes("gap")
            if "holistic" in session.kinds:
                choices = {"region": "Region-based", "both": "Side by side", "holistic": "Holistic"}
                self.views = ui.toggle(choices, value="region", on_change=lambda e: self._show(e.value))
                self.views.props('no-caps unelevated dense toggle-class="chosen"')
                self.views.tooltip("The same constraints on a region-based and on a holistic model")
                ui.element("div").classes("gap")
            self._character()
            export = ui.button("Export", icon="ios_share", on_click=self._export)
            export.props("no-caps unelevated dense text-color=grey-10").classes("q-px-md").tooltip(
                "Write an animation, meshes or coefficients"
            )

    def _character(self) -> None:
        from facewright.apps.posed_character import load_character
        from facewright.errors import FacewrightError

        names = {"builtin": "Built-in face", "ict": "ICT face", "none": "Model's mesh"}
        here = self.hub.body.character.name
        names.setdefault(here, here)

        def choose(name: str) -> None:
            if self._quiet or name == self.hub.body.character.name:
                return
            try:
                character = load_character(name, self.hub.session.models)
            except FacewrightError as error:
                self.say(str(error), "negative")
                self.refresh()
                return
            self.hub.set_character(character)

        self.character = ui.select(names, value=here, on_change=lambda event: choose(event.value))
        self.character.props("dense borderless options-dense").classes("q-mr-md").tooltip("The face that is driven")
        self._drawn = self.hub.body

    def _behaviour(self) -> None:
        with ui.element("div").classes("part"):
            ui.label("Behaviour").classes("title")
            self.beta, self.beta_text = self._slider(
                "Boundaries", "β", 0.0, 1.0, "How firmly neighbouring regions hold together where they meet.",
                ("loose", "firm"), lambda x: self._set_weights(beta=_beta_of(x)),
            )  # fmt: skip
            self.gamma, self.gamma_text = self._slider(
                "Resistance", "γ", 0.0, 1.0, "How much shapes resist change: low spreads a pull over the face, high "
                "keeps it near the hand.", ("yielding", "stiff"), lambda x: self._set_weights(gamma=_gamma_of(x)),
            )  # fmt: skip
            with ui.element("div").classes("presets"):
                for label, beta, gamma, tip in PRESETS:
                    button = ui.button(label, on_click=lambda b=beta, g=gamma: self._set_weights(b, g), color=None)
                    button.props("flat no-caps dense").tooltip(f"{tip} β {beta:g}, γ {gamma:g}")
            self.symmetric = ui.switch("Symmetric", on_change=lambda e: self._set_symmetric(e.value))
            self.symmetric.props("dense left-label").tooltip("The other side of the face does the same (S)")

    def _display(self) -> None:
        with ui.element("div").classes("part"):
            ui.label("Display").classes("title")
            self.look = {}
            for name, label, key, value, tip in (
                ("regions", "Region colours", "R", False, "Tint each region"),
                ("paint", "Skin paint", "C", True, "Painted skin, else clay"),
                ("handles", "Control points", "D", False, "Show every point that can be dragged"),
                ("wires", "Wireframe", "W", False, "Show the mesh"),
            ):
                switch = ui.switch(label, value=value, on_change=lambda e, n=name: self.view.set_look(**{n: e.value}))
                switch.props("dense left-label").tooltip(f"{tip} ({key})")
                self.look[key.lower()] = switch

    def _pins(self) -> None:
        with ui.element("div").classes("part"):
            with ui.element("div").classes("row"):
                ui.label("Pins").classes("title")
                self.unpin_all = ui.button("Clear", on_click=lambda: self.hub.do("unpin all"), color=None)
                self.unpin_all.props("flat dense no-caps size=sm").classes("text-quiet").tooltip("Let all pins go")
            self.pins = ui.element("div").classes("w-full")

    def _timeline(self) -> None:
        hub = self.hub
        with ui.element("div").classes("studio-time"):
            with ui.element("div").classes("transport"):
                with ui.element("div").classes("line"):
                    self._button("first_page", "To the first keyframe (Home)", lambda: self._step(-2))
                    self.play = self._button("play_arrow", "Play or pause (Space)", lambda: hub.do("play or pause"))
                    self._button("last_page", "To the last keyframe (End)", lambda: self._step(2))
                    loop = (
                        ui.button(icon="repeat", color=None)
                        .props("flat dense round size=sm")
                        .tooltip("Play again and again")
                    )
                    loop.on_click(lambda: self._toggle_loop(loop))
                    self.clock = ui.label().classes("clock")
                with ui.element("div").classes("line"):
                    key = ui.button(
                        "Set key", icon="add", on_click=lambda: hub.attempt(hub.session.set_key), color=None
                    )
                    key.props("flat dense no-caps size=12px").tooltip("Keep this pose at this time (K)")
                    self.delete = ui.button("Delete", icon="close", on_click=self._delete_key, color=None)
                    self.delete.props("flat dense no-caps size=12px").classes("text-quiet").tooltip(
                        "Remove the keyframe at this time (Delete)"
                    )
            self.timeline = Timeline(on_seek=self._seek, on_move=self._move_key)

    def _status(self) -> None:
        with ui.element("div").classes("studio-status"):
            ui.html(
                "<kbd>drag</kbd> move a point &ensp; <kbd>Shift</kbd>+<kbd>click</kbd> pin &ensp; <kbd>wheel</kbd> "
                "while dragging: depth &ensp; drag beside the face: turn &ensp; <kbd>Ctrl</kbd>+<kbd>Z</kbd> undo",
                sanitize=False,
            )
            ui.element("div").classes("gap")
            self.state = ui.label().classes("state")
            self.saved = ui.label()

    def _button(self, icon: str, tip: str, call: object) -> ui.button:
        button = ui.button(icon=icon, on_click=call, color=None).props("flat dense round size=sm")  # type: ignore[arg-type]
        return button.tooltip(tip)

    def _slider(self, name, symbol, low, high, tip, ends, call):  # type: ignore[no-untyped-def]
        with ui.element("div").classes("row q-mt-xs"):
            ui.html(f"{name}<i>{symbol}</i>", sanitize=False).classes("name").tooltip(tip)
            value = ui.label().classes("value")
        slider = ui.slider(min=low, max=high, step=0.002, value=low)
        slider.on_value_change(lambda event: None if self._quiet else call(event.value))
        with ui.element("div").classes("ends"):
            ui.label(ends[0])
            ui.label(ends[1])
        return slider, value

    # What a hand does

    def _set_weights(self, beta: float | None = None, gamma: float | None = None) -> None:
        self.hub.attempt(lambda: self.hub.session.set_weights(beta, gamma))

    def _set_symmetric(self, symmetric: bool) -> None:
        if not self._quiet:
            self.hub.attempt(lambda: self.hub.session.set_symmetric(symmetric))

    def _export(self) -> None:
        export_dialog(self.hub, self.folder, "holistic" if self.shown == "holistic" else "region")

    def _show(self, which: str) -> None:
        self.shown = which
        self.view.show(["region", "holistic"] if which == "both" else [which])

    def _seek(self, time: float) -> None:
        self.hub.pause()
        self.hub.attempt(lambda: self.hub.session.seek(time) is None)

    def _move_key(self, index: int, time: float) -> None:
        def move() -> None:
            self.hub.session.move_key(index, round(time, 2))
            self.hub.session.seek(round(time, 2))

        self.hub.attempt(move)

    def _step(self, by: int) -> None:
        """Go to the keyframe before (-1) or after (1) here, or to the first (-2) or last (2)."""
        times = self.hub.session.keyframes.times
        now = self.hub.session.state.time
        if not len(times):
            self._seek(0.0)
            return
        near = {-1: times[times < now - 1e-3][-1:], 1: times[times > now + 1e-3][:1], -2: times[:1], 2: times[-1:]}[by]
        if len(near):
            self._seek(float(near[0]))

    def _delete_key(self) -> None:
        session = self.hub.session
        index = session.keyframes.index_at(session.state.time, 0.02)
        if index is None:
            self.say("There is no keyframe at this time to delete.", "info")
        else:
            self.hub.attempt(lambda: session.delete_key(index))

    def _toggle_loop(self, button: ui.button) -> None:
        self.hub.loop_playback = not self.hub.loop_playback
        button.classes(remove="text-quiet") if self.hub.loop_playback else button.classes(add="text-quiet")

    def _on_shortcut(self, event: events.GenericEventArguments) -> None:
        key = str(event.args)
        if key in self.look:
            self.look[key].set_value(not self.look[key].value)
        elif key == "k":
            self.hub.attempt(self.hub.session.set_key)
        elif key == "s":
            self.symmetric.set_value(not self.symmetric.value)
        elif key == "h" and "holistic" in self.hub.session.kinds:
            self.views.set_value("region" if self.shown == "both" else "both")
        elif key in ("ArrowLeft", "ArrowRight", "Home", "End"):
            self._step({"ArrowLeft": -1, "ArrowRight": 1, "Home": -2, "End": 2}[key])
        elif key == "Delete":
            self._delete_key()

    # What the page shows of the session

    def refresh(self) -> None:
        """Bring all controls to the session's state."""
        session, hub = self.hub.session, self.hub
        state = session.state
        self._quiet = True
        self.beta.value, self.gamma.value = _place_of_beta(state.beta), _place_of_gamma(state.gamma)
        self.beta_text.text, self.gamma_text.text = f"{state.beta:.3g}", f"{state.gamma:.3g}"
        self.symmetric.value = state.symmetric
        self.character.value = hub.body.character.name
        self._quiet = False
        self.undo.set_enabled(session.undo_label is not None)
        self.redo.set_enabled(session.redo_label is not None)
        self.play.props(f"icon={'pause' if hub.playing else 'play_arrow'}")
        times = session.keyframes.times.tolist()
        selected = session.keyframes.index_at(state.time, 0.02)
        self.timeline.set(times, state.time, -1 if selected is None else selected)
        self.delete.set_enabled(selected is not None)
        keys = f"{len(times)} key{'' if len(times) == 1 else 's'}"
        self.clock.text = f"{keys}, {session.keyframes.duration:.2f} s" if times else "no keys"
        mean, most = session.boundary_gap()
        self.state.text = f"boundaries {mean:.2f} mm apart before blending (most {most:.2f})"
        self.saved.text = f"saved in {session.autosave.name}" if session.autosave else "not saved"
        self._list_pins()
        if self._drawn is not hub.body:
            self._drawn = hub.body
            self.view.reload()

    def _list_pins(self) -> None:
        session = self.hub.session
        pins = tuple(session.state.pins)
        if pins == getattr(self, "_listed", None):
            return
        self._listed = pins
        self.unpin_all.set_enabled(bool(pins))
        self.pins.clear()
        with self.pins:
            if not pins:
                ui.label("None. Shift+click a point to hold it in place while you drag others.").classes("quiet")
            for vertex in pins:
                with ui.element("div").classes("pin-row"):
                    ui.html(f'<span class="dot"></span>Vertex {vertex}', sanitize=False)
                    self._button("close", "Let it go", lambda v=vertex: self.hub.do("unpin", v))

    def say(self, text: str, kind: str) -> None:
        """Show a sentence for a few seconds."""
        with self.client:
            ui.notify(text, type=kind, position="bottom", timeout=6000, multi_line=len(text) > 90)  # type: ignore[arg-type]

    def _leave(self) -> None:
        self.hub.on_change.remove(self.refresh)
        self.hub.on_words.remove(self.say)


def _beta_of(place: float) -> float:
    return round(_BETA_TOP * place**3, 3)


def _place_of_beta(beta: float) -> float:
    return min(1.0, (beta / _BETA_TOP) ** (1 / 3))


def _gamma_of(place: float) -> float:
    return float(f"{_GAMMA_LOW * (_GAMMA_HIGH / _GAMMA_LOW) ** place:.3g}")


def _place_of_gamma(gamma: float) -> float:
    import math

    if gamma <= _GAMMA_LOW:
        return 0.0
    return min(1.0, math.log(gamma / _GAMMA_LOW) / math.log(_GAMMA_HIGH / _GAMMA_LOW))
