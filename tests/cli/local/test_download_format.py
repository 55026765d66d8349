"""`capture2vr download` and `convert`: files for other programs, and one sentence for what cannot be."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest
import trimesh

from capture2vr.cli.errors import BadInput
from capture2vr.cli.local.convert import convert_folder
from capture2vr.cli.remote.download_format import download_format
from capture2vr.cli.up import run_stack
from capture2vr.storage.catalogue.publish import publish
from capture2vr.storage.local import LocalStore
from tests.support.downloadable import SHEET, SLATE, downloadable, written


@pytest.mark.slow
def test_a_file_is_downloaded_whole_or_not_at_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("EDGE_DEVICE", "cpu")
    with run_stack("127.0.0.1", 0, tmp_path / "data") as stack:
        publish(downloadable(), LocalStore(stack.store_root), key="sheet")
        path = download_format("sheet", "stl", tmp_path, stack.url)
        assert path == tmp_path / "sheet.stl"
        assert len(trimesh.load(path).faces) == len(SHEET.faces)
        publish(downloadable(SLATE), LocalStore(stack.store_root), key="sheet")
        assert download_format("sheet", "glb", tmp_path, stack.url, version=1) == tmp_path / "sheet-v1.glb"
        assert trimesh.load(tmp_path / "sheet-v1.glb").to_mesh().faces.shape == SHEET.faces.shape
        with pytest.raises(BadInput, match="no version 3; it has 1, 2"):
            download_format("sheet", "glb", tmp_path, stack.url, version=3)
        for key, wanted, reason in (("sheet", "exe", "glb, glb-meshopt, obj"), ("nobody", "glb", "no asset nobody")):
            with pytest.raises(BadInput, match=reason):
                download_format(key, wanted, tmp_path / "out", stack.url)
        with pytest.raises(BadInput, match="create it"):
            download_format("sheet", "stl", tmp_path / "none" / "a.stl", stack.url)
        assert sorted(each.name for each in tmp_path.iterdir()) == ["data", "sheet-v1.glb", "sheet.stl"]


@pytest.mark.parametrize("manifest", ["manifest.json", "report.json"])
def test_results_on_this_machine_are_converted(tmp_path: Path, manifest: str) -> None:
    bundle = downloadable()
    written(bundle, tmp_path)
    with pytest.raises(BadInput, match="name a folder that"):
        convert_folder(tmp_path, "stl", None)
    listed = {"report.json": {"bytes": dict.fromkeys(bundle.files, 9)}}.get(
        manifest, {"files": [{"file": name} for name in bundle.files]}
    )
    (tmp_path / manifest).write_text(json.dumps({**bundle.manifest, **listed, "key": "sheet"}))
    (tmp_path / "cameras.json").write_text("{}")  # of something else: with the points it would be cameras
    (tmp_path / "points.laz").write_bytes(b"LASF")
    with pytest.raises(BadInput, match="colmap cannot be made from what is there"):
        convert_folder(tmp_path, "colmap", None)
    (tmp_path / "tileset.json").write_text("{}")
    assert convert_folder(tmp_path, "stl", None) == tmp_path / "sheet.stl"
    assert convert_folder(tmp_path, "glb", tmp_path / "a.glb").read_bytes()[:4] == b"glTF"
    with pytest.raises(BadInput, match="exe is no format; it can be one of: glb"):
        convert_folder(tmp_path, "exe", None)
    (tmp_path / "mesh.ply").unlink()
    with pytest.raises(BadInput, match="stl cannot be made from what is there"):
        convert_folder(tmp_path, "stl", None)
    (tmp_path / "lod0.glb").write_bytes(b"glTF and no more")
    with pytest.raises(BadInput, match="not a"):
        convert_folder(tmp_path, "glb", None)
    (tmp_path / manifest).write_text("[]")
    with pytest.raises(BadInput, match="is damaged"):
        convert_folder(tmp_path, "glb", None)


@pytest.mark.parametrize("key", ["mesh", "../mesh"])
def test_no_result_is_replaced_by_its_conversion(tmp_path: Path, key: str) -> None:
    bundle, folder = downloadable(), tmp_path / "out"
    folder.mkdir()
    written(bundle, folder)
    report = {**bundle.manifest, "bytes": dict.fromkeys(bundle.files, 9), "key": key}
    (folder / "report.json").write_text(json.dumps(report))
    before = {path: path.read_bytes() for path in tmp_path.rglob("*.*")}
    with pytest.raises(BadInput, match="would be lost: name another file" if key == "mesh" else "is damaged"):
        convert_folder(folder, "ply", None)
    assert {path: path.read_bytes() for path in tmp_path.rglob("*.*")} == before
    if key == "mesh":
        for out in (folder, folder / "none" / "a.ply"):
            with pytest.raises(BadInput, match=f"{out} cannot be written: name a file"):
                convert_folder(folder, "ply", out)
        assert convert_folder(folder, "ply", folder / "mesh-z-up.ply").is_file()


def test_the_capture_beside_its_results_is_not_replaced(tmp_path: Path) -> None:
    """As of `run scan.ply -o .`, whose key is the name of the capture."""
    capture, made = tmp_path / "scan.ply", downloadable()
    capture.write_bytes(b"the capture")
    written(made, tmp_path)
    document = {**made.manifest, "bytes": dict.fromkeys(made.files, 9), "key": "scan"}
    for source, is_refused in (("scan.ply", True), ("", False)):
        (tmp_path / "report.json").write_text(json.dumps({**document, "source": source}))
        if is_refused:
            with pytest.raises(BadInput, match=r"scan\.ply is the capture or one of the results"):
                convert_folder(tmp_path, "ply", None)
            assert capture.read_bytes() == b"the capture"
        else:
            assert convert_folder(tmp_path, "ply", None) == capture


def test_of_two_results_in_a_folder_the_last_is_converted(tmp_path: Path) -> None:
    bundle = downloadable()
    written(bundle, tmp_path)
    run = {**bundle.manifest, "bytes": dict.fromkeys(bundle.files, 9), "key": "of-a-run"}
    pull = {**bundle.manifest, "files": [{"file": name} for name in bundle.files], "key": "of-a-pull"}
    for number, (name, document) in enumerate([("report.json", run), ("manifest.json", pull), ("report.json", run)]):
        (tmp_path / name).write_text(json.dumps(document))
        os.utime(tmp_path / name, (number, number))
        assert convert_folder(tmp_path, "stl", None).stem == document["key"]
