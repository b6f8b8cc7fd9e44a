"""Dialogs of the posing page."""

from __future__ import annotations

from pathlib import Path

from nicegui import run, ui

from facewright.studio.pose_hub import PoseHub

_FORMATS = {
    "glb": "Animation (glTF, .glb)",
    "obj": "Mesh sequence (folder of OBJ)",
    "ply": "Mesh sequence (folder of PLY)",
    "csv": "Coefficients (CSV)",
}


def export_dialog(hub: PoseHub, folder: Path, kind: str) -> None:
    """Ask for format, place and rate, and write the animation of a kind of model."""
    from facewright.apps.pose_export import PoseExportRequest, export_pose
    from facewright.errors import FacewrightError

    with ui.dialog(value=True) as dialog, ui.card().classes("studio-dialog"):
        ui.html("<h3>Export</h3>", sanitize=False)
        n = len(hub.session.keyframes)
        what = f"{n} keyframes, {hub.session.keyframes.duration:.2f} s" if n else "no keyframes: the present pose"
        ui.label(what).classes("quiet")
        form = ui.select(_FORMATS, value="glb", label="Format").classes("w-full").props("dense outlined options-dense")
        name = ui.input("Where", value=str(folder / "pose.glb")).classes("w-full").props("dense outlined")
        rate = ui.number("Frames a second", value=30, min=1, max=240).classes("w-full").props("dense outlined")

        def renamed() -> None:
            place = Path(name.value)
            name.value = str(
                place.with_suffix(f".{form.value}") if form.value in ("glb", "csv") else place.with_suffix("")
            )

        form.on_value_change(renamed)

        async def write() -> None:
            request = PoseExportRequest(
                Path(name.value).expanduser(),
                form.value,
                float(rate.value or 0),
                character=hub.body.character.twin(),  # the page goes on meanwhile
                kind=kind,
            )
            go.disable()
            try:
                result = await run.io_bound(export_pose, hub.session, request)
                assert result is not None
            except FacewrightError as error:
                ui.notify(str(error), type="negative", position="bottom", timeout=8000)
                go.enable()
                return
            ui.notify(f"Written: {result.path} ({result.n_frames} frames).", type="positive", position="bottom")
            dialog.close()

        with ui.row().classes("w-full justify-end"):
            ui.button("Cancel", on_click=dialog.close, color=None).props("flat no-caps")
            go = ui.button("Write", on_click=write).props("unelevated no-caps text-color=grey-10")
    dialog.on("hide", dialog.delete)
