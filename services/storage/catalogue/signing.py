"""Ed25519 keys (RFC 8032) in PEM files: generate and read keys, sign text, verify signatures.

A key's id is the first 16 hex digits of the sha256 of its 32 raw public bytes. `cryptography` is imported with the
first key only: it takes 50 ms, which an unsigned store saves.
"""

from __future__ import annotations

import base64
import hashlib
import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from capture2vr.storage.catalogue.faults import KEY_UNKNOWN, SIGNATURE_MISSING, SIGNATURE_WRONG, CatalogueFault

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

Signature = Mapping[str, str]
"""{"key": <id of the public key>, "ed25519": <base64 of the 64 bytes>}"""

_ID_DIGITS = 16
_PEM_BYTES = 10_000  # read limit: a key has about 120; a file named by mistake may be huge


class KeyFileError(ValueError):
    """A key file that cannot be read or holds no Ed25519 key. The message names the file, the reason and what to do."""


@dataclass(frozen=True, slots=True)
class PublicKey:
    """A public key, which verifies signatures. id: see above; raw: its 32 bytes"""

    id: str
    raw: bytes


@dataclass(frozen=True, slots=True)
class Signer:
    """A private key, which signs, and its public key. The repr does not show the private key."""

    public: PublicKey
    private: Ed25519PrivateKey = field(repr=False)

    def sign(self, text: bytes) -> dict[str, str]:
        """Sign a text. The same text always gives the same signature."""
        return {"key": self.public.id, "ed25519": base64.b64encode(self.private.sign(text)).decode()}


@dataclass(frozen=True, slots=True)
class Keys:
    """The keys that a process signs with (signers), and further public keys whose signatures it accepts (trusted).

    With no keys at all it signs nothing and accepts everything, unverified.
    """

    signers: tuple[Signer, ...] = ()
    trusted: tuple[PublicKey, ...] = ()

    @property
    def verification_keys(self) -> tuple[PublicKey, ...]:
        """Public keys whose signatures are accepted: those of the signers, then the trusted ones, each once."""
        return tuple(dict.fromkeys((*(each.public for each in self.signers), *self.trusted)))


NO_KEYS = Keys()


def read_signer(path: Path) -> Signer:
    """Read a private key from a PEM file. Raises KeyFileError."""
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
    from cryptography.hazmat.primitives.serialization import load_pem_private_key

    try:
        key = load_pem_private_key(_read_pem(path), password=None)
    except (ValueError, TypeError) as error:  # TypeError: the file is encrypted
        raise KeyFileError(
            f"{path} holds no unencrypted private key in PEM: {error}; make one with capture2vr catalogue keygen"
        ) from None
    if not isinstance(key, Ed25519PrivateKey):
        raise KeyFileError(f"{path} does not hold an Ed25519 key; make one with capture2vr catalogue keygen")
    return Signer(public_key(key.public_key().public_bytes_raw()), key)


def read_public_key(path: Path) -> PublicKey:
    """Read a public key from a PEM file. Raises KeyFileError."""
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey
    from cryptography.hazmat.primitives.serialization import load_pem_public_key

    try:
        key = load_pem_public_key(_read_pem(path))
    except ValueError as error:
        raise KeyFileError(f"{path} holds no public key in PEM: {error}; name the .pub file that keygen made") from None
    if not isinstance(key, Ed25519PublicKey):
        raise KeyFileError(f"{path} does not hold an Ed25519 key; name the .pub file that keygen made")
    return public_key(key.public_bytes_raw())


def public_key(raw: bytes) -> PublicKey:
    """Make a PublicKey of 32 raw bytes, computing its id."""
    return PublicKey(hashlib.sha256(raw).hexdigest()[:_ID_DIGITS], raw)


def generate_key(path: Path) -> PublicKey:
    """Generate a key pair: the private key in `path` (mode 0600), the public key in `path`.pub.

    Raises FileExistsError where either file exists.
    """
    from cryptography.hazmat.primitives import serialization as pem
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

    public_path = path.with_name(path.name + ".pub")
    if public_path.exists():
        raise FileExistsError(f"{public_path} exists already; name another file, or delete it yourself")
    key = Ed25519PrivateKey.generate()
    private = key.private_bytes(pem.Encoding.PEM, pem.PrivateFormat.PKCS8, pem.NoEncryption())
    public = key.public_key().public_bytes(pem.Encoding.PEM, pem.PublicFormat.SubjectPublicKeyInfo)
    path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    _write_new(path, private, 0o600)
    _write_new(public_path, public, 0o644)
    return public_key(key.public_key().public_bytes_raw())


def check_signatures(
    name: str, text: bytes, signatures: Iterable[Signature], verification_keys: tuple[PublicKey, ...]
) -> None:
    """Check that at least one of the verification keys has signed the text of object `name`; without keys, do nothing.

    Raises CatalogueFault SIGNATURE_MISSING, KEY_UNKNOWN, SIGNATURE_WRONG.
    """
    signatures = list(signatures)
    if not verification_keys:
        return
    if not signatures:
        raise CatalogueFault(SIGNATURE_MISSING, name, "it is not signed", hint="rebuild it with a signing key")
    keys = {each.id: each.raw for each in verification_keys}
    known = [each for each in signatures if each["key"] in keys]
    if not known:
        ids = ", ".join(each["key"] for each in signatures)
        raise CatalogueFault(KEY_UNKNOWN, name, f"it is signed by key {ids}; the trusted keys are {', '.join(keys)}")
    # One valid signature is enough: during a key rotation there are two, and clients know the old key or the new one.
    if not any(_is_valid_signature(text, each["ed25519"], keys[each["key"]]) for each in known):
        ids = ", ".join(each["key"] for each in known)
        raise CatalogueFault(SIGNATURE_WRONG, name, f"the signature of key {ids} does not match its content")


def _is_valid_signature(text: bytes, signature: str, raw: bytes) -> bool:
    from cryptography.exceptions import InvalidSignature
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

    try:
        Ed25519PublicKey.from_public_bytes(raw).verify(base64.b64decode(signature, validate=True), text)
    except (InvalidSignature, ValueError):  # ValueError: no base64
        return False
    return True


def _read_pem(path: Path) -> bytes:
    try:
        with path.open("rb") as file:
            return file.read(_PEM_BYTES)
    except OSError as error:
        raise KeyFileError(f"{path} cannot be read: {error.strerror}; name a key file") from None


def _write_new(path: Path, data: bytes, mode: int) -> None:
    try:
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode)
    except FileExistsError:
        raise FileExistsError(f"{path} exists already; name another file, or delete it yourself") from None
    with os.fdopen(descriptor, "wb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())
