"""Downloads are made from what was published, once, and leave nothing behind where they cannot be made."""

from __future__ import annotations

import hashlib
import io
import zipfile
from pathlib import Path

import pytest

from capture2vr.edge.errors import Cancelled, EdgeError
from capture2vr.edge.jobs import make_download as module
from capture2vr.edge.jobs.make_download import make_download
from capture2vr.order.download_formats import FORMATS
from capture2vr.storage.bundle import Bundle
from capture2vr.storage.catalogue.deletion import delete_asset
from capture2vr.storage.catalogue.downloads import DownloadOrder, find_download, store_download
from capture2vr.storage.catalogue.entry import read_entry
from capture2vr.storage.catalogue.publish import publish
from capture2vr.storage.memory import MemoryStore
from tests.support.downloadable import downloadable
from tests.support.tilesets import hill_bundle


def no_tick(_: float) -> None:
    """Nobody hangs up."""


def published(bundle: Bundle | None = None) -> MemoryStore:
    store = MemoryStore()
    publish(bundle or downloadable(), store, key="sheet", job="job_1")
    return store


def order(store: MemoryStore, name: str) -> DownloadOrder:
    return DownloadOrder("sheet", read_entry(store, "sheet").document["manifest"]["sha256"], FORMATS[name])


def scratch(tmp_path: Path, name: str = "scratch") -> Path:
    folder = tmp_path / name
    folder.mkdir()
    return folder


@pytest.mark.slow
def test_it_is_made_once_under_its_hash(tmp_path: Path) -> None:
    store = published()
    wanted = order(store, "obj")
    assert find_download(store, wanted) is None
    made = make_download(store, wanted, scratch(tmp_path), no_tick)
    content = store.get(made.name)
    assert made.name == f"assets/sheet/sheet-obj.{hashlib.sha256(content).hexdigest()}.zip"
    assert made.size == len(content)
    assert store.head(made.name).content_type == "application/zip"
    assert find_download(store, wanted) == made
    before = store.list("")
    assert make_download(store, wanted, scratch(tmp_path, "again"), no_tick) == made
    assert store.list("") == before
    store.delete(made.name)  # lost: it is made again
    assert make_download(store, wanted, scratch(tmp_path, "lost"), no_tick) == made
    delete_asset(store, "sheet")
    assert [head.name for head in store.list("assets/")] == []


@pytest.mark.slow
def test_a_file_of_the_bundle_is_not_stored_twice(tmp_path: Path) -> None:
    store = published()
    before = {head.name for head in store.list("")}
    wanted = order(store, "glb-meshopt")
    made = make_download(store, wanted, scratch(tmp_path), no_tick)
    assert made.name == read_entry(store, "sheet").document["lods"][0]["name"]
    assert {head.name for head in store.list("")} - before == {wanted.record_name}


@pytest.mark.slow
def test_a_scene_in_tiles_is_made_of_all_its_tiles(tmp_path: Path) -> None:
    bundle, root = hill_bundle(levels=2)
    store = published(bundle)
    made = make_download(store, order(store, "3d-tiles"), scratch(tmp_path), no_tick)
    with zipfile.ZipFile(io.BytesIO(store.get(made.name))) as package:
        assert sorted(package.namelist()) == sorted(["tileset.json", *(each.name for each in root)])


def code_of(store: MemoryStore, wanted: DownloadOrder, folder: Path) -> str:
    before = {head.name for head in store.list("")}
    with pytest.raises(EdgeError) as refused:
        make_download(store, wanted, folder, no_tick)
    assert {head.name for head in store.list("")} == before
    return refused.value.code


def test_what_is_not_there_cannot_be_made(tmp_path: Path) -> None:
    bundle = downloadable()
    store = published(Bundle("refined", {"lod0.glb": bundle.files["lod0.glb"]}, bundle.manifest, last=True))
    assert code_of(store, order(store, "stl"), scratch(tmp_path, "none")) == "DOWNLOAD_IMPOSSIBLE"
    other = DownloadOrder("sheet", "0" * 64, FORMATS["glb"])
    assert code_of(store, other, scratch(tmp_path, "other")) == "DOWNLOAD_SOURCE_MISSING"
    store.delete(read_entry(store, "sheet").document["lods"][0]["name"])
    assert code_of(store, order(store, "glb"), scratch(tmp_path, "lost")) == "DOWNLOAD_SOURCE_MISSING"


def test_what_is_too_large_is_not_even_fetched(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "_MOST_BYTES", 100)
    store = published()
    folder = scratch(tmp_path)
    assert code_of(store, order(store, "ply"), folder) == "DOWNLOAD_TOO_LARGE"
    assert sorted(path.name for path in (folder / "bundle").iterdir()) == ["manifest.json"]


@pytest.mark.slow
def test_a_conversion_that_takes_too_long_is_ended(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "_MOST_SECONDS", 0.0)
    store = published()
    assert code_of(store, order(store, "obj"), scratch(tmp_path)) == "DOWNLOAD_TOO_LARGE"


def test_it_ends_when_nobody_wants_it(tmp_path: Path) -> None:
    store = published()

    def hang_up(_: float) -> None:
        raise Cancelled

    with pytest.raises(Cancelled):
        make_download(store, order(store, "obj"), scratch(tmp_path), hang_up)


def test_an_asset_that_was_deleted_meanwhile_leaves_nothing(tmp_path: Path) -> None:
    store = published()
    wanted = order(store, "stl")
    delete_asset(store, "sheet")
    made = tmp_path / "made"
    made.write_bytes(b"solid")
    with pytest.raises(FileNotFoundError):
        store_download(store, wanted, made, {})
    assert store.list("assets/") == []
