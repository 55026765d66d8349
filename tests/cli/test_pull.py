"""`pull` from a site that somebody tampers with: what was signed arrives whole, or nothing changes."""

from __future__ import annotations

import gzip
import json
import os
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest

from capture2vr.cli.remote.pull import pull_asset
from capture2vr.client import pull as pull_module
from capture2vr.client.pull import default_cache
from capture2vr.client.seen_version import SeenVersion, state_folder
from capture2vr.errors import BadInput
from capture2vr.storage.bundle import content_name, sha256_hex
from capture2vr.storage.catalogue.change_entry import remove
from capture2vr.storage.catalogue.collection import Row, describe_shard, shard_data
from capture2vr.storage.catalogue.entry import read_entry
from capture2vr.storage.catalogue.publish import PublishPolicy, publish
from capture2vr.storage.catalogue.reader import parse_manifest
from capture2vr.storage.catalogue.root import Index, root_name, sign_index
from capture2vr.storage.catalogue.signing import Keys, generate_key, read_signer
from capture2vr.storage.memory import MemoryStore
from tests.support.bundles import bundle
from tests.support.tilesets import hill_bundle

KEY = "shoe"
HOME = "ada"


@dataclass
class Site:
    """A gateway's answers from a store, and what a rogue in between sends instead: by the end of the path."""

    store: MemoryStore
    keys: Keys
    url: str = ""
    rogue: dict[str, Callable[[bytes], tuple[int, bytes]]] = field(default_factory=dict)
    headers: dict[str, str] = field(default_factory=dict)
    asked: list[str] = field(default_factory=list)

    def publish(self, content: str) -> None:
        publish(bundle(content=content), self.store, key=KEY, collection=HOME, policy=PublishPolicy(self.keys))

    def answer(self, path: str) -> tuple[int, bytes]:
        self.asked.append(path)
        try:
            found = self._found(path)
        except FileNotFoundError:
            problem = {"detail": f"there is no {path}", "code": "UNKNOWN"}
            return 404, json.dumps(problem).encode()
        rogue = next((each for end, each in self.rogue.items() if path.endswith(end) or end in path), None)
        return rogue(found) if rogue else (200, found)

    def _found(self, path: str) -> bytes:
        match path.partition("?")[0].split("/")[1:]:
            case ["v1", "assets", key]:
                return json.dumps(dict(read_entry(self.store, key).document)).encode()
            case ["v1", "collections", name]:
                return json.dumps({**json.loads(self.store.get(root_name(name))), "base": f"{self.url}/o/"}).encode()
            case ["o", *name]:
                return self.store.get("/".join(name))
        raise FileNotFoundError(path)


@pytest.fixture
def key(tmp_path: Path) -> Path:
    generate_key(tmp_path / "key")
    return tmp_path / "key"


@pytest.fixture
def site(key: Path) -> Iterator[Site]:
    """One asset, version 1, signed."""
    site = Site(MemoryStore(), Keys((read_signer(key),)))

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            status, body = site.answer(self.path)
            self.send_response(status)
            for name, value in {"Content-Length": str(len(body)), **site.headers}.items():
                self.send_header(name, value)
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, *_: object) -> None:
            pass

    site.publish("one")
    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        thread = threading.Thread(target=server.serve_forever, args=(0.01,))
        thread.start()
        site.url = f"http://127.0.0.1:{server.server_port}"
        yield site
        server.shutdown()
        thread.join()


Pull = Callable[..., dict[str, object]]


@pytest.fixture
def pull(site: Site, key: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Pull:
    """`pull` into `out` with the public key, a cache and a memory of its own."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    monkeypatch.setenv("STORAGE_ROOT", str(tmp_path / "objects"))

    def call(**asked: object) -> dict[str, object]:
        given = {"trusted": [key.with_name("key.pub")], "collection": HOME, "cache": tmp_path / "cache", **asked}
        return pull_asset(KEY, tmp_path / "out", site.url, **given)  # type: ignore[arg-type]

    return call


def held(out: Path) -> dict[str, bytes]:
    """What lies in a folder, hidden things too."""
    return {path.relative_to(out).as_posix(): path.read_bytes() for path in out.rglob("*") if path.is_file()}


def test_what_was_signed_arrives_and_is_kept(
    site: Site, pull: Pull, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    manifest = pull()
    files = held(tmp_path / "out")
    assert files.keys() == {"lod0.glb", "lod1.glb", "preview.png", "mesh.ply", "manifest.json"}
    assert files["lod0.glb"] == b"lod0.glb preview one"
    assert json.loads(files["manifest.json"]) == manifest
    assert manifest["key"] == KEY
    said = capsys.readouterr().err
    assert "signature, version, sizes and hashes are correct" in said
    assert "not checked" not in said
    site.asked.clear()
    pull()
    assert not [path for path in site.asked if path.endswith((".glb", ".ply", ".png"))], "they are in the cache"
    site.publish("two")
    pull()
    assert (tmp_path / "out" / "lod0.glb").read_bytes() == b"lod0.glb preview two"


def test_the_gateway_says_where_an_asset_is(site: Site, pull: Pull, tmp_path: Path) -> None:
    pull(collection="")
    assert f"/v1/collections/{HOME}?form=tree" in site.asked
    assert "lod0.glb" in held(tmp_path / "out")


def test_without_a_key_it_is_said_what_was_not_checked(
    site: Site, pull: Pull, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    pull(trusted=[])
    said = capsys.readouterr().err
    assert "signature and version were not checked" in said
    assert "--trusted" in said
    assert SeenVersion(site.url, HOME).version == 0, "what nobody signed does not count as seen"
    monkeypatch.setenv("STORAGE_TRUSTED_KEYS", "nowhere.pub")
    with pytest.raises(BadInput, match="STORAGE_TRUSTED_KEYS"):
        pull(trusted=[])


def test_an_older_catalogue_is_refused_with_a_way_out(site: Site, pull: Pull, tmp_path: Path) -> None:
    pull(cache=tmp_path / "other")
    older = site.store.get(root_name(HOME))
    site.publish("two")
    pull()
    site.store.put(root_name(HOME), older, content_type="application/json", cache_control="no-cache")
    before = held(tmp_path / "out")
    with pytest.raises(
        BadInput, match=r"is older: version 1 is older than 2.*delete .*seen.*was not changed"
    ) as refused:
        pull()
    assert held(tmp_path / "out") == before
    pull(trusted=[])  # who trusts nobody has seen nothing
    Path(str(refused.value).split("delete ")[1].split(" here")[0]).unlink()
    pull()
    assert SeenVersion(site.url, HOME).version == 1


def test_another_gateway_or_collection_counts_for_itself(site: Site, pull: Pull) -> None:
    SeenVersion("http://elsewhere", HOME).remember(99)
    SeenVersion(site.url, "bob").remember(99)
    pull()
    assert [SeenVersion(site.url + "/", HOME).version, SeenVersion(site.url, "bob").version] == [1, 99]
    SeenVersion(site.url, "bob").remember(7)
    assert SeenVersion(site.url, "bob").version == 99
    SeenVersion(site.url, HOME).path.write_text("{torn")
    with pytest.raises(BadInput, match="delete it"):
        pull()


def _flipped(data: bytes) -> tuple[int, bytes]:
    return 200, data[:-1] + bytes([data[-1] ^ 1])


TAMPERED = {
    "a flipped file": ("lod1", _flipped, "do not have the hash"),
    "a cut file": ("lod1", lambda data: (200, data[:-1]), "ends after"),
    "an empty file": ("lod1", lambda data: (200, b""), "ends after 0 of"),
    "an endless file": ("lod1", lambda data: (200, data + bytes(9 << 20)), "more than"),
    "a missing file": ("lod1", lambda data: (404, b"gone"), "is missing"),
    "a forbidden file": ("lod1", lambda data: (403, b"no"), "is missing"),
    "a server at fault": ("lod1", lambda data: (500, b"oops"), "answered 500"),
    "another manifest": ("manifest", _flipped, "hash that the catalogue lists"),
    "a cut manifest": ("manifest", lambda data: (200, data[:50]), "hash that the catalogue lists"),
    "no manifest": ("manifest", lambda data: (404, b""), "is missing"),
    "another shard": ("shard", _flipped, "hash that the catalogue lists"),
    "a long shard": ("shard", lambda data: (200, data + b" "), "more than"),
    "no shard": ("shard", lambda data: (404, b""), "not"),
    "a changed index": (f"collections/{HOME}", lambda data: (200, data.replace(b"version", b"Version")), "signature"),
    "an index without signature": (
        f"collections/{HOME}",
        lambda data: (200, json.dumps({**json.loads(data), "signatures": []}).encode()),
        "it is not signed",
    ),
    "a cut index": (f"collections/{HOME}", lambda data: (200, data[:40]), "not as a gateway does"),
}


@pytest.mark.parametrize("what", TAMPERED)
def test_whatever_is_tampered_with_the_older_good_copy_stays(site: Site, pull: Pull, tmp_path: Path, what: str) -> None:
    pull()
    before, cached = held(tmp_path / "out"), held(tmp_path / "cache")
    site.publish("two")
    end, rogue, said = TAMPERED[what]
    site.rogue[end] = rogue
    with pytest.raises(BadInput, match=said):
        pull()
    assert held(tmp_path / "out") == before
    left = held(tmp_path / "cache")
    assert cached.items() <= left.items()
    assert all(sha256_hex(content) == name for name, content in left.items()), "nothing half-written stays"
    site.rogue.clear()
    pull()
    assert (tmp_path / "out" / "lod1.glb").read_bytes() == b"lod1.glb preview two"


@pytest.mark.parametrize("headers", [{"Content-Encoding": "gzip"}, {"Content-Length": "1000000"}])
def test_a_body_that_breaks_off_is_told_of_its_file(
    site: Site, pull: Pull, tmp_path: Path, headers: dict[str, str]
) -> None:
    """A torn compression; a connection that ends before its length."""

    def torn(data: bytes) -> tuple[int, bytes]:
        site.headers.update(headers)
        return 200, gzip.compress(data)[:20]

    site.rogue["lod0"] = torn
    with pytest.raises(BadInput, match=r"lod0\.[0-9a-f]{64}\.glb"):
        pull()
    assert not (tmp_path / "out").exists()


def test_a_user_without_a_home_folder_is_told_what_to_set(monkeypatch: pytest.MonkeyPatch) -> None:
    """As in a container that runs as a number that no user has."""

    def no_home() -> Path:
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.setattr(Path, "home", no_home)
    for variable, folder in (("XDG_CACHE_HOME", default_cache), ("XDG_STATE_HOME", state_folder)):
        monkeypatch.delenv(variable, raising=False)
        with pytest.raises(OSError, match=f"no home folder: set {variable}"):
            folder()
        monkeypatch.setenv(variable, "/x")
        assert folder() == Path("/x/capture2vr")


def test_a_rotten_cache_heals(pull: Pull, tmp_path: Path) -> None:
    pull()
    good = held(tmp_path / "cache")
    for name in good:
        (tmp_path / "cache" / name).write_bytes(b"rotten")
    pull()
    assert held(tmp_path / "cache") == good


def test_what_a_killed_command_left_goes(pull: Pull, tmp_path: Path) -> None:
    (tmp_path / "out" / ".pulling").mkdir(parents=True)
    (tmp_path / "out" / ".pulling" / "lod0.glb").write_bytes(b"half")
    (tmp_path / "cache").mkdir()
    old, fresh = tmp_path / "cache" / ".part-old", tmp_path / "cache" / ".part-fresh"
    for part in (old, fresh):
        part.write_bytes(b"half")
    os.utime(old, (0, 0))
    pull()
    assert (old.exists(), fresh.exists()) == (False, True), "another command may still write the fresh one"
    assert not (tmp_path / "out" / ".pulling").exists()


def test_files_that_the_new_version_has_no_more_go_unless_they_are_yours(
    site: Site, pull: Pull, tmp_path: Path
) -> None:
    pull()
    out = tmp_path / "out"
    (out / "notes.txt").write_text("mine")
    (out / "preview.png").write_text("drawn over")
    fewer = bundle(content="two")
    files = {name: content for name, content in fewer.files.items() if name not in ("mesh.ply", "preview.png")}
    publish(replace(fewer, files=files), site.store, key=KEY, collection=HOME, policy=PublishPolicy(site.keys))
    pull()
    assert held(out).keys() == {"lod0.glb", "lod1.glb", "manifest.json", "notes.txt", "preview.png"}


@pytest.mark.parametrize("name", ["mesh.ply", "manifest.json"])
def test_a_file_of_ones_own_is_never_replaced(site: Site, pull: Pull, tmp_path: Path, name: str) -> None:
    """As the capture itself, in whose folder the asset is pulled."""
    out = tmp_path / "out"
    out.mkdir()
    (out / name).write_text('{"name": "mine"}')
    with pytest.raises(BadInput, match=f"{name} is of no earlier pull, and would be replaced"):
        pull()
    assert held(out) == {name: b'{"name": "mine"}'}
    (out / name).unlink()
    pull()
    (out / "manifest.json").unlink()  # as if it had been killed just before that was written
    (out / "preview.png").unlink()
    pull()
    (out / "mesh.ply").write_text("drawn over")
    site.publish("two")
    pull()
    assert held(out)["mesh.ply"] == bundle(content="two").files["mesh.ply"]


def test_a_folder_in_the_way_is_named_before_anything_changes(site: Site, pull: Pull, tmp_path: Path) -> None:
    pull()
    (tmp_path / "out" / "lod1.glb").unlink()
    (tmp_path / "out" / "lod1.glb").mkdir()
    before = held(tmp_path / "out")
    site.publish("two")
    with pytest.raises(BadInput, match=r"lod1\.glb is a folder"):
        pull()
    assert held(tmp_path / "out") == before


def test_a_full_disk_leaves_the_older_copy(
    site: Site, pull: Pull, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pull()
    before = held(tmp_path / "out")
    site.publish("two")
    copied = []

    def full(source: Path, target: Path) -> None:
        copied.append(target)
        target.write_bytes(source.read_bytes()[:3])
        if len(copied) == 3:
            raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(pull_module.shutil, "copyfile", full)
        with pytest.raises(OSError, match="No space"):
            pull()
    assert held(tmp_path / "out") == before


def test_removed_and_unknown_assets_are_named(site: Site, pull: Pull, tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="there is no asset boot in collection ada"):
        pull_asset("boot", tmp_path / "out", site.url, collection=HOME, cache=tmp_path / "cache")
    remove(site.store, KEY, site.keys)
    with pytest.raises(BadInput, match="was removed"):
        pull()
    for name in ("../ada", "ä", "a/b", "x" * 300):
        with pytest.raises(BadInput, match="not a valid"):
            pull(collection=name)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("file", "said"),
    [
        ("../evil", "not a plain file name"),
        ("..", "not a plain file name"),
        (".bashrc", "not a plain file name"),
        ("/etc/x", "not a plain file name"),
        ("a" * 300, "not a plain file name"),
        ("", "not a plain file name"),
        ("manifest.json", "not a plain file name"),
    ],
)
def test_a_hostile_publisher_writes_nothing_outside(
    site: Site, pull: Pull, tmp_path: Path, file: str, said: str
) -> None:
    """Signed, but the manifest names files that no folder should get."""
    content = b"evil"
    sha256 = sha256_hex(content)
    name = f"assets/{KEY}/{content_name('evil.bin', sha256)}"
    manifest = json.dumps({"files": [{"file": file, "name": name, "sha256": sha256, "bytes": len(content)}]}).encode()
    row = Row(KEY, "", (), 9, "refined", 1, sha256_hex(manifest), "")
    site.store.put(name, content, content_type="application/octet-stream")
    site.store.put(row.manifest_name, manifest, content_type="application/json")
    rows = shard_data([row], "9")
    shard = describe_shard(HOME, [row], rows)
    site.store.put(shard.name, rows, content_type="application/json")
    index = sign_index(Index(HOME, 9, "now", (shard,)), site.keys.signers)
    site.store.put(root_name(HOME), index, content_type="application/json", cache_control="no-cache")
    with pytest.raises(BadInput, match=said):
        pull()
    assert not (tmp_path / "out").exists()


def test_a_manifest_lists_each_file_once_with_its_hash() -> None:
    good = {"file": "a.glb", "name": "assets/a", "sha256": "0" * 64, "bytes": 1}
    for bad in ([good, good], [{**good, "sha256": "../x"}], [{**good, "bytes": "many"}], [{}], None):
        data = json.dumps({"files": bad}).encode()
        with pytest.raises(OSError, match="it lists"):
            parse_manifest(data, Row(KEY, "", (), 1, "refined", 1, sha256_hex(data), "").manifest_name)


def test_a_pulled_scene_in_tiles_is_a_tileset_of_its_own(site: Site, pull: Pull, tmp_path: Path) -> None:
    scene, root = hill_bundle(levels=2)
    publish(scene, site.store, key=KEY, collection=HOME, policy=PublishPolicy(site.keys))

    pull()

    out = tmp_path / "out"
    tileset = json.loads((out / "tileset.json").read_bytes())
    children = tileset["root"]["children"]
    uris = [tile["content"]["uri"] for tile in (tileset["root"], *children)]
    assert uris == [tile.name for tile in root]
    assert [sha256_hex((out / uri).read_bytes()) for uri in uris] == [tile.sha256 for tile in root]
