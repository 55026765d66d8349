"""`capture2vr deploy init --kubernetes`: the chart finds every secret that it names, and nothing is overwritten."""

from __future__ import annotations

import json
import stat
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from cryptography import x509
from pydantic import SecretStr

from capture2vr.cli.deployment import tls_authority
from capture2vr.cli.deployment.deploy_work import Address
from capture2vr.cli.deployment.key_folder import KeyFolder
from capture2vr.cli.deployment.kubernetes_work import WEB_TLS, Cluster, initialise_cluster
from capture2vr.errors import BadInput
from capture2vr.gateway.server import refuse_without_keys
from capture2vr.gateway.settings import GatewaySettings
from tests.support.chart import Manifest, containers, inner, of_kind, plain_variables, pods, render
from tests.support.patience import HANG_S
from tests.support.repository import ROOT

PLAIN = Cluster("vr", ("cpu", "gpu"))
WEB = Address(public_url="https://vr.example")
S3 = {
    "STORAGE_ENDPOINT": "https://s3.example",
    "STORAGE_BUCKET": "vr-assets",
    "STORAGE_ACCESS_KEY": "ours",
    "STORAGE_SECRET_KEY": "hush",
}
POSTGRES = {"GATEWAY_DATABASE_URL": "postgresql://vr:hush@postgres.example/vr"}


@pytest.fixture(autouse=True)
def nothing_is_elsewhere(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in (*S3, *POSTGRES, "STORAGE_REGION", "STORAGE_PUBLIC_ENDPOINT"):
        monkeypatch.delenv(name, raising=False)


def write(folder: Path, address: Address = WEB, cluster: Cluster = PLAIN, *, force: bool = False) -> list[Manifest]:
    """Write the folder, and render the chart with the values in it."""
    initialise_cluster(folder, address, cluster, force=force)
    values = yaml.safe_load((folder / "values.yaml").read_text())
    return render(values, release=cluster.release)


def secrets_of(folder: Path) -> dict[str, dict[str, str]]:
    listed = json.loads((folder / "secrets.json").read_text())["items"]
    return {each["metadata"]["name"]: each["stringData"] for each in listed}


def named_secrets(manifests: list[Manifest]) -> Iterator[tuple[str, str]]:
    """Yield every secret's key that a pod asks for, as a variable or as a file."""
    for container in containers(manifests):
        for variable in container["env"]:
            if reference := variable.get("valueFrom", {}).get("secretKeyRef"):
                yield reference["name"], reference["key"]
    for each in pods(manifests):
        for volume in inner(each, "spec", "template", "spec").get("volumes", ()):
            for item in volume.get("secret", {}).get("items", ()):
                yield volume["secret"]["secretName"], item["key"]


@pytest.mark.parametrize("variables", [{}, S3, {**S3, **POSTGRES}], ids=["own store", "S3", "S3 and Postgres"])
@pytest.mark.parametrize("address", [Address(), WEB], ids=["local", "web"])
def test_every_secret_that_the_chart_names_is_written(
    tmp_path: Path, variables: dict[str, str], address: Address, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    manifests = write(tmp_path / "kubernetes", address)
    written = secrets_of(tmp_path / "kubernetes")
    wanted = set(named_secrets(manifests))
    assert wanted <= {(name, key) for name, content in written.items() for key in content}
    assert {name for name, _ in wanted} == set(written), "none is written for nothing"
    assert ("capture2vr-postgres" in written) == bool(POSTGRES.items() <= variables.items())
    own = [each for each in of_kind(manifests, "Deployment") if each["metadata"]["name"].endswith("-store")]
    assert bool(own) == (not variables)


@pytest.mark.parametrize("release", ["vr", "a" * 28, "a" * 29, "a" * 28 + "-b", "a" * 39 + "-b", "a" * 53])
def test_the_certificate_is_for_the_pools_services_however_long_the_release_is_called(
    tmp_path: Path, release: str
) -> None:
    manifests = write(tmp_path, cluster=Cluster(release, ("cpu",)))
    headless = {
        each["metadata"]["name"] for each in of_kind(manifests, "Service") if each["spec"].get("clusterIP") == "None"
    }
    assert len(headless) == 1
    certificate = x509.load_pem_x509_certificate(secrets_of(tmp_path)["capture2vr-workers"]["tls.crt"].encode())
    names = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    assert headless <= set(names.get_values_for_type(x509.DNSName))


def test_a_gateway_takes_the_operators_key(tmp_path: Path) -> None:
    write(tmp_path / "kubernetes")
    key = SecretStr(secrets_of(tmp_path / "kubernetes")["capture2vr-operator"]["key"])
    refuse_without_keys(GatewaySettings(data_dir=tmp_path, host="0.0.0.0", operator_key=key))


def test_secrets_are_random_and_only_the_owner_reads_them(tmp_path: Path) -> None:
    write(tmp_path / "a")
    write(tmp_path / "b")
    first, second = secrets_of(tmp_path / "a"), secrets_of(tmp_path / "b")
    for name, content in first.items():
        for key, value in content.items():
            assert value != second[name][key], (name, key)
    for path in (tmp_path / "a").rglob("*"):
        if path.is_file() and path.suffix != ".pub":
            assert stat.S_IMODE(path.stat().st_mode) == 0o600, path
    assert "/kubernetes/" in (ROOT / ".gitignore").read_text().splitlines()


def contents(folder: Path) -> dict[Path, bytes]:
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_a_second_run_changes_nothing_and_what_people_have_changed_stays(tmp_path: Path) -> None:
    write(tmp_path)
    with (tmp_path / "values.yaml").open("a") as file:
        file.write("serviceAccount: mine\n")
    before = contents(tmp_path)
    write(tmp_path)
    assert contents(tmp_path) == before


def test_force_makes_new_secrets_and_keeps_keys_and_what_was_there(tmp_path: Path) -> None:
    write(tmp_path)
    old, keys = (tmp_path / "secrets.json").read_bytes(), contents(tmp_path / "keys")
    write(tmp_path, force=True)
    assert (tmp_path / "secrets.json.old").read_bytes() == old
    assert stat.S_IMODE((tmp_path / "secrets.json.old").stat().st_mode) == 0o600
    before, after = json.loads(old)["items"], json.loads((tmp_path / "secrets.json").read_text())["items"]
    changed = {one["metadata"]["name"] for one, other in zip(before, after, strict=True) if one != other}
    assert changed == {"capture2vr-operator", "capture2vr-s3", "capture2vr-workers"}
    assert contents(tmp_path / "keys") == keys


def test_a_pool_more_gets_a_certificate_and_the_token_stays(tmp_path: Path) -> None:
    write(tmp_path)
    before = secrets_of(tmp_path)["capture2vr-workers"]
    write(tmp_path, cluster=Cluster("vr", ("cpu", "fast")))
    after = secrets_of(tmp_path)["capture2vr-workers"]
    assert (after["token"], after["ca.crt"]) == (before["token"], before["ca.crt"])
    names = x509.load_pem_x509_certificate(after["tls.crt"].encode()).extensions
    assert "vr-capture2vr-fast" in names.get_extension_for_class(x509.SubjectAlternativeName).value.get_values_for_type(
        x509.DNSName
    )


def test_a_certificate_that_ends_soon_is_renewed_in_the_secret(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as patch:
        patch.setattr(tls_authority, "SERVER_DAYS", tls_authority.RENEW_DAYS - 1)
        write(tmp_path)
    before = secrets_of(tmp_path)["capture2vr-workers"]
    write(tmp_path)
    after = secrets_of(tmp_path)["capture2vr-workers"]
    assert after["tls.crt"] != before["tls.crt"]
    assert after["tls.crt"] == KeyFolder(tmp_path / "keys").certificate.read_text()


def test_a_url_is_one_of_an_ingress_or_of_a_gateway(tmp_path: Path) -> None:
    manifests = write(tmp_path / "ingress")
    (ingress,) = of_kind(manifests, "Ingress")
    assert ingress["spec"]["tls"] == [{"hosts": ["vr.example"], "secretName": WEB_TLS}]
    assert "ingressClassName" not in ingress["spec"], "the cluster's own"
    manifests = write(tmp_path / "gateway", cluster=Cluster("vr", ("cpu",), "eg"))
    (gateway,) = of_kind(manifests, "Gateway")
    assert gateway["spec"]["gatewayClassName"] == "eg"
    assert [each["port"] for each in gateway["spec"]["listeners"]] == [80, 443]
    manifests = write(tmp_path / "traefik", cluster=Cluster("vr", ("cpu",), "traefik"))
    (gateway,) = of_kind(manifests, "Gateway")
    assert [each["port"] for each in gateway["spec"]["listeners"]] == [8000, 8443]
    plain = write(tmp_path / "plain", Address(public_url="http://vr.example:8080"))
    assert "tls" not in of_kind(plain, "Ingress")[0]["spec"]
    local = write(tmp_path / "local", Address())
    assert of_kind(local, "Ingress") == []
    (container,) = [each for each in containers(local) if each["name"] == "gateway"]
    assert plain_variables(container)["STORAGE_PUBLIC_ENDPOINT"] == "http://127.0.0.1:9000"


@pytest.mark.parametrize(
    ("variables", "said"),
    [
        ({"STORAGE_ENDPOINT": "https://s3.example"}, "STORAGE_BUCKET, STORAGE_ACCESS_KEY, STORAGE_SECRET"),
        ({"GATEWAY_DATABASE_URL": "sqlite:///a"}, "give the URL of a Postgres"),
    ],
)  # fmt: skip
def test_a_store_or_database_that_is_named_by_half_is_refused_and_nothing_written(
    tmp_path: Path, variables: dict[str, str], said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    with pytest.raises(BadInput, match=said):
        write(tmp_path)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("address", "cluster", "said"),
    [
        (Address("0.0.0.0", public_url="https://a.example"), {}, "--bind and --port are for docker-compose.yml"),
        (Address(public_url="http://10.0.0.7"), {}, "give a host name"),
        (WEB, {"release": "Vr"}, "--release Vr"),
        (WEB, {"release": "a" * 54}, "--release"),
        (WEB, {"pools": ("cpu", "big_one")}, "--pool big_one"),
        (WEB, {"gateway_class": "a b"}, "--gateway-class a b"),
    ],
)
def test_a_wrong_argument_is_named_and_nothing_is_written(
    tmp_path: Path, address: Address, cluster: dict[str, Any], said: str
) -> None:
    with pytest.raises(BadInput, match=said):
        write(tmp_path, address, Cluster(**{"release": "vr", "pools": ("cpu",), **cluster}))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("damaged", ["", "[]", '{"items": [{"metadata": {}}]}', '{"items": 3}'])
def test_a_damaged_file_of_secrets_is_not_replaced_unasked(tmp_path: Path, damaged: str) -> None:
    write(tmp_path)
    (tmp_path / "secrets.json").write_text(damaged)
    with pytest.raises(BadInput, match="put it back, or make new secrets with --force"):
        write(tmp_path)
    assert (tmp_path / "secrets.json").read_text() == damaged
    write(tmp_path, force=True)


@pytest.mark.slow
def test_the_command_prints_what_comes_next_and_no_secret(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "capture2vr.cli", "deploy", "init", "--kubernetes", "--out", str(tmp_path)]
    ended = subprocess.run(
        [*command, "--public-url", "https://vr.example"], cwd=ROOT, capture_output=True, text=True, timeout=HANG_S
    )
    assert ended.returncode == 0, ended.stderr
    values = [value for content in secrets_of(tmp_path / "kubernetes").values() for value in content.values()]
    assert not any(value in ended.stdout + ended.stderr for value in values)
    for expected in ("kubectl apply --server-side -f", "helm upgrade --install vr deploy/chart -f"):
        assert expected in ended.stderr
