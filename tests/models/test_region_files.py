import json

import numpy as np
import pytest

from facewright.errors import FileFormatError
from facewright.models.region_files import read_regions, write_regions
from facewright.models.regions import Regions


def regions() -> Regions:
    return Regions(5, (np.array([0, 1, 2], np.int32), np.array([2, 3, 4], np.int32)), ("brow", "mouth"))


def test_round_trip_and_edit_by_hand(tmp_path):
    path = tmp_path / "regions.json"
    write_regions(regions(), path)
    content = json.loads(path.read_text())
    content["regions"][0]["vertices"] += [3, 3]  # order and repeats do not matter
    content["regions"][1]["name"] = "jaw"
    path.write_text(json.dumps(content))
    read = read_regions(path)
    assert read.names == ("brow", "jaw")
    assert [ids.tolist() for ids in read.members] == [[0, 1, 2, 3], [2, 3, 4]]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda c: c.update(format="other"), "format"),
        (lambda c: c.update(version=2), "version"),
        (lambda c: c.update(n_vertices="many"), "n_vertices"),
        (lambda c: c.update(regions=[]), "regions"),
        (lambda c: c["regions"][0].update(vertices=[0.5]), "region 1"),
        (lambda c: c["regions"][1].update(name=7), "region 2"),
        (lambda c: c["regions"][1].update(vertices=[4, 5]), "mouth"),
        (lambda c: c["regions"][1].update(vertices=[2, 3]), "every vertex must lie in a region"),
        (lambda c: c["regions"][1].update(vertices=[3, 4]), "share"),
        (lambda c: c["regions"][1].update(vertices=[10**20]), "mouth"),
        (lambda c: c["regions"][1].update(name="brow"), "name"),
    ],
)
def test_refusals(tmp_path, change, words):
    path = tmp_path / "regions.json"
    write_regions(regions(), path)
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))
    with pytest.raises(FileFormatError, match=words):
        read_regions(path)


def test_no_file_and_no_json(tmp_path):
    with pytest.raises(FileFormatError, match="cannot be read"):
        read_regions(tmp_path / "none.json")
    (tmp_path / "text.json").write_text("brow: 1")
    with pytest.raises(FileFormatError, match="not JSON"):
        read_regions(tmp_path / "text.json")
