"""`ls`, `rm`, `restore` and `catalogue` against a listening gateway and a store in a folder."""

from __future__ import annotations

import socket
import sys
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import datetime
from functools import partial
from pathlib import Path

import pytest
import uvicorn

from capture2vr.cli.main import main
from capture2vr.gateway.app import create_app
from capture2vr.gateway.settings import GatewaySettings
from capture2vr.storage.catalogue.entry import read_entry
from capture2vr.storage.catalogue.publish import PublishPolicy, publish
from capture2vr.storage.catalogue.root import root_name
from capture2vr.storage.catalogue.signing import Keys, generate_key, read_signer
from capture2vr.storage.local import LocalStore
from tests.support.bundles import bundle

INDEX = root_name("default")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two key pairs and, under `objects`, a store with a shoe and a sofa, signed with `key`."""
    folder = tmp_path_factory.mktemp("catalogue")
    generate_key(folder / "key")
    generate_key(folder / "other")
    store, keys = LocalStore(folder / "objects"), Keys((read_signer(folder / "key"),))
    publish(bundle(label="[bold]Shoe", labels=["footwear"]), store, key="shoe", policy=PublishPolicy(keys))
    publish(bundle(label="Sofa"), store, key="sofa", policy=PublishPolicy(keys))
    return folder


@pytest.fixture(scope="module")
def store(folder: Path) -> LocalStore:
    return LocalStore(folder / "objects")


@pytest.fixture(scope="module")
def url(folder: Path, store: LocalStore) -> Iterator[str]:
    """A gateway that has the key."""
    settings = GatewaySettings(data_dir=folder / "data", workers=("127.0.0.1:9",))
    app = create_app(settings, store, Keys((read_signer(folder / "key"),)))
    with socket.create_server(("127.0.0.1", 0)) as listening:
        server = uvicorn.Server(uvicorn.Config(app, log_config=None, ws="none"))
        thread = threading.Thread(target=server.run, args=([listening],))
        thread.start()
        yield f"http://127.0.0.1:{listening.getsockname()[1]}"
        server.should_exit = True
        thread.join()


@dataclass(frozen=True, slots=True)
class Result:
    code: int
    said: str


Run = Callable[..., Result]


@pytest.fixture
def run(folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    """The command line, in this process, because another takes two seconds to start; STORAGE_ROOT is in `folder`."""

    def call(*arguments: object, **variables: object) -> Result:
        with monkeypatch.context() as patch:
            for name, value in {"STORAGE_ROOT": folder / "objects", **variables}.items():
                patch.setenv(name, str(value))
            patch.setattr(sys, "argv", ["capture2vr", *map(str, arguments)])
            with pytest.raises(SystemExit) as ended:
                main()
        return Result(int(ended.value.code or 0), "".join(capsys.readouterr()))

    return call


@pytest.mark.slow
def test_what_is_there_is_listed_removed_and_restored(url: str, run: Run) -> None:
    listed = run("ls", "--gateway", url)
    assert listed.code == 0, listed.said
    assert "default: 2 assets" in listed.said
    assert "[bold]Shoe" in listed.said  # a label is no markup
    found = run("ls", "--gateway", url, "--label", "FOOTWEAR")
    assert ("shoe" in found.said, "sofa" in found.said) == (True, False)
    today = f"{datetime.now():%Y-%m-%d}"
    for options, count in {
        ("--since", today, "--until", today): 2,
        ("--until", "2020-01-01"): 0,
        ("--min-mb", 1): 0,
    }.items():
        assert f"default: {count} assets" in run("ls", "--gateway", url, *options).said
    assert run("ls", "--gateway", url, "--since", "yesterday").code == 2
    removed = run("rm", "sofa", "--gateway", url)
    assert (removed.code, "sofa version 1 is removed" in removed.said) == (0, True)
    assert "sofa" not in run("ls", "--gateway", url).said
    pulled = run("pull", "sofa", "-o", "never", "--gateway", url)
    assert (pulled.code, "was removed" in pulled.said) == (2, True)
    restored = run("restore", "sofa", "--gateway", url)
    assert (restored.code, "sofa version 1 is available" in restored.said) == (0, True)
    assert "sofa" in run("ls", "--gateway", url).said


@pytest.mark.slow
def test_a_collection_of_ones_own(url: str, store: LocalStore, folder: Path, run: Run) -> None:
    publish(bundle(), store, key="hers", collection="ada", policy=PublishPolicy(Keys((read_signer(folder / "key"),))))
    assert "ada: 1 assets" in run("ls", "--gateway", url, "--collection", "ada").said
    assert "ada: 1 assets" in run("ls", "--gateway", url, STORAGE_COLLECTION="ada").said
    assert "hers" not in run("ls", "--gateway", url).said
    for verb, word in (("rm", "is removed"), ("restore", "is available")):
        other = run(verb, "hers", "--gateway", url, "--collection", "default")
        assert (other.code, "no asset hers in collection default" in other.said, "ada" in other.said) == (2, True, True)
        mine = run(verb, "hers", "--gateway", url, "--collection", "ada")
        assert (mine.code, word in mine.said) == (0, True)


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (["ls", "--collection", "none"], "no collection none"),
        (["ls", "--collection", "../x"], "not a valid collection"),
        (["ls", "--since", "0001-01-01"], "give days of the years 2 to 9998"),
        (["ls", "--until", "9999-12-31"], "give days of the years 2 to 9998"),
        (["ls", "--min-mb", "inf"], "sizes that are finite"),
        (["name", "shoe", "--label", "sch\udcf6n"], "is not UTF-8"),  # as a Latin-1 terminal sends it
        (["rm", "none"], "no asset none"),
        (["rm", "shoe", "--collection", "x" * 300], "not a valid collection"),
        (["pull", "shoe", "-o", "never", "--collection", "ädä"], "not a valid collection"),
        (["pull", "shoe", "-o", "never", "--collection", "none"], "no collection none"),
        (["pull", "none", "-o", "never"], "no asset none"),
        (["rm", "a/b"], "not a valid asset key"),
        (["restore", "ü"], "not a valid asset key"),
        (["catalogue", "verify", "--collection", "none"], "no collection none"),
        (["catalogue", "verify", "--trusted", "nowhere.pub"], "nowhere.pub"),
    ],
)
def test_what_cannot_be_done_is_said_in_a_sentence(url: str, arguments: list[str], word: str, run: Run) -> None:
    result = run(*arguments, "--gateway", url)
    assert result.code == 2
    assert word in result.said
    assert "Traceback" not in result.said


def test_a_collection_is_verified_at_the_gateway_and_on_the_store(url: str, folder: Path, run: Run) -> None:
    trusted = ("--trusted", str(folder / "key.pub"))
    at_gateway = run("catalogue", "verify", "--gateway", url, *trusted)
    on_store = run("catalogue", "verify", "--store", *trusted)
    for result in (at_gateway, on_store):
        assert result.code == 0, result.said
        for what in ("root", "shards", "manifests", "files"):
            assert what in result.said
        assert "not checked" not in result.said
    by_setting = run("catalogue", "verify", "--store", STORAGE_TRUSTED_KEYS=f"{folder}/key.pub")
    assert (by_setting.code, "not checked" in by_setting.said) == (0, False)
    assert "not checked" in run("catalogue", "verify", "--gateway", url).said


@pytest.mark.slow
@pytest.mark.parametrize("where", ["gateway", "store"])
def test_the_first_class_of_faults_ends_with_exit_code_1(
    url: str, folder: Path, store: LocalStore, where: str, run: Run
) -> None:
    def verified(*options: str) -> Result:
        place = ("--gateway", url) if where == "gateway" else ("--store",)
        return run("catalogue", "verify", *place, *options)

    trusted = ("--trusted", str(folder / "key.pub"))
    level = read_entry(store, "shoe").document["lods"][0]["name"]
    content = store.get(level)
    store.delete(level)
    gone = verified(*trusted)
    store.put(level, content, content_type="model/gltf-binary")
    assert (gone.code, f"FILE_MISSING  {level}" in gone.said) == (1, True)
    stranger = verified("--trusted", str(folder / "other.pub"))
    assert (stranger.code, "KEY_UNKNOWN" in stranger.said, "shards" in stranger.said) == (1, True, False)
    older = verified(*trusted, "--at-least", "1000000")
    assert (older.code, "CATALOGUE_OLDER" in older.said) == (1, True)
    index = store.get(INDEX)
    store.put(INDEX, index.replace(b"version", b"Version"), content_type="application/json", cache_control="no-cache")
    forged = verified(*trusted)
    store.put(INDEX, index, content_type="application/json", cache_control="no-cache")
    assert (forged.code, "SIGNATURE_WRONG" in forged.said) == (1, True)
    assert verified(*trusted).code == 0


def test_every_collection_of_a_store_at_once(tmp_path: Path, run: Run) -> None:
    """As after an exchange of keys: one that is forgotten would be refused by clients."""
    mine = partial(run, STORAGE_ROOT=tmp_path / "objects", STORAGE_SIGNING_KEY=tmp_path / "mine")
    assert run("catalogue", "keygen", tmp_path / "mine").code == 0
    nothing = mine("catalogue", "rebuild", "--all")
    assert (nothing.code, "there is no collection default" in nothing.said) == (2, True)
    for collection in ("ada", "bob"):
        publish(bundle(), LocalStore(tmp_path / "objects"), key=f"{collection}-shoe", collection=collection)
    rebuilt = mine("catalogue", "rebuild", "--all")
    assert (rebuilt.code, rebuilt.said.count("signed by")) == (0, 2), rebuilt.said
    verified = mine("catalogue", "verify", "--all")
    assert (verified.code, "collection ada" in verified.said, "collection bob" in verified.said) == (0, True, True)
    level = read_entry(LocalStore(tmp_path / "objects"), "ada-shoe").document["lods"][0]["name"]
    LocalStore(tmp_path / "objects").delete(level)
    broken = mine("catalogue", "verify", "--all")
    assert (broken.code, "FILE_MISSING" in broken.said, "collection bob" in broken.said) == (1, True, True)


def test_a_key_is_made_once_and_a_collection_signed_with_it(tmp_path: Path, run: Run) -> None:
    mine = partial(run, STORAGE_ROOT=tmp_path / "objects")
    publish(bundle(), LocalStore(tmp_path / "objects"), key="shoe")
    mine_key = tmp_path / "keys" / "mine"
    made = run("catalogue", "keygen", mine_key)
    assert made.code == 0, made.said
    assert mine_key.stat().st_mode & 0o777 == 0o600
    assert mine_key.parent.stat().st_mode & 0o777 == 0o700
    again = run("catalogue", "keygen", mine_key)
    assert (again.code, "exists already" in again.said) == (2, True)
    trusted = ("--trusted", f"{mine_key}.pub")
    unsigned = mine("catalogue", "verify", "--store", *trusted)
    assert (unsigned.code, "SIGNATURE_MISSING" in unsigned.said) == (1, True)
    rebuilt = mine("catalogue", "rebuild", STORAGE_SIGNING_KEY=str(mine_key))
    assert rebuilt.code == 0, rebuilt.said
    assert "1 assets, signed by" in rebuilt.said
    assert mine("catalogue", "verify", "--store", *trusted).code == 0
    bad = mine("catalogue", "rebuild", STORAGE_SIGNING_KEY="nowhere")
    assert (bad.code, "STORAGE_SIGNING_KEY" in bad.said, "Traceback" in bad.said) == (2, True, False)
