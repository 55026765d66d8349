"""`capture2vr deploy init`: real workers and gateways take what it writes, and nothing is overwritten."""

from __future__ import annotations

import os
import re
import shutil
import ssl
import stat
import subprocess
import sys
import time
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path

import httpx
import pytest
from cryptography import x509

from capture2vr.cli.deployment import tls_authority
from capture2vr.cli.deployment.deploy_work import WORKER_NAMES
from capture2vr.cli.deployment.key_folder import KeyFolder
from capture2vr.cli.up import free_port
from capture2vr.storage.catalogue.publish import PublishPolicy, publish
from capture2vr.storage.catalogue.verify import fetch_from, verify
from capture2vr.storage.memory import MemoryStore
from capture2vr.storage.settings import StorageSettings, open_keys
from tests.support.bundles import bundle
from tests.support.patience import HANG_S, PATIENCE_S
from tests.support.repository import ROOT
from tests.support.service_processes import ServiceProcess, killed_at_the_end

Ended = subprocess.CompletedProcess[str]
Init = Callable[..., Ended]

SECRETS = ("STORAGE_ACCESS_KEY", "STORAGE_SECRET_KEY", "EDGE_TOKEN", "POSTGRES_PASSWORD")


@pytest.fixture
def deployment(tmp_path: Path) -> Path:
    """A folder with the compose file, as a release unpacked has it."""
    shutil.copy(ROOT / "docker-compose.yml", tmp_path)
    return tmp_path


@pytest.fixture
def init(deployment: Path) -> Init:
    """The command, in a process, which must end well unless `status` says otherwise."""

    def call(*arguments: str, status: int = 0) -> Ended:
        command = [sys.executable, "-m", "capture2vr.cli", "deploy", "init", "--out", str(deployment), *arguments]
        ended = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=HANG_S)
        assert ended.returncode == status, ended.stderr
        return ended

    return call


@pytest.mark.slow
@pytest.mark.parametrize("name", ["shop [final]", "a[/b]"])
def test_a_folder_is_named_as_it_is(deployment: Path, init: Init, name: str) -> None:
    """What stands in brackets is markup to the library that prints."""
    folder = deployment / name
    folder.mkdir(parents=True)
    shutil.copy(ROOT / "docker-compose.yml", folder)
    assert f"{folder}/.env: new random secrets" in init("--out", str(folder)).stderr


def variables(deployment: Path) -> dict[str, str]:
    """The variables of .env."""
    lines = (deployment / ".env").read_text().splitlines()
    return dict(line.split("=", 1) for line in lines if not line.startswith("#"))


def here(deployment: Path) -> dict[str, str]:
    """The variables of .env as a container has them, with the mounted folder in the place of /keys."""
    mounted = str(KeyFolder(deployment / "keys").mounted)
    return {
        name: value.replace("/keys", mounted, 1) if value.startswith("/keys/") else value
        for name, value in variables(deployment).items()
    }


def contents(deployment: Path) -> dict[Path, bytes]:
    return {path: path.read_bytes() for path in deployment.rglob("*") if path.is_file()}


@pytest.mark.slow
def test_secrets_are_random_and_only_the_owner_reads_them(init: Init, deployment: Path) -> None:
    ended = init()
    given = variables(deployment)
    assert len({given[name] for name in SECRETS}) == len(SECRETS)
    assert all(re.fullmatch("[0-9a-f]{20,}", given[name]) for name in SECRETS)
    assert not any(given[name] in ended.stderr + ended.stdout for name in SECRETS)
    keys = KeyFolder(deployment / "keys")
    for path in (deployment / ".env", keys.authority_key, keys.signing_key, keys.certificate_key):
        assert stat.S_IMODE(path.stat().st_mode) == 0o600, path
    for folder in (keys.root, keys.mounted):
        assert stat.S_IMODE(folder.stat().st_mode) == 0o700, folder
    assert "docker compose up --build --wait" in ended.stderr


@pytest.mark.slow
def test_the_authoritys_key_is_not_in_the_folder_that_containers_see(init: Init, deployment: Path) -> None:
    init()
    given, keys = variables(deployment), KeyFolder(deployment / "keys")
    assert (deployment / given["KEYS"]).samefile(keys.mounted)
    assert keys.authority_key.parent.samefile(keys.mounted.parent)
    named = [given[name] for name in ("STORAGE_SIGNING_KEY", "EDGE_TLS_CERT", "EDGE_TLS_KEY", "GATEWAY_EDGE_CA")]
    assert all((keys.mounted / name.removeprefix("/keys/")).is_file() for name in named)


@pytest.mark.skipif(os.geteuid() != 0, reason="only root gives files to another user")
def test_keys_belong_to_the_containers_user_and_secrets_to_whose_folder_it_is(init: Init, deployment: Path) -> None:
    dockerfiles = [path.read_text() for path in (ROOT / "deploy").glob("*.Dockerfile")]
    (user,) = {found for text in dockerfiles for found in re.findall(r"^USER (\d+)$", text, re.MULTILINE)}
    os.chown(deployment, 1000, 1000)
    init()
    mounted = KeyFolder(deployment / "keys").mounted
    assert {path.stat().st_uid for path in (mounted, *mounted.iterdir())} == {int(user)}
    assert {(deployment / name).stat().st_uid for name in (".env", "keys", "keys/ca.key")} == {1000}


@pytest.mark.slow
def test_a_second_run_changes_nothing(init: Init, deployment: Path) -> None:
    init()
    before = contents(deployment)
    assert ".env exists and stays as it is" in init().stderr
    assert contents(deployment) == before


@pytest.mark.slow
def test_another_address_is_refused_where_there_is_an_env(init: Init, deployment: Path) -> None:
    init()
    before = contents(deployment)
    assert "use --force" in init("--port", "9090", status=2).stderr
    assert contents(deployment) == before


@pytest.mark.slow
def test_force_makes_new_secrets_keeps_keys_and_says_what_follows(init: Init, deployment: Path) -> None:
    init()
    old, keys = variables(deployment), contents(deployment / "keys")
    with (deployment / ".env").open("a") as file:
        file.write("EDGE_SLOTS=3\n")
    ended = init("--force", "--bind", "0.0.0.0", "--public-url", "https://capture.example/")
    new = variables(deployment)
    assert all(new[name] != old[name] for name in SECRETS)
    assert (new["BIND"], new["PUBLIC_URL"], new["EDGE_SLOTS"]) == ("0.0.0.0", "https://capture.example", "3")
    assert old["STORAGE_SECRET_KEY"] in (deployment / ".env.old").read_text()
    assert stat.S_IMODE((deployment / ".env.old").stat().st_mode) == 0o600
    assert contents(deployment / "keys") == keys
    assert all(name in ended.stderr for name in SECRETS)
    assert "keys create --scope operate" in ended.stderr


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--bind", "0.0.0.0"), "--public-url"),
        (("--bind", "somewhere"), "IP address"),
        (("--public-url", "capture.example"), "--public-url"),
        (("--public-url", "https://capture.example/$HOME"), "--public-url"),
        (("--public-url", "https://ada:x@capture.example"), "leave out user"),
        (("--public-url", "https://a.example\nOPEN=1"), "--public-url"),
        (("--public-url", "https://[a.example"), "--public-url: this is no URL"),
        (("--public-url", "https://a.example:99999999"), "--public-url: this is no URL"),
    ],
)
def test_a_wrong_address_is_named_and_nothing_is_written(
    init: Init, deployment: Path, arguments: tuple[str, ...], said: str
) -> None:
    assert said in init(*arguments, status=2).stderr
    assert [path.name for path in deployment.iterdir()] == ["docker-compose.yml"]


def test_a_folder_without_a_compose_file_is_refused(init: Init, deployment: Path) -> None:
    (deployment / "docker-compose.yml").unlink()
    assert "has no docker-compose.yml" in init(status=2).stderr
    assert list(deployment.iterdir()) == []


@pytest.mark.slow
def test_a_certificate_that_ends_soon_is_renewed_by_the_same_authority(
    init: Init, deployment: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    init()
    keys = KeyFolder(deployment / "keys")
    authority = keys.authority.read_bytes()
    monkeypatch.setattr(tls_authority, "SERVER_DAYS", tls_authority.RENEW_DAYS - 1)
    tls_authority.make_server_certificate(
        keys.certificate, keys.certificate_key, WORKER_NAMES, authority=keys.authority, authority_key=keys.authority_key
    )
    assert "new certificate for edge" in init().stderr
    renewed = x509.load_pem_x509_certificate(keys.certificate.read_bytes())
    assert renewed.not_valid_after_utc > datetime.now(UTC) + timedelta(days=tls_authority.RENEW_DAYS)
    assert keys.authority.read_bytes() == authority


@pytest.mark.slow
def test_a_lost_key_of_the_authority_is_a_sentence(init: Init, deployment: Path) -> None:
    init()
    keys = KeyFolder(deployment / "keys")
    keys.authority_key.unlink()
    init()
    keys.certificate.unlink()
    assert f"{keys.authority_key} are not a certificate authority and its key" in init(status=2).stderr


def test_the_certificate_is_for_the_services_of_the_compose_file_and_strict_clients_take_it(
    init: Init, deployment: Path
) -> None:
    init()
    keys, text = KeyFolder(deployment / "keys"), (ROOT / "docker-compose.yml").read_text()
    found = x509.load_pem_x509_certificate(keys.certificate.read_bytes())
    names = found.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    assert set(names.get_values_for_type(x509.DNSName)) == {
        *re.findall(r"^  (edge\S*):$", text, re.MULTILINE),
        "localhost",
    }
    server, client = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER), ssl.create_default_context(cafile=keys.authority)
    server.load_cert_chain(keys.certificate, keys.certificate_key)
    client.verify_flags |= ssl.VerifyFlags.VERIFY_X509_STRICT
    for name in names.get_values_for_type(x509.DNSName):
        _shake_hands(client, server, name)


def _shake_hands(client: ssl.SSLContext, server: ssl.SSLContext, name: str) -> None:
    """A TLS handshake in memory. Raises ssl.SSLCertVerificationError."""
    to_server, to_client = ssl.MemoryBIO(), ssl.MemoryBIO()
    sides = [
        client.wrap_bio(to_client, to_server, server_hostname=name),
        server.wrap_bio(to_server, to_client, server_side=True),
    ]
    for side in sides * 3:
        try:
            side.do_handshake()
        except ssl.SSLWantReadError:
            continue


def test_what_is_published_with_the_signing_key_verifies_with_its_public_key(
    init: Init, deployment: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    init()
    monkeypatch.setenv("STORAGE_SIGNING_KEY", here(deployment)["STORAGE_SIGNING_KEY"])
    store, signing = MemoryStore(), open_keys(StorageSettings())
    publish(bundle(), store, key="dress", policy=PublishPolicy(signing))
    monkeypatch.delenv("STORAGE_SIGNING_KEY")
    monkeypatch.setenv("STORAGE_TRUSTED_KEYS", f"{KeyFolder(deployment / 'keys').signing_key}.pub")
    trusted = open_keys(StorageSettings()).verification_keys
    assert trusted == signing.verification_keys != ()
    assert all(result.faults == () for result in verify(fetch_from(store), "default", trusted, at_least=1))


@pytest.mark.slow
def test_a_gateway_and_a_worker_know_each_other_by_what_is_written(init: Init, deployment: Path) -> None:
    """Both as processes. A gateway with another token finds no worker."""
    init()
    given, port = here(deployment), free_port()
    shared = {"STORAGE_ROOT": deployment / "objects", "STORAGE_SIGNING_KEY": given["STORAGE_SIGNING_KEY"]}
    worker = ServiceProcess(
        "capture2vr.edge",
        deployment / "edge.log",
        EDGE_PORT=port,
        EDGE_SCRATCH=deployment / "scratch",
        **{name: given[name] for name in ("EDGE_TLS_CERT", "EDGE_TLS_KEY", "EDGE_TOKEN")},
        **shared,
    )
    with killed_at_the_end(worker):
        assert _workers_are_ready(deployment, port, given["GATEWAY_EDGE_CA"], given["EDGE_TOKEN"], shared)
        assert not _workers_are_ready(deployment, port, given["GATEWAY_EDGE_CA"], "f" * 64, shared)


def _workers_are_ready(deployment: Path, worker: int, ca: str, token: str, shared: dict[str, object]) -> bool:
    """Whether a gateway with this CA and token finds the worker; it refuses the token, or waits for the start."""
    port, log = free_port(), deployment / f"gateway-{token[:4]}.log"
    gateway = ServiceProcess(
        "capture2vr.gateway",
        log,
        GATEWAY_PORT=port,
        GATEWAY_DATA_DIR=deployment / f"data-{token[:4]}",
        GATEWAY_WORKERS=f"localhost:{worker}",
        GATEWAY_EDGE_CA=ca,
        GATEWAY_EDGE_TOKEN=token,
        **shared,
    )
    deadline = time.monotonic() + PATIENCE_S
    with killed_at_the_end(gateway):
        while "TOKEN_WRONG" not in log.read_text():
            assert time.monotonic() < deadline, log.read_text()
            try:
                if httpx.get(f"http://127.0.0.1:{port}/readyz").json()["checks"]["workers"]["ok"]:
                    return True
            except httpx.TransportError:
                time.sleep(0.1)
    return False
