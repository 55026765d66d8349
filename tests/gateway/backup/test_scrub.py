"""The scrub finds files that are not what was published, whatever their size and time say; restarts do not stop it."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest

from capture2vr.cli.backups.database_work import scrub_store
from capture2vr.gateway.backup import scrub
from capture2vr.gateway.backup.scrub import Scrub
from capture2vr.storage.catalogue.publish import publish
from capture2vr.storage.local import LocalStore
from capture2vr.storage.tenant_store import store_of_tenant
from tests.support.bundles import bundle
from tests.support.in_process_gateway import gateway


@pytest.fixture
def store(tmp_path: Path) -> LocalStore:
    """Two assets, one of them a tenant's."""
    made = LocalStore(tmp_path / "objects")
    publish(bundle(content="boot"), made, key="boot")
    publish(bundle(content="shoe"), store_of_tenant(made, "ada"), key="shoe")
    return made


def files(store: LocalStore) -> list[str]:
    return [head.name for prefix in ("assets/", "tenants/ada/assets/") for head in store.list(prefix)]


def rot(path: Path) -> None:
    """Change a byte; size and time stay, as when a disk loses it."""
    stat = path.stat()
    data = bytearray(path.read_bytes())
    data[0] ^= 1
    with path.open("r+b") as file:
        file.write(data)
    os.utime(path, ns=(stat.st_atime_ns, stat.st_mtime_ns))


@pytest.fixture
def faults(monkeypatch: pytest.MonkeyPatch) -> dict[str, int]:
    """The errno with which the disk refuses to read an object behind its first byte, by name."""
    refused: dict[str, int] = {}
    read = LocalStore.get

    def get(self: LocalStore, name: str, *, start: int = 0, length: int | None = None) -> bytes:
        if name in refused and start:
            raise OSError(refused[name], os.strerror(refused[name]))
        return read(self, name, start=start, length=1 if name in refused else length)

    monkeypatch.setattr(LocalStore, "get", get)
    return refused


def whole(store: LocalStore, progress: Path) -> Scrub:
    made = Scrub(store, progress, 7)
    for _ in made.steps():
        pass
    return made


def test_whole_files_are_whole(store: LocalStore, tmp_path: Path) -> None:
    done = whole(store, tmp_path / "scrub.json").state
    assert (done.checked, done.damaged, done.after) == (len(files(store)), [], "")
    assert done.ended


def test_a_rotten_byte_is_found_in_every_tenants_files(store: LocalStore, tmp_path: Path) -> None:
    rotten = [next(name for name in files(store) if name.startswith(prefix)) for prefix in ("assets/", "tenants/")]
    for name in rotten:
        rot(store.path(name))
    assert whole(store, tmp_path / "scrub.json").state.damaged == rotten


def test_a_file_that_the_disk_cannot_read_is_damaged_and_the_others_are_read(
    store: LocalStore, tmp_path: Path, faults: dict[str, int], caplog: pytest.LogCaptureFixture
) -> None:
    unreadable, *_, rotten = files(store)
    faults[unreadable] = errno.EIO
    rot(store.path(rotten))
    done = whole(store, tmp_path / "scrub.json").state
    assert (done.checked, done.damaged) == (len(files(store)), [unreadable, rotten])
    assert done.ended
    assert f"{unreadable} is damaged: the disk cannot read it from byte 1 on" in caplog.text


def test_the_command_line_names_what_the_disk_cannot_read(
    tmp_path: Path, faults: dict[str, int], capsys: pytest.CaptureFixture[str]
) -> None:
    store = LocalStore(tmp_path / "store")
    publish(bundle(content="boot"), store, key="boot")
    unreadable = next(head.name for head in store.list("assets/"))
    faults[unreadable] = errno.EIO
    assert not scrub_store(tmp_path)
    assert f"damaged: {unreadable}" in capsys.readouterr().err


async def test_a_file_that_was_not_checked_is_checked_in_the_next_round(
    store: LocalStore, tmp_path: Path, faults: dict[str, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another fault than the disk's ends the round: the store is away. Nothing was said of the file that met it."""
    monkeypatch.setattr(scrub, "_READS_A_SECOND", 1e6)
    met = files(store)[2]
    rot(store.path(met))
    faults[met] = errno.ESTALE
    background = Scrub(store, tmp_path / "scrub.json", 7)
    await background._round()
    assert (background.state.checked, background.state.damaged, background.state.ended) == (2, [], 0.0)
    faults.clear()
    await background._round()
    assert (background.state.checked, background.state.damaged) == (len(files(store)), [met])
    assert background.state.ended


def test_it_goes_on_after_a_restart(store: LocalStore, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scrub, "_PAGE", 1)
    every = list(Scrub(store, tmp_path / "other.json", 7).steps())
    first = Scrub(store, tmp_path / "scrub.json", 7).steps()
    seen = [next(first) for _ in range(len(every) // 2)]
    again = Scrub(store, tmp_path / "scrub.json", 7)
    rest = list(again.steps())
    assert {*seen, *rest} >= set(files(store))
    assert again.state.checked == len(files(store))
    assert len(rest) < len(every)


def test_what_is_no_file_of_an_asset_is_passed_in_steps_too(store: LocalStore, tmp_path: Path) -> None:
    """Millions of catalogue entries are not listed at one go, without a pause."""
    for number in range(600):
        store.put(f"catalog/{number}.json", b"{}", content_type="application/json")
    assert len(list(Scrub(store, tmp_path / "scrub.json", 7).steps())) >= len(files(store)) + 2


def test_damaged_progress_begins_anew(store: LocalStore, tmp_path: Path) -> None:
    (tmp_path / "scrub.json").write_text("{")
    assert whole(store, tmp_path / "scrub.json").state.checked == len(files(store))


async def test_operators_are_told(store: LocalStore, tmp_path: Path) -> None:
    rot(store.path(files(store)[0]))
    (tmp_path / "gw").mkdir()
    whole(store, tmp_path / "gw" / "scrub.json")
    async with gateway(tmp_path / "gw", store) as client:
        check = (await client.get("/readyz")).json()["checks"]["store"]
        assert check["ok"]
        assert "1 files are damaged" in check["detail"]
        assert "capture2vr_scrub_damaged_files 1.0" in (await client.get("/metrics")).text
