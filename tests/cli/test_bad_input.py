"""Bad input through real commands: one sentence, exit code 2, nothing half-written, nothing overwritten."""

import json
import os
import shutil
import signal
import struct
import subprocess
import time

import numpy as np
import pytest

# ---- model files ----


def _damaged(good: bytes, kind: str) -> bytes:
    if kind == "empty":
        return b""
    if kind == "truncated":
        return good[: len(good) // 2]
    if kind == "truncated header":
        return good[:20]
    if kind == "one bit":
        middle = len(good) * 2 // 3
        return good[:middle] + bytes([good[middle] ^ 16]) + good[middle + 1 :]
    if kind == "longer":
        return good + b"more"
    if kind == "sent as text":
        return good.replace(b"\r\n", b"\n", 1)
    if kind == "newer":
        return good[:8] + struct.pack("<I", 99) + good[12:]
    return {"picture": b"\x89PNG\r\n\x1a\n" + bytes(64), "pickle": b"\x80\x04\x95.", "text": b"hello, face\n" * 20}[
        kind
    ]


KINDS = [
    "empty", "truncated", "truncated header", "one bit", "longer",
    "sent as text", "newer", "picture", "pickle", "text",
]  # fmt: skip


@pytest.mark.parametrize("kind", KINDS)
def test_damaged_and_foreign_model_files(kind, small_model, tmp_path, refused):
    bad = tmp_path / "bad.fwbm"
    bad.write_bytes(_damaged(small_model.read_bytes(), kind))
    for args in (
        ["model", "info", bad],
        ["model", "explore", bad, "--out", tmp_path / "m.png"],
        ["export", tmp_path / "a.glb", "--model", bad],
    ):
        sentence = refused(*args)
        assert "bad.fwbm" in sentence
        if kind == "newer":
            assert "99" in sentence
    assert sorted(p.name for p in tmp_path.iterdir()) == ["bad.fwbm"]


def test_folders_and_missing_files_for_models(tmp_path, refused):
    for path in (tmp_path, tmp_path / "none.fwbm", tmp_path / "none" / "x.fwbm"):
        assert str(path) in refused("model", "info", path)


def test_a_face_file_that_is_none(small_model, tmp_path, refused):
    for name, data in (("a.npz", b""), ("b.npz", b"PK\x03\x04" + bytes(50)), ("c.npz", small_model.read_bytes())):
        (tmp_path / name).write_bytes(data)
        assert name in refused("faces", "show", tmp_path / name)
    np.savez(tmp_path / "d.npz", other=np.zeros(3))
    assert "d.npz" in refused("model", "build", "-o", tmp_path / "m.fwbm", "--faces", tmp_path / "d.npz")
    assert not (tmp_path / "m.fwbm").exists()


def test_a_face_file_that_is_a_single_array(tmp_path, refused):
    np.save(tmp_path / "e.npy", np.zeros(3))
    shutil.move(tmp_path / "e.npy", tmp_path / "e.npz")
    assert "e.npz" in refused("faces", "show", tmp_path / "e.npz")


# ---- pictures ----


def _pictures(folder, side=40):
    """Write pictures of every unusual kind and pictures that are none; returns the good and the bad ones."""
    from PIL import Image

    rng = np.random.default_rng(0)
    rgb = Image.fromarray(rng.integers(0, 256, (side, side + 8, 3), dtype=np.uint8))
    good = {
        "grey.png": rgb.convert("L"),
        "alpha.png": rgb.convert("RGBA"),
        "palette.png": rgb.convert("P"),
        "cmyk.jpg": rgb.convert("CMYK"),
        "deep.png": Image.fromarray(rng.integers(0, 65536, (side, side + 8), dtype=np.uint16)),
        "plain.jpg": rgb,
    }
    for name, picture in good.items():
        picture.save(folder / name)
    whole = (folder / "plain.jpg").read_bytes()
    bad = {
        "empty.jpg": b"",
        "truncated.jpg": whole[: len(whole) // 2],
        "text.png": b"no picture",
        "header.png": (folder / "grey.png").read_bytes()[:30],
        "huge.png": _png_header(200_000, 200_000),
    }
    for name, data in bad.items():
        (folder / name).write_bytes(data)
    return sorted(good), sorted(bad)


def _png_header(width, height):
    import zlib

    body = b"IHDR" + struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + struct.pack(">I", 13) + body + struct.pack(">I", zlib.crc32(body))


def test_pictures_of_every_kind(tmp_path, invoke, refused):
    good, bad = _pictures(tmp_path)
    before = set(tmp_path.iterdir())
    for name in bad:
        assert name in refused("export", tmp_path / "a.glb", "--texture", tmp_path / name)
    assert set(tmp_path.iterdir()) == before
    for name in good:
        result = invoke("export", tmp_path / "a.glb", "--texture", tmp_path / name, "--json")
        assert result.exit_code == 0, f"{name}: {result.stderr}"


# ---- photos and landmarks ----


@pytest.fixture
def points(tmp_path, small_model):
    """A points file of a face seen from the front: the model's own points, projected."""
    from facewright.landmarks.files import write_landmarks
    from facewright.landmarks.points import Landmarks
    from facewright.models.bilinear_store import load_bilinear

    model = load_bilinear(small_model)
    ids = model.topology.landmarks["fw74"]
    found = model.mean_face[ids, :2] * [2.0, -2.0] + 240.0
    found[ids < 0] = np.nan
    write_landmarks(tmp_path / "points.json", Landmarks("fw74", found, (ids >= 0).astype(float)))
    return tmp_path / "points.json"


@pytest.fixture
def photo(tmp_path):
    from PIL import Image

    Image.new("RGB", (480, 480), (90, 120, 90)).save(tmp_path / "photo.png")
    return tmp_path / "photo.png"


def _without_detector(photo, small_model, points, out):
    return ["fit", photo, "--model", small_model, "--landmarks", points, "--no-detect", "--texture", 64, "--out", out]


def test_a_fit_without_the_detector(photo, small_model, points, tmp_path, invoke):
    result = invoke(*_without_detector(photo, small_model, points, tmp_path / "out"), "--json")
    assert result.exit_code == 0, result.stderr
    payload = json.loads(result.stdout)
    assert payload["faces_found"] == 0 and payload["reprojection_iod"] < 0.02
    files = {p.name for p in (tmp_path / "out").iterdir()}
    assert {"fit.json", "face.obj", "face.glb", "texture.png", "overlay.png"} <= files
    again = invoke("export", tmp_path / "a.glb", "--model", small_model, "--fit", tmp_path / "out" / "fit.json")
    assert again.exit_code == 0, again.stderr


def _spoilt(points, kind):
    content = json.loads(points.read_text())
    if kind == "nan":
        content["points"][20] = [float("nan"), 3.0]
    elif kind == "infinite":
        content["points"][20] = [1e400, 3.0]
    elif kind == "count":
        content["points"] = content["points"][:-1]
    elif kind == "scheme":
        content["scheme"] = "nose5"
    elif kind == "text":
        content["points"][3] = ["a", "b"]
    elif kind == "3d":
        content["points"] = [None if p is None else [*p, 0.0] for p in content["points"]]
    elif kind == "few":
        content["points"] = [p if i in (27, 31, 35) else None for i, p in enumerate(content["points"])]
    elif kind == "one place":
        content["points"] = [None if p is None else [5.0, 5.0] for p in content["points"]]
    return "{" if kind == "json" else "" if kind == "empty" else json.dumps(content)


SPOILT = ["nan", "infinite", "count", "scheme", "text", "3d", "few", "one place", "json", "empty"]


@pytest.mark.parametrize("kind", SPOILT)
def test_landmark_files_that_cannot_be(kind, photo, small_model, points, tmp_path, refused):
    points.write_text(_spoilt(points, kind))
    before = set(tmp_path.iterdir())
    sentence = refused(*_without_detector(photo, small_model, points, tmp_path / "out"))
    assert kind in ("few", "one place") or "points.json" in sentence
    assert set(tmp_path.rglob("*")) == before


def test_landmarks_of_another_picture(small_model, points, tmp_path, refused):
    """Points far outside the photo, as when the wrong file is given."""
    from PIL import Image

    Image.new("RGB", (48, 40)).save(tmp_path / "small.png")
    assert "48" in refused(*_without_detector(tmp_path / "small.png", small_model, points, tmp_path / "out"))


def test_landmark_files_of_other_kinds(photo, small_model, tmp_path, refused):
    for name, content in (
        ("a.pts", "version: 1\nn_points: 3\n{\n1 2\n3 4\n}\n"),
        ("b.pts", "version: 1\nn_points: 68\n{\n" + "1 nan\n" * 68 + "}\n"),
        ("c.txt", "1 2 3"),
        ("d.pts", "\0\1\2"),
    ):
        (tmp_path / name).write_text(content)
        assert name in refused(*_without_detector(photo, small_model, tmp_path / name, tmp_path / "out"))
    assert "none.pts" in refused(*_without_detector(photo, small_model, tmp_path / "none.pts", tmp_path / "out"))
    assert "landmarks must be given" in refused("fit", photo, "--model", small_model, "--no-detect")


def test_photos_that_are_none(small_model, points, tmp_path, refused):
    _, bad = _pictures(tmp_path)
    for name in [*bad, "none.jpg"]:
        assert name in refused(*_without_detector(tmp_path / name, small_model, points, tmp_path / "out"))
    assert not (tmp_path / "out").exists()


def test_photos_of_every_kind(small_model, points, tmp_path, invoke):
    _pictures(tmp_path, side=480)
    for name in ("deep.png", "cmyk.jpg"):  # the others: test_pictures_of_every_kind
        result = invoke(*_without_detector(tmp_path / name, small_model, points, tmp_path / "out"))
        assert result.exit_code == 0, f"{name}: {result.stderr}"


@pytest.mark.landmarks
def test_no_face_and_too_few_faces(photo, small_model, tmp_path, refused):
    pytest.importorskip("mediapipe", reason="needs the landmarks extra")
    from skimage import data

    from facewright.io.image import write_image

    out = tmp_path / "out"
    assert "must show a face" in refused("fit", photo, "--model", small_model, "--out", out)
    write_image(tmp_path / "astronaut.png", data.astronaut())
    sentence = refused("fit", tmp_path / "astronaut.png", "--model", small_model, "--out", out, "--face", 1)
    assert "found 1" in sentence
    assert not out.exists()


def test_a_full_disk_while_fitting(photo, small_model, points, small_disk, refused):
    (small_disk / "old").mkdir()
    (small_disk / "old" / "fit.json").write_text("precious")
    for out in (small_disk / "deep" / "out", small_disk / "old"):
        sentence = refused(*_without_detector(photo, small_model, points, out))
        assert "no space left" in sentence and str(out) in sentence and ".part" not in sentence
    assert sorted(small_disk.rglob("*")) == [small_disk / "old", small_disk / "old" / "fit.json"]
    assert (small_disk / "old" / "fit.json").read_text() == "precious"


def test_a_full_disk_while_exporting_a_folder(small_disk, refused):
    sentence = refused("export", small_disk / "deep" / "shapes")
    assert "no space left" in sentence and str(small_disk / "deep" / "shapes") in sentence
    assert not list(small_disk.iterdir())


# ---- maps, fits ----


@pytest.mark.parametrize(
    "content", ["", "{", "[]", "{}", '{"names": ["a"], "to_ours": {"a": {"nose": 1}}, "from_ours": {}}', "\0\1"]
)
def test_name_maps_that_are_none(content, tmp_path, refused):
    (tmp_path / "map.json").write_text(content)
    assert "map.json" in refused("export", tmp_path / "a.glb", "--names", tmp_path / "map.json")
    assert not (tmp_path / "a.glb").exists()


@pytest.mark.parametrize("weights", [None, [], [1.0], [1.0, float("nan"), 0.0], "abc", [[1, 2, 3]], {"a": 1}])
def test_fits_of_another_model(weights, small_model, tmp_path, refused):
    (tmp_path / "fit.json").write_text(json.dumps({"identity_weights": weights}))
    assert "fit.json" in refused("export", tmp_path / "a.glb", "--model", small_model, "--fit", tmp_path / "fit.json")


@pytest.mark.parametrize(
    "change", [{"model": {"topology": "0123456789abcdef"}}, {"version": 2}, {"version": "x"}, {"format": "poem"}]
)
def test_fits_of_another_topology_version_or_kind(change, small_model, tmp_path, refused):
    good = {"format": "facewright photo fit", "version": 1, "identity_weights": [1.0, 0.0, 0.0]}
    (tmp_path / "fit.json").write_text(json.dumps(good | change))
    sentence = refused("export", tmp_path / "a.glb", "--model", small_model, "--fit", tmp_path / "fit.json")
    assert "fit.json" in sentence and "model_id" not in sentence and not (tmp_path / "a.glb").exists()


# ---- disks and interruption ----


def test_a_full_disk_leaves_nothing_and_keeps_the_old_file(small_disk, small_model, refused):
    (small_disk / "old.glb").write_text("precious")
    for args in (["export", small_disk / "old.glb"], ["export", small_disk / "new.glb"]):
        assert "no space left" in refused(*args)
    sentence = refused(
        "model", "build", "-o", small_disk / "m.fwbm", "--people", 2, "--identities", 2, "--expressions", 4
    )
    assert "no space left" in sentence
    assert "no space left" in refused("model", "explore", small_model, "--modes", 3, "--out", small_disk / "m.png")
    assert [p.name for p in small_disk.iterdir()] == ["old.glb"]
    assert (small_disk / "old.glb").read_text() == "precious"


def test_a_limit_on_file_size_is_told_like_a_full_disk(command, tmp_path):
    import resource

    def limit():
        resource.setrlimit(resource.RLIMIT_FSIZE, (50_000, 50_000))

    environment = {**os.environ, "NUMBA_DISABLE_JIT": "0", "NUMBA_CACHE_DIR": ""}
    args = command("export", tmp_path / "a.glb")
    done = subprocess.run(args, capture_output=True, text=True, preexec_fn=limit, timeout=120, env=environment)
    assert done.returncode == 2, done.stderr
    assert len(done.stderr.strip().splitlines()) == 1 and "a.glb" in done.stderr
    assert not list(tmp_path.iterdir())


def test_a_folder_that_must_not_be_written(tmp_path, refused):
    (tmp_path / "file").write_text("x")
    assert "file" in refused("export", tmp_path / "file" / "a.glb")
    assert "file" in refused("model", "build", "-o", tmp_path / "file" / "m.fwbm")
    assert "file" in refused("export", tmp_path / "file")
    (tmp_path / "folder.glb").mkdir()
    assert "folder" in refused("export", tmp_path / "folder.glb")


def test_ctrl_c_while_exporting_a_folder(command, tmp_path):
    out = tmp_path / "deep" / "shapes"
    process = subprocess.Popen(command("export", out), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        deadline = time.monotonic() + 60
        while len(list(tmp_path.rglob("*.obj"))) < 2 and process.poll() is None and time.monotonic() < deadline:
            time.sleep(0.01)  # until two of the 47 files are there
        process.send_signal(signal.SIGINT)
        _, stderr = process.communicate(timeout=60)
    finally:
        process.kill()
    assert process.returncode == 130, stderr
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("kind", [signal.SIGINT, signal.SIGTERM])
def test_ctrl_c_ends_in_one_sentence_with_nothing_left(command, tmp_path, kind):
    args = command("model", "build", "-o", tmp_path / "m.fwbm", "--people", 400)
    process = subprocess.Popen(args, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        deadline = time.monotonic() + 60
        while not list(tmp_path.iterdir()) and process.poll() is None and time.monotonic() < deadline:
            time.sleep(0.1)  # until its temporary folder shows that it is at work
        time.sleep(0.5)
        process.send_signal(kind)
        stdout, stderr = process.communicate(timeout=60)
    finally:
        process.kill()
    assert process.returncode == 130, stderr
    assert stdout == "" and stderr.strip().splitlines() == [
        "facewright: Interrupted; nothing half-written was left behind."
    ]
    assert not list(tmp_path.iterdir())
