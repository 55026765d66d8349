"""Implementation of `capture2vr deploy init --kubernetes`: secrets and values of the Helm chart, deploy/chart.

`secrets.json` is a list of manifests for kubectl, `values.yaml` names them to the chart.
"""

from __future__ import annotations

import ipaddress
import json
import os
import re
import secrets
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import urlsplit

from capture2vr.cli.deployment.deploy_work import Address
from capture2vr.cli.deployment.key_folder import KeyFolder, make_keys
from capture2vr.cli.deployment.tls_authority import write_private
from capture2vr.cli.progress import console, warn
from capture2vr.errors import BadInput

OPERATOR, STORE, WORKERS, SIGNING, DATABASE, WEB_TLS = (
    f"capture2vr-{name}" for name in ("operator", "s3", "workers", "signing", "postgres", "tls")
)
"""Names of the secrets; values.yaml hands them to the chart, and the last one is made by cert-manager or by hand."""

_LOCAL = "http://127.0.0.1:8080"
"""Where `kubectl port-forward` puts the gateway; the store then is on port 9000."""

_NAME = re.compile(r"[a-z0-9]([-a-z0-9]{0,51}[a-z0-9])?")
_POOL = re.compile(r"[a-z0-9]([-a-z0-9]{0,18}[a-z0-9])?")  # as values.schema.json has it
_CHART_NAME_CHARS = 40  # as _helpers.tpl cuts it, so that the services' names stay within 63

_STORE_VALUES = {"endpoint": "ENDPOINT", "publicEndpoint": "PUBLIC_ENDPOINT", "bucket": "BUCKET", "region": "REGION"}
"""Values of the chart's `storage`, with the variables STORAGE_ that they are taken from."""

_Secrets = dict[str, dict[str, str]]


@dataclass(frozen=True, slots=True)
class Cluster:
    """The Helm release, its pools of workers, and the GatewayClass by which it is reached; "": by an Ingress."""

    release: str
    pools: tuple[str, ...]
    gateway_class: str = ""

    def __post_init__(self) -> None:
        """Raises BadInput."""
        if not _NAME.fullmatch(self.release):
            raise BadInput(f"--release {self.release}: use a-z, 0-9 and - for the name of a release")
        for pool in self.pools:
            if not _POOL.fullmatch(pool):
                raise BadInput(f"--pool {pool}: use 1 to 20 of a-z, 0-9 and - for the name of a pool")
        if self.gateway_class and not re.fullmatch(r"[a-z0-9]([-a-z0-9.]*[a-z0-9])?", self.gateway_class):
            raise BadInput(
                f"--gateway-class {self.gateway_class}: give the name of a GatewayClass: kubectl get gatewayclass"
            )

    @property
    def name(self) -> str:
        """Beginning of the names of everything that the chart makes."""
        return f"{self.release}-capture2vr"[:_CHART_NAME_CHARS].removesuffix("-")

    @property
    def worker_names(self) -> tuple[str, ...]:
        """Host names that the workers' certificate is for: the pools' services."""
        return (*(f"{self.name}-{pool}" for pool in self.pools), "localhost")


@dataclass(frozen=True, slots=True)
class Elsewhere:
    """What the release uses and does not bring: variables of a store without STORAGE_, and a Postgres' URL; or none."""

    store: dict[str, str]
    database: str


def initialise_cluster(folder: Path, address: Address, cluster: Cluster, *, force: bool) -> None:
    """Write what is missing of keys, secrets.json and values.yaml. Raises BadInput, OSError.

    A store or a Postgres elsewhere is taken from the variables STORAGE_ and GATEWAY_DATABASE_URL.

    force  make new secrets and values; the old files are kept with .old behind their names, and the keys stay
    """
    if address != Address(public_url=address.public_url):
        raise BadInput("--bind and --port are for docker-compose.yml: leave them out with --kubernetes")
    host = _host(address.public_url)
    elsewhere = Elsewhere(_external_store(os.environ), _database_url(os.environ))
    keys = KeyFolder(folder / "keys")
    make_keys(keys, cluster.worker_names)
    _write_secrets(folder / "secrets.json", keys, elsewhere, force=force)
    values = folder / "values.yaml"
    if values.exists() and not force:
        console.print(f"{values} exists and stays as it is; --force writes a new one")
    else:
        _write(values, "\n".join([*_values(address.public_url, host, cluster, elsewhere), ""]))
        console.print(f"{values}: written; it is yours to change")
    _print_next(folder, cluster, host, has_tls=address.public_url.startswith("https://"))


def _write_secrets(path: Path, keys: KeyFolder, elsewhere: Elsewhere, *, force: bool) -> None:
    is_replaced = force and path.exists()
    old = {} if force else _read_secrets(path)
    found = _fill_in(old, elsewhere) | _of_keys(keys, old)
    _write(path, _manifests(found))
    console.print(f"{path}: secrets {', '.join(sorted(found))}")
    if is_replaced:
        warn(f"{path} has new secrets: apply it, then kubectl rollout restart deployment; {path}.old has the old ones")


def _write(path: Path, text: str) -> None:
    """Write a file for its owner alone (mode 0600); what it held before is kept in a file with .old behind its name."""
    if path.exists() and (before := path.read_bytes()) != text.encode():
        write_private(path.with_name(f"{path.name}.old"), before)
    write_private(path, text.encode())


def _host(public_url: str) -> str:
    """Return the host of the URL, "" without one. Raises BadInput for an address, which no Ingress can be for."""
    host = urlsplit(public_url).hostname or ""
    with suppress(ValueError):
        ipaddress.ip_address(host)
        raise BadInput(f"--public-url {public_url}: give a host name; an Ingress or a Gateway cannot be for an address")
    return host


def _external_store(environment: Mapping[str, str]) -> dict[str, str]:
    """Return the variables of a store elsewhere, empty where none is named. Raises BadInput where a key is missing."""
    names = (*_STORE_VALUES.values(), "ACCESS_KEY", "SECRET_KEY")
    found = {name: value for name in names if (value := environment.get(f"STORAGE_{name}", ""))}
    if not found:
        return {}
    if missing := [f"STORAGE_{name}" for name in ("BUCKET", "ACCESS_KEY", "SECRET_KEY") if name not in found]:
        raise BadInput(f"a store elsewhere is named by STORAGE_ variables, and {', '.join(missing)} is missing: set it")
    return found


def _database_url(environment: Mapping[str, str]) -> str:
    url = environment.get("GATEWAY_DATABASE_URL", "")
    if url and not url.startswith("postgres"):
        raise BadInput("GATEWAY_DATABASE_URL: give the URL of a Postgres, or none for SQLite on a volume")
    return url


def _read_secrets(path: Path) -> _Secrets:
    """Return the secrets of a file that an earlier run wrote. Raises BadInput for one that is damaged."""
    if not path.exists():
        return {}
    try:
        return {each["metadata"]["name"]: dict(each["stringData"]) for each in json.loads(path.read_text())["items"]}
    except (ValueError, KeyError, TypeError):
        raise BadInput(
            f"{path} is not what this command writes: put it back, or make new secrets with --force"
        ) from None


def _fill_in(old: _Secrets, elsewhere: Elsewhere) -> _Secrets:
    """Return the random secrets, and those of what is elsewhere; what there was before stays."""
    from capture2vr.gateway.access.api_key import new_secret

    store = old.get(STORE) or {"access-key": secrets.token_hex(10), "secret-key": secrets.token_hex(32)}
    if given := elsewhere.store:
        store = {"access-key": given["ACCESS_KEY"], "secret-key": given["SECRET_KEY"]}
    filled = {OPERATOR: old.get(OPERATOR) or {"key": new_secret("default")}, STORE: store}
    if elsewhere.database:
        filled[DATABASE] = {"url": elsewhere.database}
    elif DATABASE in old:
        filled[DATABASE] = old[DATABASE]
    return filled


def _of_keys(keys: KeyFolder, old: _Secrets) -> _Secrets:
    files = {"ca.crt": keys.authority, "tls.crt": keys.certificate, "tls.key": keys.certificate_key}
    token = old.get(WORKERS, {}).get("token") or secrets.token_hex(32)
    return {
        WORKERS: {name: path.read_text() for name, path in files.items()} | {"token": token},
        SIGNING: {"collection.key": keys.signing_key.read_text()},
    }


def _manifests(found: _Secrets) -> str:
    items = [
        {"apiVersion": "v1", "kind": "Secret", "type": "Opaque", "metadata": {"name": name}, "stringData": content}
        for name, content in sorted(found.items())
    ]
    return json.dumps({"apiVersion": "v1", "kind": "List", "items": items}, indent=2) + "\n"


def _values(public_url: str, host: str, cluster: Cluster, elsewhere: Elsewhere) -> Iterator[str]:
    """Yield the lines of values.yaml. A text in JSON's quotes is one in YAML too."""
    yield "# Written by capture2vr deploy init --kubernetes; yours to change. All values: deploy/chart/values.yaml."
    yield f"publicUrl: {json.dumps(public_url.rstrip('/') or _LOCAL)}"
    yield from ("storage:", f"  existingSecret: {STORE}", f"  signingKeySecret: {SIGNING}")
    for value, variable in _STORE_VALUES.items():
        if variable in elsewhere.store:
            yield f"  {value}: {json.dumps(elsewhere.store[variable])}"
    if not elsewhere.store:
        yield from () if host else ('  publicEndpoint: "http://127.0.0.1:9000"',)
        yield from ("store:", "  enabled: true")
    if elsewhere.database:
        yield from ("database:", f"  existingSecret: {DATABASE}")
    yield from ("gateway:", f"  operatorKeySecret: {OPERATOR}")
    yield from ("workerTls:", f"  existingSecret: {WORKERS}")
    yield from ("workers:", "  cpu:", '    resources: {requests: {cpu: "1", memory: 3Gi}, limits: {memory: 6Gi}}')
    yield "    scratch: {accessMode: ReadWriteOnce}   # checkpoints stay on the machine"
    yield from _way_in(public_url, host, cluster) if host else ()


def _way_in(public_url: str, host: str, cluster: Cluster) -> Iterator[str]:
    """Yield the lines about the Ingress or the Gateway."""
    yield from ("gatewayApi:" if cluster.gateway_class else "ingress:", "  enabled: true", f"  host: {host}")
    if cluster.gateway_class:
        yield f"  className: {cluster.gateway_class}"
    if cluster.gateway_class == "traefik":
        yield "  ports: {http: 8000, https: 8443}   # its entry points, behind 80 and 443 of its service"
    if public_url.startswith("https://"):
        yield f"  tlsSecret: {WEB_TLS}"


def _print_next(folder: Path, cluster: Cluster, host: str, *, has_tls: bool) -> None:
    """Print the commands that come next."""
    console.print("next:")
    commands = [f"kubectl apply --server-side -f {folder / 'secrets.json'}"]
    if has_tls:
        commands.append(
            f"kubectl create secret tls {WEB_TLS} --cert=tls.crt --key=tls.key    # of {host}; or cert-manager makes it"
        )
    commands.append(f"helm upgrade --install {cluster.release} deploy/chart -f {folder / 'values.yaml'}")
    for command in commands:
        console.print(f"  {command}", markup=False, highlight=False)
