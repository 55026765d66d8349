"""The edge cache of deploy/nginx.conf in front of a real S3 server, whose bucket capture2vr.storage.bucket made."""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import httpx
import pytest

from capture2vr.cli.up import free_port
from capture2vr.gateway.access.caller import ALL_SCOPES, Scope
from capture2vr.storage.catalogue.entry import read_entry
from capture2vr.storage.catalogue.visibility import Visibility
from capture2vr.storage.s3 import S3Store
from capture2vr.storage.store import NO_CACHE
from capture2vr.storage.tenant_store import store_of_tenant
from tests.conftest import missing
from tests.referees.s3.server import S3Server
from tests.support.patience import PATIENCE_S
from tests.support.repository import ROOT
from tests.support.sites import gateway_at
from tests.support.tenants import bearer, make_key, publish_for

pytestmark = pytest.mark.s3

CONF = ROOT / "deploy" / "nginx.conf"
BUCKET = "capture2vr"  # the name that the configuration knows
CONTENT = os.urandom(3 << 20)  # three slices
ROWS = b'{"rows":[' + b'["thing"],' * 400 + b'["thing"]]}'
SHARD = f"collections/default/shard.{hashlib.sha256(ROWS).hexdigest()}.json"
NAME = f"assets/thing/lod0.{hashlib.sha256(CONTENT).hexdigest()}.glb"


@pytest.fixture(scope="module")
def bucket(s3_server: S3Server) -> S3Store:
    """The bucket as `python -m capture2vr.storage.bucket` leaves it, run twice, with an asset and a capture in it."""
    environment = {
        **os.environ,
        "STORAGE_KIND": "s3",
        "STORAGE_ENDPOINT": s3_server.endpoint,
        "STORAGE_BUCKET": BUCKET,
        "STORAGE_ACCESS_KEY": s3_server.access_key,
        "STORAGE_SECRET_KEY": s3_server.secret_key,
    }
    for _ in range(2):
        subprocess.run([sys.executable, "-m", "capture2vr.storage.bucket"], env=environment, check=True)
    store = S3Store(
        bucket=BUCKET,
        access_key=s3_server.access_key,
        secret_key=s3_server.secret_key,
        endpoint=s3_server.endpoint,
    )
    store.put(NAME, CONTENT, content_type="model/gltf-binary")
    store.put("captures/private.zip", b"private", content_type="application/zip")
    store.put(SHARD, ROWS, content_type="application/json")
    return store


def find_nginx() -> str:
    """Path of nginx, which is installed where it is missing and this process may."""
    if shutil.which("nginx") is None and os.geteuid() == 0:
        install = ["apt-get", "install", "-y", "-qq", "--no-install-recommends", "nginx-core"]
        subprocess.run(install, env={**os.environ, "DEBIAN_FRONTEND": "noninteractive"}, capture_output=True)
    found = shutil.which("nginx")
    if found is None:
        missing("nginx")
    return str(found)


@pytest.fixture(scope="module")
def cdn(bucket: S3Store, s3_server: S3Server, tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The edge cache of a gateway that asks for no keys."""
    with gateway_at(tmp_path_factory.mktemp("open"), bucket) as gateway, edge_cache(s3_server, gateway) as url:
        yield url


@contextmanager
def edge_cache(s3_server: S3Server, gateway: str) -> Iterator[str]:
    """nginx with the deployed configuration; only addresses and folders are this machine's."""
    # Not pytest's folder, which every other pytest that starts closes to nginx's workers, another user.
    with tempfile.TemporaryDirectory() as name:
        folder, port = Path(name), free_port()
        folder.chmod(0o777)
        (folder / "nginx.conf").write_text(_configuration(s3_server, gateway, folder, port))
        child = subprocess.Popen([find_nginx(), "-c", folder / "nginx.conf", "-g", "daemon off;"])
        try:
            wait_for(f"http://127.0.0.1:{port}/healthz")
            yield f"http://127.0.0.1:{port}"
        finally:
            child.terminate()
            child.wait(10)


def _configuration(s3_server: S3Server, gateway: str, folder: Path, port: int) -> str:
    conf = CONF.read_text()
    for deployed, here in [
        ("pid /tmp/nginx.pid", f"pid {folder}/nginx.pid"),
        ("/var/cache/nginx", str(folder)),
        ("/dev/stdout", f"{folder}/access.log"),
        ("/dev/stderr", f"{folder}/error.log"),
        ("http://store:9000", s3_server.endpoint),
        ("http://gateway:8080", gateway),
        ("Host store:9000", f"Host {s3_server.endpoint.removeprefix('http://')}"),
        ("listen 8080", f"listen 127.0.0.1:{port}"),
    ]:
        assert deployed in conf
        conf = conf.replace(deployed, here)
    return conf


def wait_for(url: str) -> None:
    """Wait until a URL is answered well."""
    for _ in range(100):
        try:
            if httpx.get(url).is_success:
                return
        except httpx.TransportError:
            time.sleep(0.1)
    raise AssertionError(f"{url} does not answer")


def test_an_asset_is_whole_then_cached_and_immutable(cdn: str) -> None:
    first = httpx.get(f"{cdn}/{NAME}")
    assert first.status_code == 200
    assert first.content == CONTENT
    assert "immutable" in first.headers["Cache-Control"]
    assert first.headers["Access-Control-Allow-Origin"] == "*"
    second = httpx.get(f"{cdn}/{NAME}")
    assert second.content == CONTENT
    assert second.headers["X-Cache"] == "HIT"


def test_a_range_comes_from_the_cache(cdn: str) -> None:
    httpx.get(f"{cdn}/{NAME}")
    part = httpx.get(f"{cdn}/{NAME}", headers={"Range": "bytes=1500000-1500099"})
    assert part.status_code == 206
    assert part.content == CONTENT[1500000:1500100]
    assert part.headers["X-Cache"] == "HIT"


def test_a_shard_is_cached_and_may_come_packed(cdn: str) -> None:
    for cache in ("MISS", "HIT"):
        answer = httpx.get(f"{cdn}/{SHARD}")
        assert (answer.status_code, answer.content, answer.headers["X-Cache"]) == (200, ROWS, cache)
        assert answer.headers["Access-Control-Allow-Origin"] == "*"
        assert answer.headers["Content-Encoding"] == "gzip"
    assert httpx.get(f"{cdn}/{SHARD}", headers={"Accept-Encoding": "identity"}).content == ROWS


def test_an_index_is_never_old(cdn: str, bucket: S3Store) -> None:
    name = "collections/default/index.json"
    for content in (b"1", b"2"):
        put = bucket.put(name, content, content_type="application/json", cache_control=NO_CACHE)
        answer = httpx.get(f"{cdn}/{name}")
        assert (answer.status_code, answer.content, answer.headers["Cache-Control"]) == (200, content, NO_CACHE)
    known = {"If-None-Match": f'"{put.etag}"'}
    assert httpx.get(f"{cdn}/{name}", headers=known).status_code == 304


ABSENT = ["assets/thing/absent.glb", "collections/none/index.json", "collections/default/shard.0.json"]
OUT_OF_ASSETS = [
    "assets/../captures/private.zip",
    "assets/%2e%2e/captures/private.zip",
    "collections/../captures/private.zip",
]


@pytest.mark.parametrize("path", [*ABSENT, *OUT_OF_ASSETS])
def test_what_is_absent_or_private_is_not_served(cdn: str, path: str) -> None:
    url = httpx.URL(f"{cdn}/").copy_with(raw_path=f"/{path}".encode())
    with httpx.Client() as client:
        answer = client.send(httpx.Request("GET", url))
    assert answer.status_code == 404
    assert b"private" not in answer.content


def test_nobody_reads_captures_or_lists_the_bucket(bucket: S3Store, s3_server: S3Server) -> None:
    home = f"{s3_server.endpoint}/{BUCKET}"
    assert httpx.get(f"{home}/{NAME}").status_code == 200
    assert httpx.get(f"{home}/{SHARD}").status_code == 200
    assert httpx.get(f"{home}/captures/private.zip").status_code == 403
    assert httpx.get(f"{home}?list-type=2").status_code == 403
    assert httpx.put(f"{home}/assets/thing/mine.glb", content=b"x").status_code == 403


@dataclass(frozen=True, slots=True)
class Guarded:
    """The edge cache of a gateway that asks for keys; ada's and bob's keys, and the URL of a file of ada's dress."""

    url: str
    ada: dict[str, str]
    bob: dict[str, str]
    file: str

    def status(self, **headers: str) -> int:
        return httpx.get(self.file, headers=headers).status_code

    def make(self, visibility: Visibility | None) -> None:
        body = {"visibility": visibility}
        httpx.put(f"{self.url}/v1/assets/dress/visibility", json=body, headers=self.ada).raise_for_status()

    def await_status(self, status: int, within_s: float, **headers: str) -> None:
        """Wait until the file is answered so, no longer than was promised and than a busy machine takes."""
        deadline = time.monotonic() + within_s + PATIENCE_S
        while self.status(**headers) != status:
            assert time.monotonic() < deadline
            time.sleep(0.2)


@pytest.fixture(scope="module")
def guarded(bucket: S3Store, s3_server: S3Server, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Guarded]:
    """Ada has a dress."""
    folder = tmp_path_factory.mktemp("guarded")
    owner = ALL_SCOPES - {Scope.OPERATE}
    ada, bob = (bearer(make_key(folder / "data", tenant, owner)) for tenant in ("ada", "bob"))
    publish_for(bucket, "ada", "dress")
    file = read_entry(store_of_tenant(bucket, "ada"), "dress").document["files"][0]["name"]
    with gateway_at(folder, bucket) as gateway, edge_cache(s3_server, gateway) as url:
        yield Guarded(url, ada, bob, f"{url}/tenants/ada/{file}")


def test_a_private_file_is_its_tenants_also_from_the_cache(guarded: Guarded) -> None:
    for cache in ("MISS", "HIT"):
        answer = httpx.get(guarded.file, headers=guarded.ada)
        assert (answer.status_code, answer.headers["X-Cache"]) == (200, cache)
        assert answer.headers["Cache-Control"] == "private, no-cache"
        assert "Access-Control-Allow-Origin" not in answer.headers
        assert answer.headers["Cross-Origin-Resource-Policy"] == "same-origin"
    nobody, another = httpx.get(guarded.file), httpx.get(guarded.file, headers=guarded.bob)
    assert (nobody.status_code, nobody.json()["code"]) == (401, "KEY_MISSING")
    assert (another.status_code, another.json()["code"]) == (404, "FILE_UNKNOWN")
    index = f"{guarded.url}/tenants/ada/collections/default/index.json"
    assert [httpx.get(index, headers=headers).status_code for headers in (guarded.ada, guarded.bob, {})] == [
        200,
        404,
        401,
    ]


def test_what_is_opened_and_closed_follows_within_a_minute(guarded: Guarded) -> None:
    guarded.make(Visibility.PUBLIC)
    guarded.await_status(200, 5)
    answer = httpx.get(guarded.file)
    assert answer.headers["Access-Control-Allow-Origin"] == "*"
    assert "immutable" in answer.headers["Cache-Control"]
    began = time.monotonic()
    guarded.make(None)
    guarded.await_status(401, 20)
    assert "proxy_cache_valid 204 20s;" in CONF.read_text()
    assert time.monotonic() - began < 20 + PATIENCE_S


def test_a_revoked_share_is_refused_within_a_minute(guarded: Guarded) -> None:
    made = httpx.post(f"{guarded.url}/v1/shares", json={"asset": "dress"}, headers=guarded.ada).json()
    show = {"Authorization": f"Share {made['url'].rpartition('/')[2]}"}
    assert guarded.status(**show) == 200
    httpx.delete(f"{guarded.url}/v1/shares/{made['id']}", headers=guarded.ada).raise_for_status()
    guarded.await_status(401, 20, **show)
    assert guarded.status(**guarded.ada) == 200
