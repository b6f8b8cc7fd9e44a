import base64
from html.parser import HTMLParser

import pytest

from facewright.apps.demo_page import Figure, Picture, Section, write_demo_page
from facewright.errors import StoreError


class Links(HTMLParser):
    def __init__(self):
        super().__init__()
        self.targets, self.text = [], []

    def handle_starttag(self, tag, attrs):
        self.targets += [value for key, value in attrs if key in ("href", "src")]

    def handle_data(self, data):
        self.text.append(data)


def test_page_refers_only_to_files_in_its_folder(tmp_path):
    glb = tmp_path / "person.glb"
    glb.write_bytes(b"glTF\x02\x00\x00\x00")
    (tmp_path / "a.png").write_bytes(b"")
    sections = [
        Section("The head", "Turn it.", viewer=True),
        Section("Pictures", "Some <b>text</b>.", [[Picture("a.png", 'the "first"')]]),
    ]
    page = write_demo_page(
        tmp_path, "T", "Intro", sections, [Figure("error", "1.2 mm", "less is better")], [("person.glb", "rig")], glb
    )
    links = Links()
    links.feed(page.read_text())
    assert {"a.png", "person.glb", "viewer.js", "person.glb.js"} <= set(links.targets)
    assert all((tmp_path / name).is_file() for name in links.targets)
    assert "Some <b>text</b>." in "".join(links.text)
    encoded = (tmp_path / "person.glb.js").read_text().split('"')[3]
    assert base64.b64decode(encoded) == glb.read_bytes()


def test_missing_folder_is_refused(tmp_path):
    with pytest.raises(StoreError):
        write_demo_page(tmp_path / "none", "T", "I", [], [], [])


def test_films_play_and_pictures_stay_pictures(tmp_path):
    section = Section("Films", "One.", [[Picture("a.mp4", "a film"), Picture("b.png", "a picture")]])
    text = write_demo_page(tmp_path, "T", "I", [section], [], []).read_text()
    assert '<video src="a.mp4"' in text
    assert '<img src="b.png"' in text
