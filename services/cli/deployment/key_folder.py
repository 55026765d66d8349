"""The folder of a deployment's keys: the key that signs collections, and the TLS certificate of its workers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from capture2vr.cli.deployment.tls_authority import is_current, make_authority, make_server_certificate
from capture2vr.cli.progress import console
from capture2vr.storage.catalogue.signing import generate_key, read_signer


@dataclass(frozen=True, slots=True)
class KeyFolder:
    """The folder of keys. `mounted` is what the containers see as /keys; the CA's private key is not in it."""

    root: Path

    @property
    def mounted(self) -> Path:
        return self.root / "containers"

    @property
    def authority(self) -> Path:
        return self.mounted / "ca.pem"

    @property
    def authority_key(self) -> Path:
        return self.root / "ca.key"

    @property
    def certificate(self) -> Path:
        return self.mounted / "edge.crt"

    @property
    def certificate_key(self) -> Path:
        return self.mounted / "edge.key"

    @property
    def signing_key(self) -> Path:
        return self.mounted / "signing"


def make_keys(keys: KeyFolder, worker_names: Sequence[str]) -> None:
    """Make the keys and certificates that are missing; renew a certificate that ends soon, or lacks a worker's name.

    worker_names  host names by which gateways call the workers. Raises BadInput, OSError.
    """
    for folder in (keys.root, keys.mounted):
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    if not keys.signing_key.exists():
        public = generate_key(keys.signing_key)
        console.print(f"{keys.signing_key}: new key {public.id}; {keys.signing_key}.pub is for those who read")
    else:
        read_signer(keys.signing_key)
    if not keys.authority.exists() and not keys.authority_key.exists():
        make_authority(keys.authority, keys.authority_key)
        console.print(f"{keys.authority}: new certificate authority; keep {keys.authority_key} secret")
    if not is_current(keys.certificate, keys.certificate_key, keys.authority, worker_names):
        make_server_certificate(
            keys.certificate,
            keys.certificate_key,
            worker_names,
            authority=keys.authority,
            authority_key=keys.authority_key,
        )
        console.print(f"{keys.certificate}: new certificate for {', '.join(worker_names)}; restart running workers")
