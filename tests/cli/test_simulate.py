import json

import pytest

from facewright.capture.captures import list_captures


def test_writes_captures_and_says_what(invoke, refused, tmp_path):
    words = ("simulate", "captures", tmp_path / "a", "--subjects", 1, "--frames", 2, "--expressions", "neutral, smile")
    result = invoke(*words, "--json")
    assert result.exit_code == 0, result.output
    said = json.loads(result.stdout)
    assert said["recordings"] == 2 and said["frames"] == 4 and said["subjects"] == ["person-000"]
    (subject,) = list_captures(tmp_path / "a")
    assert list(subject.recordings) == ["neutral", "smile"]
    assert "not overwritten" in refused(*words)
    spoken = invoke(*words[:2], tmp_path / "c", *words[3:-1], "neutral")
    assert "Wrote 1 person, 1 recording, 2 frames (" in spoken.stdout


def test_mistakes_end_in_one_sentence(refused, tmp_path):
    assert "grimace" in refused("simulate", "captures", tmp_path / "b", "--expressions", "neutral,grimace")
    assert "refined" in refused("simulate", "captures", tmp_path / "b", "--landmarks", "perfect")
    assert "--subjects must be" in refused("simulate", "captures", tmp_path / "b", "--subjects", 0)
    assert not (tmp_path / "b").exists()


def test_people_go_straight_into_a_database(invoke, refused, tmp_path):
    pytest.importorskip("zarr", reason="needs the warehouse extra")
    words = ("simulate", "people", tmp_path / "faces.zarr", "--people", 2, "--json")
    names = ["simulated-0000", "simulated-0001"]
    said = [json.loads(invoke(*words).stdout) for _ in range(2)]
    assert (said[0]["added"], said[0]["present"]) == (names, [])
    assert (said[1]["added"], said[1]["present"]) == ([], names)
    assert "--people must be" in refused("simulate", "people", tmp_path / "faces.zarr", "--people", 0)


def test_a_motion_capture_session_is_written(invoke, refused, tmp_path):
    words = ("simulate", "performance", tmp_path / "s", "--performers", "F2", "--clips", "neutral", "--format", "csv")
    said = json.loads(invoke(*words, "--json").stdout)
    assert said["clips"] == 1 and list(said["performers"]) == ["F2"] and said["frames"] == 60
    assert (tmp_path / "s" / "F2" / "neutral.csv").is_file()
    assert "not overwritten" in refused(*words)
    spoken = invoke(*words[:2], tmp_path / "t", *words[3:])
    assert "Wrote 1 clip of 1 performer, 60 frames (" in spoken.stdout and "facewright mocap import" in spoken.stdout
    assert "M9" in refused("simulate", "performance", tmp_path / "u", "--performers", "M9")
    assert "xml" in refused("simulate", "performance", tmp_path / "u", "--format", "xml")
