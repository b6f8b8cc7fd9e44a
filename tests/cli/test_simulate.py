import json

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


def test_mistakes_end_in_one_sentence(refused, tmp_path):
    assert "grimace" in refused("simulate", "captures", tmp_path / "b", "--expressions", "neutral,grimace")
    assert "refined" in refused("simulate", "captures", tmp_path / "b", "--landmarks", "perfect")
    assert "--subjects must be" in refused("simulate", "captures", tmp_path / "b", "--subjects", 0)
    assert not (tmp_path / "b").exists()
