"""Ed25519 keys (RFC 8032) as PEM files, and signatures of text with them.

A key's id is the first 16 hex digits of the sha256 of its raw 32 public bytes. `cryptography` is loaded by the first
key only: it takes 50 ms, which an unsigned store need not pay.
"""

from __future__ import annotations

import base64
import hashlib
import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from services.storage.faults import KEY_UNKNOWN, SIGNATURE_MISSING, SIGNATURE_WRONG, CatalogueFault

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

Signature = Mapping[str, str]
"""{"key": <id of the public key>, "ed25519": <base64 of the 64 bytes>}"""

_ID_DIGITS = 16
_PEM_BYTES = 10_000  # a key has some 120; a file given by mistake may have any number


class KeyFileError(ValueError):
    """A file that was named as a key and is none; the sentence names the file, the reason and what to do."""


@dataclass(frozen=True, slots=True)
class Public:
    """A public key: whose signatures one believes."""

    id: str
    raw: bytes


@dataclass(frozen=True, slots=True)
class Signer:
    """A private key, which its repr keeps to itself."""

    public: Public
    private: Ed25519PrivateKey = field(repr=False)

    def sign(self, text: bytes) -> dict[str, str]:
        """The signature of a text; the same text always gives the same one."""
        return {"key": self.public.id, "ed25519": base64.b64encode(self.private.sign(text)).decode()}


@dataclass(frozen=True, slots=True)
class Keys:
    """What a process signs with, and whose signatures it believes: its own and the trusted ones.

    With neither it signs nothing and believes whatever it reads.
    """

    signers: tuple[Signer, ...] = ()
    trusted: tuple[Public, ...] = ()

    @property
    def believed(self) -> tuple[Public, ...]:
        """Every public key once, its own first."""
        return tuple(dict.fromkeys((*(each.public for each in self.signers), *self.trusted)))


NO_KEYS = Keys()


def read_signer(path: Path) -> Signer:
    """The private key of a PEM file. Raises KeyFileError."""
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
    from cryptography.hazmat.primitives.serialization import load_pem_private_key

    try:
        key = load_pem_private_key(_pem(path), password=None)
    except (ValueError, TypeError) as error:  # TypeError: the file is encrypted
        raise KeyFileError(f"{path} holds no plain private key in PEM: {error}; make one with keygen") from None
    if not isinstance(key, Ed25519PrivateKey):
        raise KeyFileError(f"{path} holds another kind of key than Ed25519; make one with keygen")
    return Signer(public_of(key.public_key().public_bytes_raw()), key)


def read_public(path: Path) -> Public:
    """The public key of a PEM file. Raises KeyFileError."""
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey
    from cryptography.hazmat.primitives.serialization import load_pem_public_key

    try:
        key = load_pem_public_key(_pem(path))
    except ValueError as error:
        raise KeyFileError(f"{path} holds no public key in PEM: {error}; name the .pub file of keygen") from None
    if not isinstance(key, Ed25519PublicKey):
        raise KeyFileError(f"{path} holds another kind of key than Ed25519; name the .pub file of keygen")
    return public_of(key.public_bytes_raw())


def public_of(raw: bytes) -> Public:
    """The key of 32 raw bytes, with its id."""
    return Public(hashlib.sha256(raw).hexdigest()[:_ID_DIGITS], raw)


def generate(path: Path) -> Public:
    """Make a key: `path` (mode 0600) and beside it `path`.pub. Raises FileExistsError where either is there."""
    from cryptography.hazmat.primitives import serialization as pem
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

    beside = path.with_name(path.name + ".pub")
    if beside.exists():
        raise FileExistsError(f"{beside} is there already; name another file, or take it away yourself")
    key = Ed25519PrivateKey.generate()
    private = key.private_bytes(pem.Encoding.PEM, pem.PrivateFormat.PKCS8, pem.NoEncryption())
    public = key.public_key().public_bytes(pem.Encoding.PEM, pem.PublicFormat.SubjectPublicKeyInfo)
    _write_new(path, private, 0o600)
    _write_new(beside, public, 0o644)
    return public_of(key.public_key().public_bytes_raw())


def check_signatures(name: str, text: bytes, signatures: Iterable[Signature], believed: tuple[Public, ...]) -> None:
    """That at least one key in `believed` has signed the text of object `name`; with none there, anything passes.

    Raises CatalogueFault SIGNATURE_MISSING, KEY_UNKNOWN, SIGNATURE_WRONG.
    """
    signatures = list(signatures)
    if not believed:
        return
    if not signatures:
        raise CatalogueFault(SIGNATURE_MISSING, name, "nobody has signed it", hint="rebuild it with a signing key")
    keys = {each.id: each.raw for each in believed}
    known = [each for each in signatures if each["key"] in keys]
    if not known:
        ids = ", ".join(each["key"] for each in signatures)
        raise CatalogueFault(KEY_UNKNOWN, name, f"signed by {ids}, believed are {', '.join(keys)}")
    # One is enough: while keys are exchanged there are two, and clients know the old one or the new one.
    if not any(_holds(text, each["ed25519"], keys[each["key"]]) for each in known):
        ids = ", ".join(each["key"] for each in known)
        raise CatalogueFault(SIGNATURE_WRONG, name, f"the signature of {ids} is not that of this text")


def _holds(text: bytes, signature: str, raw: bytes) -> bool:
    from cryptography.exceptions import InvalidSignature
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

    try:
        Ed25519PublicKey.from_public_bytes(raw).verify(base64.b64decode(signature, validate=True), text)
    except (InvalidSignature, ValueError):  # ValueError: no base64
        return False
    return True


def _pem(path: Path) -> bytes:
    try:
        with path.open("rb") as file:
            return file.read(_PEM_BYTES)
    except OSError as error:
        raise KeyFileError(f"{path} cannot be read as a key: {error.strerror}") from None


def _write_new(path: Path, data: bytes, mode: int) -> None:
    try:
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode)
    except FileExistsError:
        raise FileExistsError(f"{path} is there already; name another file, or take it away yourself") from None
    with os.fdopen(descriptor, "wb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())
