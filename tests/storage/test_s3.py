"""What only a real S3 service can show: credentials, policies, foreign errors."""

from __future__ import annotations

import os
import subprocess
import sys
import uuid
from pathlib import Path

import httpx
import pytest
from botocore.stub import Stubber

from capture2vr.storage.bucket import main, read_policy
from capture2vr.storage.s3 import S3Store
from capture2vr.storage.settings import StorageSettings, open_store
from capture2vr.storage.store import Store
from tests.referees.s3.server import S3Server
from tests.storage.conftest import s3_store
from tests.support.lines import line_to
from tests.support.sites import gateway_at
from tests.support.tenants import bearer, make_key, publish_for

pytestmark = [pytest.mark.s3, pytest.mark.essential]
TEXT = "text/plain"


@pytest.fixture
def bucket() -> str:
    return f"test-{uuid.uuid4().hex[:12]}"


def test_anybody_reads_assets_and_collections_and_nothing_else(s3_server: S3Server, bucket: str) -> None:
    store = s3_store(s3_server, bucket)
    store.set_policy(read_policy(bucket))
    for name in ("assets/a/lod0.glb", "collections/c/index.json", "captures/c.zip", "catalog/a.json"):
        store.put(name, b"12345", content_type=TEXT)
    answer = httpx.get(store.url("assets/a/lod0.glb"), headers={"Range": "bytes=1-2"})
    assert (answer.status_code, answer.content) == (206, b"23")
    assert "immutable" in answer.headers["cache-control"]
    assert httpx.get(store.url("collections/c/index.json")).content == b"12345"
    home = f"{s3_server.endpoint}/{bucket}"
    for name in ("captures/c.zip", "catalog/a.json", ""):
        assert httpx.get(f"{home}/{name}").status_code == 403
    assert httpx.get(f"{home}/assets/a/absent").status_code in (403, 404)  # AWS says 403 to who may not list
    for name in ("assets/a/mine", "collections/c/index.json"):
        assert httpx.put(store.url(name), content=b"x").status_code == 403


def test_a_cdn_stands_before_the_names(s3_server: S3Server) -> None:
    store = S3Store(bucket="b-1", endpoint=s3_server.endpoint, base_url="https://cdn.example/")
    assert store.url("assets/a/b.glb") == "https://cdn.example/assets/a/b.glb"


def test_wrong_credentials_are_a_permission_error(s3_server: S3Server, bucket: str) -> None:
    s3_store(s3_server, bucket)
    stranger = S3Store(bucket=bucket, access_key="nobody", secret_key="wrong", endpoint=s3_server.endpoint)
    assert_every_call_raises(stranger, PermissionError)


def test_a_missing_bucket_is_an_os_error_and_not_a_missing_object(s3_server: S3Server) -> None:
    keys = {"access_key": s3_server.access_key, "secret_key": s3_server.secret_key}
    store = S3Store(bucket="no-such-bucket", endpoint=s3_server.endpoint, **keys)
    for call in (lambda: store.get("a"), lambda: store.list(""), lambda: store.put("a", b"1", content_type=TEXT)):
        with pytest.raises(OSError, match="bucket") as caught:
            call()
        assert not isinstance(caught.value, FileNotFoundError)


def test_nobody_there_is_an_os_error() -> None:
    store = S3Store(bucket="bucket", access_key="a", secret_key="b", endpoint="http://127.0.0.1:9")
    with pytest.raises(OSError, match="cannot be reached") as caught:
        store.get("a")
    assert caught.value.__suppress_context__


def assert_every_call_raises(store: Store, error: type[Exception]) -> None:
    for call in (
        lambda: store.get("a"),
        lambda: store.head("a"),
        lambda: store.list(""),
        lambda: store.put("a", b"1", content_type=TEXT),
    ):
        with pytest.raises(error):
            call()


def test_creating_a_bucket_twice_is_no_error(s3_server: S3Server, bucket: str) -> None:
    s3_store(s3_server, bucket).create_bucket()


@pytest.mark.parametrize(
    ("endpoint", "region", "place"),
    [
        ("", "eu-central-1", {"LocationConstraint": "eu-central-1"}),
        ("https://s3.eu-central-1.amazonaws.com", "eu-central-1", {"LocationConstraint": "eu-central-1"}),
        ("", "us-east-1", None),
        ("https://s3.example", "eu-central-1", None),
    ],
)
def test_a_bucket_of_aws_is_made_in_its_region(endpoint: str, region: str, place: dict[str, str] | None) -> None:
    """AWS refuses a request without the region, but for us-east-1, where it refuses one with it."""
    store = S3Store(bucket="things", access_key="a", secret_key="b", endpoint=endpoint, region=region)
    asked = {"Bucket": "things"} | ({"CreateBucketConfiguration": place} if place else {})
    with Stubber(store._client) as aws:
        aws.add_client_error("head_bucket", http_status_code=404)
        aws.add_response("create_bucket", {}, asked)
        store.create_bucket()
        aws.assert_no_pending_responses()


def test_a_wrong_clock_is_not_taken_for_a_wrong_key() -> None:
    store = S3Store(bucket="things", access_key="a", secret_key="b", endpoint="https://s3.example")
    with Stubber(store._client) as service:
        service.add_client_error("get_object", "RequestTimeTooSkewed", http_status_code=403)
        with pytest.raises(PermissionError, match="this machine's clock is wrong"):
            store.get("a")


def test_a_store_that_starts_later_is_waited_for(s3_server: S3Server, bucket: str) -> None:
    """Nobody listens at first; the line is mended once the program says that it waits."""
    line = line_to(s3_server.endpoint)
    line.cut()
    settings = {"KIND": "s3", "ENDPOINT": line.url, "BUCKET": bucket}
    settings |= {"ACCESS_KEY": s3_server.access_key, "SECRET_KEY": s3_server.secret_key}
    environment = {**os.environ, **{f"STORAGE_{name}": value for name, value in settings.items()}}
    command = [sys.executable, "-m", "capture2vr.storage.bucket"]
    with subprocess.Popen(command, env=environment, stderr=subprocess.PIPE, text=True) as program:
        assert program.stderr is not None
        assert "waiting for the store" in program.stderr.readline()
        line.mend()
        assert "is ready" in program.stderr.read()
    line.cut()
    assert program.returncode == 0


def test_wrong_credentials_are_told_at_once(s3_server: S3Server, bucket: str, monkeypatch: pytest.MonkeyPatch) -> None:
    s3_store(s3_server, bucket)
    settings = {"KIND": "s3", "ENDPOINT": s3_server.endpoint, "BUCKET": bucket}
    for name, value in (settings | {"ACCESS_KEY": "nobody", "SECRET_KEY": "wrong"}).items():
        monkeypatch.setenv(f"STORAGE_{name}", value)
    monkeypatch.setattr("capture2vr.storage.bucket.time.sleep", pytest.fail)
    with pytest.raises(SystemExit, match="STORAGE_ACCESS_KEY"):
        main()


def test_a_private_bucket_is_read_by_presigned_urls_alone(
    s3_server: S3Server, bucket: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    settings = {"KIND": "s3", "ENDPOINT": s3_server.endpoint, "BUCKET": bucket, "PRESIGN_S": "60"}
    settings |= {"ACCESS_KEY": s3_server.access_key, "SECRET_KEY": s3_server.secret_key}
    for name, value in settings.items():
        monkeypatch.setenv(f"STORAGE_{name}", value)
    s3_store(s3_server, bucket).set_policy(read_policy(bucket))
    for _ in range(2):
        main()
    store = open_store(StorageSettings())
    assert isinstance(store, S3Store)
    publish_for(store, "ada", "dress")
    key = bearer(make_key(tmp_path / "data", "ada"))
    with gateway_at(tmp_path, store) as url:
        file = httpx.get(f"{url}/v1/assets/dress", headers=key).json()["files"][0]["url"]
        name = file.removeprefix(f"{url}/v1/files/")
        assert name.startswith("tenants/ada/assets/dress/")
        assert httpx.get(f"{s3_server.endpoint}/{bucket}/{name}").status_code == 403
        assert httpx.get(file, follow_redirects=True).status_code == 401
        answer = httpx.get(file, headers={**key, "Origin": "https://vr.example"}, follow_redirects=True)
        assert (answer.status_code, answer.content) == (200, store.get(name))
        assert answer.headers["Cache-Control"] == "private, max-age=60"
        assert answer.headers["Access-Control-Allow-Origin"] in ("*", "https://vr.example")
        assert answer.url.host == httpx.URL(s3_server.endpoint).host
        head = httpx.head(file, headers=key)
        assert (head.status_code, head.headers["Content-Length"]) == (200, str(len(answer.content)))
        assert head.headers["ETag"] == answer.headers["ETag"]
        assert httpx.head(f"{file}x", headers=key).status_code == 404
        policy = httpx.get(f"{url}/view/dress").headers["Content-Security-Policy"]
        assert s3_server.endpoint in policy
