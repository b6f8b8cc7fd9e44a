import zipfile

import numpy as np
import pytest

from facewright.errors import FileFormatError, StoreError
from facewright.faces import ict_archive, install
from facewright.faces.ict import read_compact_arrays
from facewright.faces.ict_archive import EXPRESSIONS, FolderMembers, ZipMembers, canonical_sha256, signed_sums
from facewright.faces.install import install_ict

FEW = ("jawOpen", "eyeBlink_L")


@pytest.fixture(scope="module")
def compact(test_data_path):
    return read_compact_arrays(test_data_path / "ict_facekit.npz")


@pytest.fixture(scope="module")
def test_data_path(request):
    return request.getfixturevalue("test_data")


def vertex_lines(vertices_mm):
    """Lines as upstream writes them: centimetres with six significant digits."""
    return "\n".join("v " + " ".join(f"{c:.6g}" for c in row) for row in vertices_mm.astype(float) / 10)


def neutral_obj(arrays):
    corners = [
        "f " + " ".join(f"{v + 1}/{t + 1}" for v, t in zip(face, uv) if v >= 0)
        for face, uv in zip(arrays["faces"].tolist(), arrays["uv_faces"].tolist())
    ]
    uv = [f"vt {u:.6f} {v:.6f}" for u, v in arrays["uv"]]
    return "\n".join(["# MIT", "mtllib x.mtl", vertex_lines(arrays["vertices"]), *uv, *corners, ""])


def upstream_files(arrays, n_identities, expressions):
    names = arrays["expression_names"].tolist()
    files = {"generic_neutral_mesh": neutral_obj(arrays)}
    for i in range(n_identities):
        files[f"identity{i:03d}"] = vertex_lines(arrays["vertices"] + arrays["identity_modes"][i])
    for name in expressions:
        files[name] = vertex_lines(arrays["vertices"] + arrays["expression_deltas"][names.index(name)])
    return files


def write_zip(path, files, compression=zipfile.ZIP_DEFLATED):
    with zipfile.ZipFile(path, "w", compression, compresslevel=1) as archive:
        for name, text in files.items():
            archive.writestr(f"ICT-FaceKit-abc/FaceXModel/{name}.obj", text)
        archive.writestr("ICT-FaceKit-abc/README.md", "hello")


@pytest.fixture(scope="module")
def few_files(compact):
    return upstream_files(compact, 2, FEW)


@pytest.fixture
def few(monkeypatch):
    """Make the converter expect two identities and two expressions only."""
    monkeypatch.setattr(ict_archive, "N_IDENTITIES", 2)
    monkeypatch.setattr(ict_archive, "EXPRESSIONS", FEW)
    monkeypatch.setattr(ict_archive, "read_package_json", lambda _: few_expected())


def few_expected():
    from facewright.faces.blendshape_names import read_package_json

    content = read_package_json("ict_contents.json")
    keep = ("identity000", "identity001", *FEW)
    return content | {"signed_sums": {name: content["signed_sums"][name] for name in keep}}


@pytest.fixture
def store(tmp_path, monkeypatch):
    monkeypatch.setenv("FACEWRIGHT_HOME", str(tmp_path / "home"))
    return tmp_path / "home"


def nothing_installed(store):
    return not store.exists() or not [path for path in store.rglob("*") if path.is_file()]


def test_the_compact_file_is_installed_and_loads(test_data, store):
    from facewright.faces import list_faces, load_face

    path = install_ict(test_data / "ict_facekit.npz")
    assert path == store / "faces" / "ict.npz"
    assert [face.installed for face in list_faces()] == [True, True]
    assert load_face("ict").n_skin == 11248


@pytest.mark.parametrize("kind", ["zip", "folder"])
def test_upstream_files_convert_to_the_compact_arrays(tmp_path, store, few, few_files, compact, kind):
    source = tmp_path / "upstream.zip"
    write_zip(source, few_files)
    if kind == "folder":
        with zipfile.ZipFile(source) as archive:
            archive.extractall(tmp_path / "unpacked")
        source = tmp_path / "unpacked"
    seen = []
    path = install_ict(source, progress=lambda *step: seen.append(step))
    assert seen[-1][1:] == (4, 4)
    with np.load(path) as arrays:
        for name in ("faces", "uv_faces"):
            assert np.array_equal(arrays[name], compact[name])
        assert np.abs(arrays["vertices"] - compact["vertices"]).max() < 1e-4
        assert np.abs(arrays["uv"] - compact["uv"]).max() < 1e-6
        assert np.abs(arrays["identity_modes"] - compact["identity_modes"][:2]).max() < 2e-3
    assert [p.name for p in store.rglob("*") if p.is_file()] == ["ict.npz"]


def test_a_changed_shape_is_refused_and_nothing_is_installed(tmp_path, store, few, few_files):
    lines = few_files["jawOpen"].split("\n")
    x, y, z = (float(c) for c in lines[5000].split()[1:])
    lines[5000] = f"v {x + 0.01:.6g} {y:.6g} {z:.6g}"  # a tenth of a millimetre
    write_zip(tmp_path / "upstream.zip", few_files | {"jawOpen": "\n".join(lines)})
    with pytest.raises(FileFormatError, match="jawOpen"):
        install_ict(tmp_path / "upstream.zip")
    assert nothing_installed(store)


@pytest.mark.parametrize(
    ("damage", "match"),
    [
        (lambda files: {k: v for k, v in files.items() if k != "identity001"}, "identity001.obj is missing"),
        (lambda files: files | {"identity001": files["identity001"][:9000]}, "26719"),
        (lambda files: files | {"identity001": files["identity001"].replace("v ", "v x", 1)}, "v x y z"),
        (lambda files: files | {"jawOpen": files["jawOpen"].replace("v 0 ", "v nan ", 1)}, "finite"),
        (lambda files: files | {"generic_neutral_mesh": "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"}, "26719"),
        (lambda files: {"other": "v 0 0 0"}, "without FaceXModel"),
    ],
)
def test_an_incomplete_or_foreign_archive_is_refused(tmp_path, store, few, few_files, damage, match):
    write_zip(tmp_path / "upstream.zip", damage(few_files))
    with pytest.raises(FileFormatError, match=match):
        install_ict(tmp_path / "upstream.zip")
    assert nothing_installed(store)


def test_a_corrupt_archive_is_refused(tmp_path, store, few, few_files):
    path = tmp_path / "upstream.zip"
    write_zip(path, few_files, zipfile.ZIP_STORED)
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])  # truncated: no directory of contents
    with pytest.raises(FileFormatError, match="zip archive"):
        install_ict(path)
    at = content.rindex(b"\nv ", 0, len(content) - 5000)
    path.write_bytes(content[:at] + b"\nw " + content[at + 3 :])  # a flipped byte: wrong checksum
    with pytest.raises(FileFormatError, match="must be readable"):
        install_ict(path)
    path.write_bytes(b"\x89PNG whatever")
    with pytest.raises(FileFormatError, match="zip archive"):
        install_ict(path)
    assert nothing_installed(store)


def test_a_foreign_folder_or_absent_source_is_refused(tmp_path, store):
    with pytest.raises(FileFormatError, match="FaceXModel"):
        install_ict(tmp_path)
    with pytest.raises(StoreError, match="existing"):
        install_ict(tmp_path / "absent.zip")
    assert nothing_installed(store)


def test_a_foreign_compact_file_is_refused(tmp_path, store, compact):
    wrong = dict(compact)
    wrong["vertices"] = compact["vertices"] + np.float32(0.01)
    np.savez(tmp_path / "wrong.npz", **wrong)
    with pytest.raises(FileFormatError, match="vertices"):
        install_ict(tmp_path / "wrong.npz")
    assert nothing_installed(store)


def test_a_failed_or_interrupted_download_leaves_nothing(store, monkeypatch):
    monkeypatch.setattr(install, "ICT_URL", "http://127.0.0.1:9/ict.zip")
    with pytest.raises(StoreError, match="--from"):
        install_ict()
    assert nothing_installed(store)

    def interrupted(url, folder, progress):
        (folder / "half.zip").write_bytes(b"half")
        raise KeyboardInterrupt

    monkeypatch.setattr(install, "_download", interrupted)
    with pytest.raises(KeyboardInterrupt):
        install_ict()
    assert nothing_installed(store)


def test_the_archive_is_downloaded_with_progress(tmp_path, store, few, few_files, monkeypatch):
    import functools
    import http.server
    import threading

    class Quiet(http.server.SimpleHTTPRequestHandler):
        def log_message(self, *args):
            pass

    write_zip(tmp_path / "upstream.zip", few_files)
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(Quiet, directory=str(tmp_path)))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    monkeypatch.setattr(install, "ICT_URL", f"http://127.0.0.1:{server.server_port}/upstream.zip")
    seen = []
    try:
        path = install_ict(progress=lambda *step: seen.append(step))
    finally:
        server.shutdown()
        server.server_close()
    size = (tmp_path / "upstream.zip").stat().st_size
    downloads = [step for step in seen if step[0].startswith("downloading")]
    assert downloads[-1][1:] == (size, size)
    assert [p for p in store.rglob("*") if p.is_file()] == [path]


def test_fingerprints_ignore_rounding_and_see_changes(rng):
    numbers = rng.normal(size=(100, 3)) * 50
    text = np.array([[float(f"{c:.6g}") for c in row] for row in numbers])
    assert canonical_sha256(text.astype(np.float32)) == canonical_sha256(text)
    changed = text.copy()
    changed[50, 1] += 0.01
    assert canonical_sha256(changed) != canonical_sha256(text)
    assert np.allclose(np.abs(signed_sums(changed) - signed_sums(text)), 0.01)


def test_archive_readers_name_what_is_missing(tmp_path, few_files):
    write_zip(tmp_path / "a.zip", few_files)
    with pytest.raises(FileFormatError, match="identity050"):
        ZipMembers(tmp_path / "a.zip").read("identity050")
    (tmp_path / "FaceXModel").mkdir()
    (tmp_path / "FaceXModel" / "generic_neutral_mesh.obj").write_text("v 0 0 0")
    with pytest.raises(FileFormatError, match="identity050"):
        FolderMembers(tmp_path).read("identity050")


@pytest.mark.slow
def test_the_whole_archive_installs(tmp_path, store, compact):
    write_zip(tmp_path / "upstream.zip", upstream_files(compact, 100, EXPRESSIONS))
    path = install_ict(tmp_path / "upstream.zip")
    with np.load(path) as arrays:
        names = compact["expression_names"].tolist()
        rows = [names.index(name) for name in arrays["expression_names"].tolist()]
        assert np.abs(arrays["expression_deltas"] - compact["expression_deltas"][rows]).max() < 2e-3
