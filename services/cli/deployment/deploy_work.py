"""Implementation of `capture2vr deploy init`: the file .env and the folder of keys beside docker-compose.yml."""

from __future__ import annotations

import ipaddress
import os
import secrets
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import urlsplit

from capture2vr.cli.deployment.key_folder import KeyFolder, make_keys
from capture2vr.cli.deployment.tls_authority import write_private
from capture2vr.cli.progress import console, warn
from capture2vr.errors import BadInput
from capture2vr.process.strict_settings import LOOPBACK

CONTAINER_USER = 10_001
"""User id of gateway and workers inside their containers, who read the keys."""

BACKUPS = "backups"
"""Folder beside docker-compose.yml that the service `backup` writes to, unless the variable BACKUPS names another."""

WORKER_NAMES = ("edge", "edge-gpu", "localhost")
"""Host names that the workers' certificate is for: the services of docker-compose.yml, and the container itself."""

_SECRETS = {
    "STORAGE_ACCESS_KEY": "the store, gateway and workers must start again together: docker compose up --wait",
    "STORAGE_SECRET_KEY": "the same; a store elsewhere keeps its old secret until you change it there",
    "EDGE_TOKEN": "gateway and workers must start again together",
    "POSTGRES_PASSWORD": "a Postgres that has data keeps its old password until you change it there: ALTER USER",
}
"""The random secrets in .env, each with what has to be done where the service has run with another one."""


@dataclass(frozen=True, slots=True)
class Address:
    """Where the service listens, and the URL by which others reach it; "": that of this machine alone."""

    bind: str = "127.0.0.1"
    port: int = 8080
    public_url: str = ""

    def __post_init__(self) -> None:
        """Raises BadInput."""
        try:
            ipaddress.ip_address(self.bind)
        except ValueError:
            raise BadInput(f"--bind {self.bind}: give an IP address, such as 0.0.0.0 for all of this machine") from None
        if self.public_url:
            _check_url(self.public_url)
        elif self.is_public:
            raise BadInput(f"--bind {self.bind} needs --public-url: the URL by which phones and headsets reach it")

    @property
    def is_public(self) -> bool:
        """Whether other machines can connect."""
        return self.bind not in LOOPBACK

    @property
    def url(self) -> str:
        """URL of the service, without a slash at the end."""
        return (self.public_url or f"http://127.0.0.1:{self.port}").rstrip("/")


def initialise(folder: Path, address: Address, *, force: bool) -> None:
    """Write what is missing of .env and keys in the folder of docker-compose.yml. Raises BadInput, OSError.

    force  replace the secrets of an existing .env; its other variables, and all keys, stay
    """
    if not (folder / "docker-compose.yml").is_file():
        raise BadInput(f"{folder.absolute()} has no docker-compose.yml: name its folder with --out")
    env = folder / ".env"
    if env.exists() and not force and address != Address():
        raise BadInput(f"{env} exists and stays as it is: change BIND, PORT and PUBLIC_URL in it, or use --force")
    keys = KeyFolder(folder / "keys")
    make_keys(keys, WORKER_NAMES)
    (folder / BACKUPS).mkdir(mode=0o700, exist_ok=True)
    if not env.exists():
        write_private(env, _env_text(address, []).encode())
        console.print(f"{env}: new random secrets")
    elif force:
        _replace(env, address)
    else:
        console.print(f"{env} exists and stays as it is; --force makes new secrets")
    _print_next(folder, address, is_ours=_hand_over(folder, keys))


def _hand_over(folder: Path, keys: KeyFolder) -> bool:
    """Give `mounted` and the backups to the containers' user, and all else to the owner of the deployment's folder.

    Only root may do so. Returns whether the containers can read their keys.
    """
    if os.geteuid() != 0:
        return keys.mounted.stat().st_uid == CONTAINER_USER
    owner = folder.stat()
    for path in (folder / ".env", folder / ".env.old", keys.root, keys.authority_key):
        if path.exists():
            os.chown(path, owner.st_uid, owner.st_gid)
    for path in (folder / BACKUPS, keys.mounted, *keys.mounted.iterdir()):
        os.chown(path, CONTAINER_USER, CONTAINER_USER)
    return True


def _replace(env: Path, address: Address) -> None:
    """Write .env with new secrets; the old file is kept as .env.old. Other variables in it stay."""
    old = env.read_text()
    write_private(env.with_name(".env.old"), old.encode())
    ours = {name for name, _ in _variables(address)}
    kept = [line for line in old.splitlines() if "=" in line and line.partition("=")[0].strip() not in ours]
    write_private(env, _env_text(address, [line for line in kept if not line.startswith("#")]).encode())
    warn(f"{env} has new secrets; the old ones are in {env.with_name('.env.old')}. If the service has run already:")
    for name, consequence in _SECRETS.items():
        console.print(f"  {name}: {consequence}", markup=False, highlight=False)


def _variables(address: Address) -> Iterator[tuple[str, str]]:
    """Yield the variables of docker-compose.yml that `init` sets, with their values."""
    yield from (("BIND", address.bind), ("PORT", str(address.port)), ("PUBLIC_URL", address.url))
    yield "STORAGE_ACCESS_KEY", secrets.token_hex(10)
    for name in ("STORAGE_SECRET_KEY", "EDGE_TOKEN", "POSTGRES_PASSWORD"):
        yield name, secrets.token_hex(32)
    yield from (("KEYS", "./keys/containers"), ("STORAGE_SIGNING_KEY", "/keys/signing"))
    yield from (("EDGE_TLS_CERT", "/keys/edge.crt"), ("EDGE_TLS_KEY", "/keys/edge.key"))
    yield "GATEWAY_EDGE_CA", "/keys/ca.pem"


def _env_text(address: Address, others: list[str]) -> str:
    head = (
        "# Written by capture2vr deploy init. It holds secrets: never commit it. deploy/runbook.md lists all variables."
    )
    return "\n".join([head, *(f"{name}={value}" for name, value in _variables(address)), *others, ""])


def _print_next(folder: Path, address: Address, *, is_ours: bool) -> None:
    """Print the commands that come next."""
    commands = (
        []
        if is_ours
        else [
            f"sudo chown -R {CONTAINER_USER} {KeyFolder(folder / 'keys').mounted} {folder / BACKUPS}"
            "    # the containers' user reads and writes them"
        ]
    )
    if address.is_public:
        scopes = " ".join(f"--scope {scope}" for scope in ("operate", "manage", "capture", "read"))
        commands.append(f"docker compose run --rm gateway keys create {scopes}    # prints the first access key, once")
    commands.append("docker compose up --build --wait")
    console.print("next:")
    for command in commands:
        console.print(f"  {command}", markup=False, highlight=False)


def _check_url(url: str) -> None:
    """Raise BadInput for a URL that is not http(s)://host[:port], or has characters with a meaning in .env."""
    try:
        parts = urlsplit(url)
        _ = parts.port
    except ValueError as error:
        raise BadInput(f"--public-url: this is no URL: {error}") from None
    strange = not url.isascii() or any(not letter.isprintable() or letter in " \"'$#`\\" for letter in url)
    if strange or parts.scheme not in ("http", "https") or not parts.hostname or parts.path not in ("", "/"):
        raise BadInput("--public-url: give a URL like https://capture.example or http://10.0.0.7:8080, without a path")
    if parts.query or parts.fragment or parts.username:
        raise BadInput("--public-url: leave out user, query and fragment")
