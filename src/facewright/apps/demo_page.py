"""The demo's page: pictures, numbers and a turnable head, in a folder that opens without a network."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from importlib import resources
from pathlib import Path

from facewright.io.atomic import write_atomically

_STYLE = """
:root { color-scheme: light; --ink: #24262b; --soft: #666b76; --line: #dfe1e6; --accent: #2f5fd0; }
* { box-sizing: border-box; }
body { margin: 0; font: 16px/1.55 system-ui, sans-serif; color: var(--ink); background: #fff; }
main { max-width: 1080px; margin: 0 auto; padding: 32px 20px 80px; }
h1 { font-size: 2rem; margin: 0 0 .3em; } h2 { font-size: 1.3rem; margin: 2.2em 0 .4em; }
p { max-width: 74ch; } .soft { color: var(--soft); } code { background: #f2f3f5; padding: .1em .35em; border-radius: 4px; }
figure { margin: 1em 0; } figcaption { color: var(--soft); font-size: .92rem; margin-top: .3em; max-width: 90ch; }
img { max-width: 100%; height: auto; border: 1px solid var(--line); border-radius: 6px; display: block; }
.row { display: flex; gap: 16px; flex-wrap: wrap; align-items: flex-start; } .row > * { flex: 1 1 240px; margin: .5em 0; }
table { border-collapse: collapse; margin: 1em 0; } td, th { text-align: left; padding: .35em .9em .35em 0; border-bottom: 1px solid var(--line); vertical-align: top; }
td.number { text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap; font-weight: 600; }
#viewer { display: grid; grid-template-columns: 1fr 300px; gap: 16px; align-items: stretch; }
#viewer canvas { width: 100%; height: 520px; border: 1px solid var(--line); border-radius: 6px; touch-action: none; cursor: grab; }
#sliders { height: 520px; overflow-y: auto; font-size: .86rem; padding-right: 6px; }
#sliders label { display: grid; grid-template-columns: 132px 1fr; align-items: center; gap: 6px; }
#sliders input { width: 100%; accent-color: var(--accent); }
@media (max-width: 760px) { #viewer { grid-template-columns: 1fr; } #sliders { height: 260px; } }
"""

_VIEWER = """
<div id="viewer"><canvas id="view"></canvas><div id="sliders"></div></div>
<p class="soft" id="viewer-note">Drag to turn, wheel to zoom; each slider is one of the rig's blendshapes.</p>
<script src="person.glb.js"></script><script src="viewer.js"></script>
<script>
const bytes = Uint8Array.from(atob(PERSON_GLB), (c) => c.charCodeAt(0));
showGlb(document.getElementById("view"), bytes.buffer, (names, set) => {
  const box = document.getElementById("sliders");
  names.forEach((name, k) => {
    const label = document.createElement("label"), slider = document.createElement("input");
    label.textContent = name;
    Object.assign(slider, { type: "range", min: 0, max: 1, step: 0.01, value: 0 });
    slider.addEventListener("input", () => set(k, Number(slider.value)));
    label.append(slider);
    box.append(label);
  });
}).catch((error) => { document.getElementById("viewer-note").textContent = "The 3D view could not start: " + error.message; });
</script>
"""


@dataclass(frozen=True)
class Picture:
    """One picture of the page: its file in the demo's folder and its caption."""

    file: str
    caption: str


@dataclass(frozen=True)
class Section:
    """One part of the page: heading, a paragraph, rows of pictures side by side."""

    title: str
    text: str
    rows: Sequence[Sequence[Picture]] = ()
    viewer: bool = False


@dataclass(frozen=True)
class Figure:
    """One number of the page: what it is, its value with unit, and how to read it."""

    name: str
    value: str
    meaning: str


def write_demo_page(
    folder: Path,
    title: str,
    introduction: str,
    sections: Sequence[Section],
    figures: Sequence[Figure],
    files: Sequence[tuple[str, str]],
    glb: Path | None = None,
) -> Path:
    """Write ``index.html`` (and the viewer's scripts) into `folder`.

    Parameters
    ----------
    folder : Path
        The demo's folder; the pictures are there already.
    title, introduction : str
        Heading and first paragraph (plain text).
    sections : sequence of Section
        In reading order; the one with ``viewer=True`` shows `glb`.
    figures : sequence of Figure
        The table of numbers.
    files : sequence of (file, description)
        What the folder holds for the user to take along.
    glb : Path, optional
        Rigged head for the turnable view.

    Returns
    -------
    Path
        The page.

    Raises
    ------
    StoreError
        If the folder cannot be written.
    """
    if glb is not None:
        with write_atomically(folder / "person.glb.js") as path:
            encoded = base64.b64encode(glb.read_bytes()).decode("ascii")
            path.write_text(f'"use strict";\nconst PERSON_GLB = "{encoded}";\n', encoding="ascii")
        with write_atomically(folder / "viewer.js") as path:
            viewer = resources.files("facewright.apps") / "data" / "viewer.js"
            path.write_text(viewer.read_text(encoding="utf-8"), encoding="utf-8")
    body = [f"<h1>{escape(title)}</h1>", f"<p>{escape(introduction)}</p>"]
    for section in sections:
        body.append(f"<h2>{escape(section.title)}</h2><p>{escape(section.text)}</p>")
        if section.viewer and glb is not None:
            body.append(_VIEWER)
        for row in section.rows:
            cells = "".join(
                f'<figure><a href="{escape(p.file)}"><img src="{escape(p.file)}" alt="{escape(p.caption)}"></a>'
                f"<figcaption>{escape(p.caption)}</figcaption></figure>"
                for p in row
            )
            body.append(f'<div class="row">{cells}</div>')
    rows = "".join(
        f'<tr><td>{escape(f.name)}</td><td class="number">{escape(f.value)}</td><td>{escape(f.meaning)}</td></tr>'
        for f in figures
    )
    body.append(f"<h2>Numbers</h2><table><tr><th>what</th><th></th><th>how to read it</th></tr>{rows}</table>")
    rows = "".join(
        f'<tr><td><a href="{escape(name)}">{escape(name)}</a></td><td>{escape(text)}</td></tr>' for name, text in files
    )
    body.append(f"<h2>Files</h2><table>{rows}</table>")
    page = (
        f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>{escape(title)}</title>'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<style>{_STYLE}</style></head><body><main>{''.join(body)}</main></body></html>\n"
    )
    with write_atomically(folder / "index.html") as path:
        path.write_text(page, encoding="utf-8")
    return folder / "index.html"
