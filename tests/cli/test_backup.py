"""`backup create | verify | restore`: a service is backed up while it runs, and restored on an empty machine."""

from __future__ import annotations

import fcntl
import io
import json
import os
import re
import shutil
import subprocess
import sys
import time
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, redirect_stderr
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import httpx
import numpy as np
import pytest
import sqlalchemy as sa

from capture2vr.cli.backups.backup_folder import NAME_TIME, backups_in
from capture2vr.cli.backups.sealed_keys import PASSPHRASE_VARIABLE
from capture2vr.cli.main import main
from capture2vr.cli.up import free_port
from capture2vr.gateway.access.store import AccessStore
from capture2vr.gateway.backup.backup_records import BackupRecords, BackupTimes
from capture2vr.gateway.backup.database_copy import Imported, import_database
from capture2vr.gateway.database.database import open_engine
from capture2vr.gateway.database.instance_lock import lock_instance
from capture2vr.gateway.jobs.job import Order
from capture2vr.gateway.jobs.store import JobStore
from capture2vr.gateway.webhooks.store import WebhookStore
from capture2vr.gateway.webhooks.tables import webhooks
from capture2vr.order.job_options import JobOptions
from capture2vr.storage.catalogue.publish import publish
from capture2vr.storage.catalogue.signing import generate_key
from capture2vr.storage.local import LocalStore
from capture2vr.storage.object_backup import restore_objects
from capture2vr.storage.settings import StorageSettings, open_store
from capture2vr.storage.store import Store, list_all
from tests.conftest import missing
from tests.referees.postgres import programs, running
from tests.referees.s3.server import S3Server
from tests.support.bundles import bundle
from tests.support.clouds import write_ply
from tests.support.patience import HANG_S, PATIENCE_S
from tests.support.repository import ROOT
from tests.support.service_processes import ServiceProcess, killed_at_the_end

pytestmark = pytest.mark.slow

PASSPHRASE = "a passphrase of a test"


def capture2vr(environment: Mapping[str, str], *arguments: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "capture2vr.cli", *map(str, arguments)]
    variables = {**os.environ, **environment}
    return subprocess.run(command, env=variables, cwd=ROOT, capture_output=True, text=True, timeout=HANG_S)


class Machine:
    """A machine with a gateway and a worker; its database and store may be elsewhere."""

    def __init__(self, folder: Path, **variables: object) -> None:
        """variables: of both services; they name database and store where those are not in the folder"""
        (folder / "gateway").mkdir(parents=True)
        self.folder, self.keys = folder, folder / "keys"
        self._edge_port, gateway_port = free_port(), free_port()
        self.url = f"http://127.0.0.1:{gateway_port}"
        own = {
            "GATEWAY_DATA_DIR": folder / "gateway",
            "GATEWAY_PORT": gateway_port,
            "GATEWAY_WORKERS": f"127.0.0.1:{self._edge_port}",
            "EDGE_PORT": self._edge_port,
            "EDGE_SCRATCH": folder / "scratch",
            "STORAGE_ROOT": folder / "objects",
            "STORAGE_SIGNING_KEY": self.keys / "containers" / "signing",
            "XDG_STATE_HOME": folder / "state",
            PASSPHRASE_VARIABLE: PASSPHRASE,
            "OMP_NUM_THREADS": 1,
        }
        self.environment = {name: str(value) for name, value in {**own, **variables}.items()}

    def start(self, service: str) -> ServiceProcess:
        return ServiceProcess(f"capture2vr.{service}", self.folder / f"{service}.log", **self.environment)

    def run(self, *arguments: object) -> str:
        """What a command says, that succeeds."""
        done = capture2vr(self.environment, *arguments)
        assert done.returncode == 0, done.stderr
        return done.stdout + done.stderr

    def wait(self, path: str, holds: str) -> None:
        """Wait until the gateway answers so."""
        deadline = time.monotonic() + HANG_S
        while time.monotonic() < deadline:
            try:
                answer = httpx.get(self.url + path, headers=self.bearer, timeout=PATIENCE_S)
                if answer.is_success and holds in answer.text:
                    return
            except httpx.TransportError:
                pass
            time.sleep(0.05)
        raise AssertionError(f"{path}: {(self.folder / 'gateway.log').read_text()[-2000:]}")

    @property
    def bearer(self) -> dict[str, str]:
        return {"Authorization": f"Bearer {self.environment.get('CAPTURE2VR_KEY', '')}"}

    def pulled(self, key: str) -> dict[str, bytes]:
        """The files of an asset, which `pull` has checked with the public key."""
        out = self.folder / f"pulled-{key}"
        trusted = ("--trusted", self.keys / "containers" / "signing.pub", "--cache", self.folder / "cache")
        said = self.run("pull", key, "-o", out, "--gateway", self.url, *trusted)
        assert "hashes are correct" in said
        return {path.name: path.read_bytes() for path in out.iterdir()}


@pytest.fixture(scope="module")
def leaf(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A narrow leaf of 500 points."""
    xyz = np.random.default_rng(2).normal(size=(500, 3)) * [0.02, 0.0, 0.1]
    return write_ply(tmp_path_factory.mktemp("leaf") / "leaf.ply", xyz)


@pytest.fixture(params=["a folder", pytest.param("Postgres and S3", marks=pytest.mark.s3)])
def places(request: pytest.FixtureRequest) -> Iterator[list[dict[str, object]]]:
    """Where the database and the store of the old and of the new machine are."""
    if request.param == "a folder":
        yield [{}, {}]
        return
    server: S3Server = request.getfixturevalue("s3_server")
    found = programs()
    if found is None:
        missing("a Postgres server")
    assert found is not None
    with ExitStack() as stack:
        made: list[dict[str, object]] = []
        for name in ("old", "new"):
            made.append(
                {
                    "GATEWAY_DATABASE_URL": stack.enter_context(running(found)),
                    "STORAGE_KIND": "s3",
                    "STORAGE_BUCKET": f"backup-{name}",
                    "STORAGE_ENDPOINT": server.endpoint,
                    "STORAGE_ACCESS_KEY": server.access_key,
                    "STORAGE_SECRET_KEY": server.secret_key,
                }
            )
        yield made


def test_all_comes_back_on_an_empty_machine(places: list[dict[str, object]], leaf: Path, tmp_path: Path) -> None:
    old, backups = Machine(tmp_path / "old", **places[0]), tmp_path / "backups"
    (old.keys / "containers").mkdir(parents=True)
    generate_key(old.keys / "containers" / "signing")
    make_bucket(old)
    key = old.run("keys", "create", "--scope", "operate", "--scope", "capture", "--scope", "read").split()
    old.environment["CAPTURE2VR_KEY"] = next(word for word in key if word.startswith("c2v_"))
    gateway, edge = old.start("gateway"), old.start("edge")
    with killed_at_the_end(gateway, edge):
        old.wait("/readyz", "")
        for name in ("leaf", "twig"):
            old.run("push", leaf, "--key", name, "--preset", "draft", "--gateway", old.url)
        edge.kill()
        captures = httpx.get(f"{old.url}/v1/captures", headers=old.bearer).json()["captures"]
        order = {"capture": captures[0]["capture"], "asset_key": "late", "preset": "draft"}
        waiting = httpx.post(f"{old.url}/v1/jobs", json=order, headers=old.bearer).raise_for_status().json()["id"]
        for _ in range(2):  # the second copies nothing again
            said = old.run("backup", "create", backups, "--with-objects", "--keys", old.keys, "--keep", 1)
        assert "1 older ones were removed" in said
        assert "is whole, and was removed again" in old.run("backup", "drill", backups)
        assert nothing_left_of_a_drill(old)
        old.wait("/metrics", 'capture2vr_copy_seconds{copy="drill"} 1.')  # looked at every few seconds
        assert re.search(r'^capture2vr_copy_seconds{copy="backup"} 1\.', metrics(old), re.MULTILINE)
        assert "every file of it is whole" in old.run("backup", "verify", backups)
        before = {name: old.pulled(name) for name in ("leaf", "twig")}
    shutil.rmtree(old.folder)

    new = Machine(tmp_path / "new", **places[1])
    new.environment["CAPTURE2VR_KEY"] = old.environment["CAPTURE2VR_KEY"]
    make_bucket(new)
    said = new.run("backup", "restore", backups, "--keys", new.keys)
    assert (new.keys / "containers" / "signing").stat().st_mode & 0o777 == 0o600
    with killed_at_the_end(new.start("gateway"), new.start("edge")):
        new.wait(f"/v1/jobs/{waiting}", '"SUCCEEDED"')
        assert {name: new.pulled(name) for name in ("leaf", "twig")} == before
        assert new.pulled("late").keys() == before["leaf"].keys()
        new.run("push", leaf, "--key", "leaf", "--preset", "draft", "--gateway", new.url)
        assert httpx.get(f"{new.url}/v1/assets/leaf", headers=new.bearer).json()["version"] == 2
    trusted = ("--trusted", new.keys / "containers" / "signing.pub")
    new.run("catalogue", "verify", "--store", "--all", *trusted)


def metrics(machine: Machine) -> str:
    return httpx.get(f"{machine.url}/metrics", headers=machine.bearer).raise_for_status().text


def nothing_left_of_a_drill(machine: Machine) -> bool:
    variables = machine.environment
    named = {name.removeprefix("STORAGE_").lower(): text for name, text in variables.items() if "STORAGE_" in name}
    if any(list_all(open_store(StorageSettings(**{**named, "signing_key": ()})), "uploads/")):
        return False
    if url := variables.get("GATEWAY_DATABASE_URL"):
        engine = sa.create_engine(url)
        schemas = sa.inspect(engine).get_schema_names()
        engine.dispose()
        if "capture2vr_drill" in schemas:
            return False
    return not (machine.folder / "gateway" / "drill").exists()


def make_bucket(machine: Machine) -> None:
    command = [sys.executable, "-m", "capture2vr.storage.bucket"]
    subprocess.run(command, env={**os.environ, **machine.environment}, check=True, capture_output=True)


@dataclass(frozen=True, slots=True)
class Ended:
    """A command that has ended in this process."""

    returncode: object
    stderr: str


@pytest.fixture
def data(tmp_path: Path) -> Path:
    """The data folder of `up`, with a job and an asset."""
    fill(tmp_path / "data", "dress")
    return tmp_path / "data"


@pytest.fixture
def backups(data: Path, tmp_path: Path) -> Path:
    """A folder with a backup of everything."""
    (tmp_path / "keys").mkdir()
    generate_key(tmp_path / "keys" / "signing")
    created = backup("create", tmp_path / "backups", "--with-objects", "--keys", tmp_path / "keys", "--data", data)
    assert created.returncode == 0, created.stderr
    return tmp_path / "backups"


def fill(data: Path, key: str) -> None:
    (data / "gateway").mkdir(parents=True, exist_ok=True)
    engine = open_engine(f"sqlite:///{data / 'gateway' / 'gateway.db'}")
    JobStore(engine).create("default", Order("cap_1", key, JobOptions("draft")))
    engine.dispose()
    publish(bundle(), LocalStore(data / "store"), key=key)


def backup(*arguments: object, **environment: str) -> Ended:
    """Run `capture2vr backup`; what fails says so in one sentence."""
    stderr = io.StringIO()
    with pytest.MonkeyPatch.context() as patch, redirect_stderr(stderr):
        patch.setattr(sys, "argv", ["capture2vr", "backup", *map(str, arguments)])
        for name, value in {PASSPHRASE_VARIABLE: PASSPHRASE, **environment}.items():
            patch.setenv(name, value)
        with pytest.raises(SystemExit) as ended:
            main()
    done = Ended(ended.value.code or 0, stderr.getvalue())
    if done.returncode == 2:
        assert len([line for line in done.stderr.splitlines() if line.startswith("capture2vr: ")]) == 1
    return done


def files(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


def newest(backups: Path) -> Path:
    return backups / "backups" / backups_in(backups)[0]


@pytest.mark.parametrize("part", ["backup.json", "database.zip", "objects.json.gz", "keys.sealed", "objects"])
@pytest.mark.parametrize("damage", ["a byte is another one", "it is missing"])
def test_damage_is_found_and_nothing_is_restored(backups: Path, part: str, damage: str, tmp_path: Path) -> None:
    file = next((backups / "objects").rglob("*/*")) if part == "objects" else newest(backups) / part
    if damage == "it is missing":
        file.unlink()
    else:
        content = bytearray(file.read_bytes())
        content[len(content) // 2] ^= 1
        file.write_bytes(content)
    verified = backup("verify", backups)
    assert verified.returncode == (2 if part == "backup.json" else 1)
    assert file.name in verified.stderr
    restored = backup("restore", backups, "--data", tmp_path / "new")
    assert restored.returncode == 2
    assert file.name in restored.stderr
    assert not (tmp_path / "new" / "store" / "catalog").exists()
    assert not (tmp_path / "new" / "gateway" / "gateway.db").exists()


def test_what_is_there_is_never_overwritten(backups: Path, data: Path, tmp_path: Path) -> None:
    before = files(data / "store")
    database = backup("restore", backups, "--data", data)
    assert (database.returncode, "it has rows: 1 in jobs" in database.stderr) == (2, True)
    fill(tmp_path / "other", "hat")
    objects = backup("restore", backups, "--only", "objects", "--data", tmp_path / "other")
    assert (objects.returncode, "the store is not empty: it has " in objects.stderr) == (2, True)
    assert not list(list_all(LocalStore(tmp_path / "other" / "store"), "assets/dress"))
    generate_key(tmp_path / "mine")
    (tmp_path / "others").mkdir()
    shutil.copy(tmp_path / "mine", tmp_path / "others" / "signing")
    keys = backup("restore", backups, "--only", "keys", "--keys", tmp_path / "others", "--data", tmp_path / "x")
    assert (keys.returncode, "it has signing already" in keys.stderr) == (2, True)
    assert (tmp_path / "others" / "signing").read_bytes() == (tmp_path / "mine").read_bytes()
    assert files(data / "store") == before


def test_a_restore_that_was_killed_is_repeated(backups: Path, data: Path, tmp_path: Path) -> None:
    """Objects and keys are written before the database: what is there of them is as in the backup."""
    new = tmp_path / "new"
    assert backup("restore", backups, "--only", "objects", "--data", new).returncode == 0
    store = LocalStore(new / "store")
    store.delete(next(head.name for head in list_all(store, "assets/")))
    again = backup("restore", backups, "--keys", tmp_path / "keys", "--data", new)
    assert again.returncode == 0, again.stderr
    assert f"1 of {len(list(list_all(store, '')))} objects were written" in again.stderr
    assert {head.name for head in list_all(store, "")} == {
        head.name for head in list_all(LocalStore(data / "store"), "")
    }


def test_without_contents_the_store_is_compared(data: Path, tmp_path: Path) -> None:
    assert backup("create", tmp_path / "b", "--data", data).returncode == 0
    assert not list((tmp_path / "b" / "objects").iterdir())
    new = tmp_path / "new"
    shutil.copytree(data / "store", new / "store")
    assert backup("restore", tmp_path / "b", "--data", new).returncode == 0
    store = LocalStore(new / "store")
    lost = next(head.name for head in list_all(store, "assets/"))
    store.delete(lost)
    found = backup("restore", tmp_path / "b", "--only", "objects", "--data", new)
    assert (found.returncode, f"missing: {lost}" in found.stderr) == (1, True)


@pytest.mark.parametrize("variable", ["STORAGE_COLLECTION", "STORAGE_SIGNING_KEY", "STORAGE_ROOT"])
def test_variables_that_name_no_store_leave_that_of_up(data: Path, tmp_path: Path, variable: str) -> None:
    """STORAGE_ROOT is empty, which is as good as none."""
    value = "" if variable == "STORAGE_ROOT" else "ada"
    created = backup("create", tmp_path / "b", "--with-objects", "--data", data, **{variable: value})
    assert " 0 objects" not in created.stderr
    assert list((tmp_path / "b" / "objects").glob("??/*"))


def test_a_gateway_without_up_has_its_store_elsewhere(
    data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (data / "store").rename(tmp_path / "data" / "objects")
    (data / "gateway" / "gateway.db").rename(data / "gateway.db")
    created = backup("create", tmp_path / "b", "--with-objects", "--data", data)
    assert created.returncode == 0, created.stderr
    assert list((tmp_path / "b" / "objects").glob("??/*"))
    assert not (data / "store").exists()


def test_a_running_gateways_folder_is_not_restored_to(backups: Path, tmp_path: Path) -> None:
    with lock_instance(tmp_path / "new" / "gateway"):
        refused = backup("restore", backups, "--data", tmp_path / "new")
    assert (refused.returncode, "another gateway uses" in refused.stderr) == (2, True)


def test_a_newer_version_is_named(backups: Path, data: Path, tmp_path: Path) -> None:
    engine = sa.create_engine(f"sqlite:///{data / 'gateway' / 'gateway.db'}")
    with engine.begin() as db:
        db.exec_driver_sql("UPDATE alembic_version SET version_num = '9999_later'")
    engine.dispose()
    assert backup("create", backups, "--with-objects", "--data", data).returncode == 0
    refused = backup("restore", backups, "--data", tmp_path / "new")
    assert (refused.returncode, "newer version of capture2vr (schema 9999_later" in refused.stderr) == (2, True)
    older = backup("restore", backups, "--at", backups_in(backups)[-1], "--data", tmp_path / "new")
    assert older.returncode == 0, older.stderr


def test_a_backup_in_a_newer_form_is_named(backups: Path, tmp_path: Path) -> None:
    manifest = newest(backups) / "backup.json"
    manifest.write_text(json.dumps({**json.loads(manifest.read_text()), "format": 99, "more": 1}))
    for command, place in (("verify", []), ("restore", ["--data", tmp_path / "new"])):
        refused = backup(command, backups, *place)
        assert (refused.returncode, "newer version of capture2vr: install that version" in refused.stderr) == (2, True)


def test_keys_are_read_by_their_passphrase_alone(backups: Path, data: Path, tmp_path: Path) -> None:
    secret = (tmp_path / "keys" / "signing").read_bytes()
    assert not any(secret in content for content in files(backups).values())
    assert all(path.stat().st_mode & 0o077 == 0 for path in backups.rglob("*") if path.name != "lock")
    wrong = backup(
        "restore",
        backups,
        "--keys",
        tmp_path / "k",
        "--data",
        tmp_path / "new",
        **{PASSPHRASE_VARIABLE: "another one."},
    )
    assert (wrong.returncode, "is not the passphrase" in wrong.stderr) == (2, True)
    assert not (tmp_path / "new" / "store" / "catalog").exists()
    none = backup("create", backups, "--keys", tmp_path / "keys", "--data", data, **{PASSPHRASE_VARIABLE: ""})
    assert (none.returncode, f"set {PASSPHRASE_VARIABLE}" in none.stderr) == (2, True)
    assert len(backups_in(backups)) == 1


def test_keys_come_back_where_nothing_else_is_yet(backups: Path, tmp_path: Path) -> None:
    """Neither the store's secret nor a data folder: in compose another user restores the keys, first of all."""
    nowhere = {"STORAGE_KIND": "s3", "STORAGE_SECRET_KEY_FILE": str(tmp_path / "none"), "STORAGE_ACCESS_KEY": "a"}
    place = ("--only", "keys", "--keys", tmp_path / "k" / "containers", "--data", tmp_path / "new")
    restored = backup("restore", backups, *place, **nowhere)
    assert restored.returncode == 0, restored.stderr
    assert (tmp_path / "k" / "containers" / "signing").read_bytes() == (tmp_path / "keys" / "signing").read_bytes()
    assert not (tmp_path / "new").exists()


def test_old_backups_go_with_what_only_they_have(backups: Path, data: Path) -> None:
    store = LocalStore(data / "store")
    for head in list(list_all(store, "")):
        store.delete(head.name)
    publish(bundle(content="b"), store, key="hat")
    assert backup("create", backups, "--with-objects", "--keep", 1, "--data", data).returncode == 0
    (name,) = backups_in(backups)
    lines = subprocess.run(["gzip", "-dc", newest(backups) / "objects.json.gz"], capture_output=True, check=True).stdout
    wanted = {json.loads(line)["sha256"] for line in lines.splitlines()}
    assert {path.name for path in (backups / "objects").rglob("*/*")} == wanted
    assert backup("verify", backups, "--at", name).returncode == 0


def _backups_of(backups: Path, *days_ago: float) -> list[str]:
    """Copies of the newest backup under the names of older ones."""
    now, made = datetime.now(UTC), []
    for each in days_ago:
        made.append(f"{now - timedelta(days=each):{NAME_TIME}}")
        shutil.copytree(newest(backups), backups / "backups" / made[-1])
    return made


@pytest.mark.parametrize(
    ("keep", "kept"),
    [
        (["--keep", 2], [0]),
        (["--keep-days", 30], [0, 1, 2]),
        (["--keep", 1, "--keep-days", 5], [0]),
        (["--keep", 4, "--keep-days", 5], [0, 1, 2]),
        (["--keep-days", 0.01], []),
    ],
    ids=str,
)
def test_old_backups_are_kept_by_number_and_by_age(backups: Path, keep: list[object], kept: list[int]) -> None:
    """The newest one stays, whatever is said."""
    own = backups_in(backups)
    older = _backups_of(backups, 1, 8, 29, 31, 400)
    done = backup("prune", backups, *keep)
    assert done.returncode == 0, done.stderr
    assert backups_in(backups) == [*own, *(older[each] for each in kept)]
    assert backup("verify", backups).returncode == 0, "what the newest one has is there"


def test_without_a_word_no_backup_is_removed(backups: Path) -> None:
    refused = backup("prune", backups)
    assert (refused.returncode, "say which backups stay" in refused.stderr) == (2, True)


def test_secrets_in_the_database_are_read_by_the_passphrase_alone(data: Path, tmp_path: Path) -> None:
    """The key of sessions, and webhooks': whoever has the backup could sign with them."""
    engine = open_engine(f"sqlite:///{data / 'gateway' / 'gateway.db'}")
    secret = AccessStore(engine).secret("session")
    made = WebhookStore(engine).create("default", "https://ada.example/hook", (), "", most=9)
    assert made is not None
    hook, signs = made
    engine.dispose()
    assert backup("create", tmp_path / "b", "--with-objects", "--data", data).returncode == 0
    with zipfile.ZipFile(newest(tmp_path / "b") / "database.zip") as archive:
        texts = [archive.read(name).decode() for name in archive.namelist()]
    assert not any(secret in text or signs in text for text in texts)
    for value, said in (("another one.", "is not the passphrase"), ("", f"set {PASSPHRASE_VARIABLE}")):
        refused = backup("restore", tmp_path / "b", "--data", tmp_path / "new", **{PASSPHRASE_VARIABLE: value})
        assert (refused.returncode, said in refused.stderr) == (2, True)
    assert not list(list_all(LocalStore(tmp_path / "new" / "store"), "")), "nothing was restored"
    assert backup("restore", tmp_path / "b", "--data", tmp_path / "new").returncode == 0
    engine = open_engine(f"sqlite:///{tmp_path / 'new' / 'gateway' / 'gateway.db'}")
    assert AccessStore(engine).secret("session") == secret
    with engine.connect() as db:
        assert db.execute(sa.select(webhooks.c.id, webhooks.c.secret)).all() == [(hook.id, signs)]
    engine.dispose()


@pytest.mark.parametrize("part", ["backup.json", "objects.json.gz"])
def test_a_damaged_backup_does_not_stop_the_next(backups: Path, data: Path, part: str) -> None:
    damaged = newest(backups)
    os.truncate(damaged / part, 100)
    done = backup("create", backups, "--with-objects", "--keep", 2, "--data", data)
    assert (done.returncode, f"{damaged.name} is damaged" in done.stderr) == (0, True), done.stderr
    assert newest(backups) != damaged
    assert backup("verify", backups).returncode == 0
    # The contents of the damaged one are not known, so nothing goes while it is one of those that are kept.
    for _ in range(2):
        done = backup("create", backups, "--with-objects", "--keep", 2, "--data", data)
        assert done.returncode == 0, done.stderr
    assert len(backups_in(backups)) == 2
    assert damaged.name not in backups_in(backups)


def test_a_damaged_content_is_copied_again(backups: Path, data: Path) -> None:
    """One that was cut off at once, another one once it is deleted."""
    cut_off, changed = sorted((backups / "objects").rglob("*/*"), key=lambda path: path.stat().st_size)[-2:]
    os.truncate(cut_off, 1)
    changed.write_bytes(bytes(changed.stat().st_size))
    assert backup("create", backups, "--with-objects", "--data", data).returncode == 0
    verified = backup("verify", backups)
    assert verified.returncode == 1
    assert (cut_off.name in verified.stderr, changed.name in verified.stderr) == (False, True)
    assert f"delete the damaged files in {backups / 'objects'}" in verified.stderr
    changed.unlink()
    assert backup("create", backups, "--with-objects", "--data", data).returncode == 0
    assert backup("verify", backups).returncode == 0


def test_a_key_that_is_a_link_is_in_the_backup(data: Path, tmp_path: Path) -> None:
    (tmp_path / "keys").mkdir()
    generate_key(tmp_path / "elsewhere")
    (tmp_path / "keys" / "signing").symlink_to(tmp_path / "elsewhere")
    (tmp_path / "keys" / "signing.pub").write_bytes((tmp_path / "elsewhere.pub").read_bytes())
    assert backup("create", tmp_path / "b", "--keys", tmp_path / "keys", "--data", data).returncode == 0
    restored = backup("restore", tmp_path / "b", "--only", "keys", "--keys", tmp_path / "new", "--data", tmp_path / "x")
    assert restored.returncode == 0, restored.stderr
    assert (tmp_path / "new" / "signing").read_bytes() == (tmp_path / "elsewhere").read_bytes()


def test_what_a_killed_backup_left_is_removed(backups: Path, data: Path) -> None:
    (backups / "backups" / ".part-20200101T000000.000000Z").mkdir()
    (backups / "objects" / ".part-1").write_bytes(b"half")
    assert backup("create", backups, "--with-objects", "--data", data).returncode == 0
    assert not list(backups.rglob(".part-*"))
    assert len(backups_in(backups)) == 2


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A disk of 256 kB."""
    folder = tmp_path / "disk"
    folder.mkdir()
    if subprocess.run(["mount", "-t", "tmpfs", "-o", "size=256k", "tmpfs", folder], capture_output=True).returncode:
        missing("the right to mount a small disk")
    try:
        yield folder
    finally:
        subprocess.run(["umount", folder], check=True)


def test_a_full_disk_is_said_in_a_sentence(data: Path, small_disk: Path) -> None:
    store = LocalStore(data / "store")
    store.put("captures/cap_1.zip", os.urandom(300_000), content_type="application/zip")
    full = backup("create", small_disk, "--with-objects", "--data", data)
    assert (full.returncode, f"{small_disk}: No space left on device" in full.stderr) == (2, True)
    assert "remove old backups with `capture2vr backup prune`" in full.stderr
    assert backups_in(small_disk) == []
    assert files(small_disk).keys() == {"lock"}, "the disk is as free as before"
    store.delete("captures/cap_1.zip")
    assert backup("create", small_disk, "--with-objects", "--data", data).returncode == 0


def times_in(data: Path) -> BackupTimes:
    """What the database of `up` knows of backups."""
    engine = open_engine(f"sqlite:///{data / 'gateway' / 'gateway.db'}")
    try:
        return BackupRecords(engine).times()
    finally:
        engine.dispose()


def test_the_database_knows_when_it_was_saved_and_when_that_was_proven(
    backups: Path, data: Path, tmp_path: Path
) -> None:
    began = time.time()
    made = times_in(data).made
    assert made is not None
    assert began - HANG_S < made <= began
    before = files(data)
    drilled = backup("drill", backups, "--data", data)
    assert drilled.returncode == 0, drilled.stderr
    assert "is whole, and was removed again" in drilled.stderr
    proven = times_in(data).proven
    assert proven is not None
    assert proven >= began
    left = files(data).keys() - before.keys()
    assert {Path(name).name for name in left} <= {"drill.lock", "gateway.db-wal", "gateway.db-shm"}
    assert backup("restore", backups, "--data", tmp_path / "new").returncode == 0
    assert times_in(tmp_path / "new").made == made, "the one that it was restored from is there"


def test_a_drill_finds_what_is_not_as_in_the_backup(backups: Path, data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A row that an import loses, and an object that the disk changes while it is written."""
    import capture2vr.cli.backups.drill as drill

    def import_less(url: str, *arguments: Any) -> Imported:
        done = import_database(url, *arguments)
        engine = open_engine(url)
        with engine.begin() as db:
            db.exec_driver_sql("DELETE FROM leases")
        engine.dispose()
        return done

    def restore_less(store: Store, *arguments: Any) -> int:
        count = restore_objects(store, *arguments)
        assert isinstance(store, LocalStore)
        path = store.path(next(head.name for head in list_all(store, "assets/")))
        path.write_bytes(bytes(path.stat().st_size))
        return count

    monkeypatch.setattr(drill, "import_database", import_less)
    monkeypatch.setattr(drill, "restore_objects", restore_less)
    found = backup("drill", backups, "--data", data)
    assert found.returncode == 1
    assert "not as in the backup: table leases: 0 of 1 rows" in found.stderr
    assert "not as in the backup: assets/" in found.stderr
    assert times_in(data).proven is None
    assert not (data / "gateway" / "drill").exists()


def test_a_drill_that_was_killed_is_cleaned_up_by_the_next(backups: Path, data: Path) -> None:
    (data / "gateway" / "drill" / "store").mkdir(parents=True)
    (data / "gateway" / "drill" / "gateway.db").write_bytes(b"half")
    assert backup("drill", backups, "--data", data).returncode == 0
    assert not (data / "gateway" / "drill").exists()


def test_a_drill_needs_room(backups: Path, data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=1_000_000))
    refused = backup("drill", backups, "--data", data)
    assert (refused.returncode, "1 MB are free, and the drill needs" in refused.stderr) == (2, True)


def test_what_cannot_be_done_is_said_in_a_sentence(data: Path, backups: Path, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    for name in ("empty", "none"):
        (tmp_path / name).mkdir()
    with (backups / "lock").open() as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        busy = backup("create", backups, "--data", data)
    for done, said in (
        (busy, "another backup is being written"),
        (backup("create", tmp_path / "file", "--data", data), "file"),
        (backup("create", tmp_path / "b", "--data", tmp_path / "empty"), "there is no database"),
        (
            backup("create", tmp_path / "b", "--data", tmp_path / "nothing"),
            "nothing does not exist: name the data folder",
        ),
        (backup("create", tmp_path / "b", "--keys", tmp_path / "nowhere", "--data", data), "there is no such folder"),
        (backup("verify", tmp_path / "none"), "has no backup"),
        (backup("restore", backups, "--at", "2020", "--data", tmp_path / "new"), "has no backup 2020; it has 2"),
        (backup("restore", backups, "--only", "keys", "--data", tmp_path / "new"), "needs --keys"),
    ):
        assert done.returncode == 2, done.stderr
        assert said in done.stderr
