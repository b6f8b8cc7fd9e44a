"""The demo's page: pictures, numbers and a turnable head, in a folder that opens without a network."""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from importlib import resources
from pathlib import Path

from facewright.io.atomic import write_atomically


def _data(name: str) -> str:
    return (resources.files("facewright.apps") / "data" / name).read_text(encoding="utf-8")


@dataclass(frozen=True)
class Picture:
    """One picture or film (``.mp4``) of the page: its file in the demo's folder and its caption."""

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
    presets: Mapping[str, Mapping[str, float]] | None = None,
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
    presets : mapping of str to (mapping of str to float), optional
        Buttons of that view: a name and the blendshape weights it sets; the others become 0.

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
            buttons = json.dumps({name: dict(weights) for name, weights in (presets or {}).items()})
            path.write_text(f'"use strict";\nconst PERSON_GLB = "{encoded}";\nconst PRESETS = {buttons};\n', "ascii")
        with write_atomically(folder / "viewer.js") as path:
            path.write_text(_data("viewer.js"), encoding="utf-8")
    body = [f"<h1>{escape(title)}</h1>", f"<p>{escape(introduction)}</p>"]
    for section in sections:
        body.append(f"<h2>{escape(section.title)}</h2><p>{escape(section.text)}</p>")
        if section.viewer and glb is not None:
            body.append(_data("demo_viewer.html"))
        for row in section.rows:
            cells = "".join(f"<figure>{_shown(p)}<figcaption>{escape(p.caption)}</figcaption></figure>" for p in row)
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
        f"<style>{_data('demo.css')}</style></head><body><main>{''.join(body)}</main></body></html>\n"
    )
    with write_atomically(folder / "index.html") as path:
        path.write_text(page, encoding="utf-8")
    return folder / "index.html"


def _shown(picture: Picture) -> str:
    file, caption = escape(picture.file), escape(picture.caption)
    if picture.file.endswith(".mp4"):
        return f'<video src="{file}" controls loop muted autoplay playsinline aria-label="{caption}"></video>'
    return f'<a href="{file}"><img src="{file}" alt="{caption}"></a>'
