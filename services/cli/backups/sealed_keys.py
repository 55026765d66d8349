"""Encrypt a folder of keys into one file by a passphrase, and secrets in a database's rows: scrypt, AES-256-GCM.

Whoever has a backup must not thereby be able to sign collections or pose as a worker.
"""

from __future__ import annotations

import base64
import io
import os
import stat
import tarfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path, PurePosixPath

from cryptography.exceptions import InvalidTag
from cryptography.hazmat.primitives.ciphers.aead import AESGCM
from cryptography.hazmat.primitives.kdf.scrypt import Scrypt

from capture2vr.cli.deployment.tls_authority import write_private
from capture2vr.errors import BadInput

PASSPHRASE_VARIABLE = "CAPTURE2VR_BACKUP_PASSPHRASE"  # noqa: S105 - its name
"""Environment variable with the passphrase: on the command line others would read it."""

_SHORTEST = 12  # characters of a passphrase
_HEAD = b"capture2vr keys 1\n"
_TEXT = b"capture2vr secret 1"
_SALT_BYTES, _NONCE_BYTES, _KEY_BYTES = 16, 12, 32
_COST, _BLOCK, _LANES = 1 << 17, 8, 1  # of scrypt: 128 MiB and half a second for each guess (OWASP, 2023)
_MOST_BYTES = 1 << 20  # of all keys; more is some other folder


@dataclass(frozen=True, slots=True)
class KeyFile:
    """A file of the folder: its permission bits and bytes."""

    mode: int
    data: bytes


def passphrase() -> str:
    """Return the passphrase of the environment. Raises BadInput where it is missing or short."""
    found = os.environ.get(PASSPHRASE_VARIABLE, "")
    if len(found) < _SHORTEST:
        raise BadInput(
            f"set {PASSPHRASE_VARIABLE}, of at least {_SHORTEST} characters: keys and secrets are encrypted by it"
        )
    return found


def read_keys(folder: Path) -> dict[str, KeyFile]:
    """Read all files of a folder of keys, by their path in it, also those that it has links to.

    Raises BadInput, OSError.
    """
    if not folder.is_dir():
        raise BadInput(f"--keys {folder}: there is no such folder")
    paths = [path for path in sorted(folder.rglob("*")) if path.is_file()]
    if not paths or sum(path.stat().st_size for path in paths) > _MOST_BYTES:
        raise BadInput(f"--keys {folder}: this is no folder of keys, it has {len(paths):,} files")
    return {
        path.relative_to(folder).as_posix(): KeyFile(stat.S_IMODE(path.stat().st_mode), path.read_bytes())
        for path in paths
    }


def seal(keys: Mapping[str, KeyFile], secret: str) -> bytes:
    """Encrypt files by a passphrase."""
    packed = io.BytesIO()
    with tarfile.open(fileobj=packed, mode="w") as archive:
        for name, key in keys.items():
            member = tarfile.TarInfo(name)
            member.size, member.mode = len(key.data), key.mode
            archive.addfile(member, io.BytesIO(key.data))
    salt, nonce = os.urandom(_SALT_BYTES), os.urandom(_NONCE_BYTES)
    return _HEAD + salt + nonce + AESGCM(_derive(secret, salt)).encrypt(nonce, packed.getvalue(), _HEAD)


def unseal(sealed: bytes, secret: str) -> dict[str, KeyFile]:
    """Decrypt what `seal` has made. Raises BadInput where it is something else, or the passphrase is another one."""
    if not sealed.startswith(_HEAD):
        raise BadInput("the keys of this backup are in a form that this version does not know")
    body = memoryview(sealed)[len(_HEAD) :]
    salt, nonce = bytes(body[:_SALT_BYTES]), bytes(body[_SALT_BYTES : _SALT_BYTES + _NONCE_BYTES])
    try:
        packed = AESGCM(_derive(secret, salt)).decrypt(nonce, body[_SALT_BYTES + _NONCE_BYTES :], _HEAD)
    except InvalidTag:
        raise _wrong_passphrase() from None
    with tarfile.open(fileobj=io.BytesIO(packed)) as archive:
        return {member.name: KeyFile(member.mode, _content(archive, member)) for member in archive}


def sealer() -> Callable[[str], str] | None:
    """Return what encrypts single texts by the passphrase of the environment; None where there is none.

    Raises BadInput for a passphrase that is short.
    """
    if not os.environ.get(PASSPHRASE_VARIABLE):
        return None
    salt = os.urandom(_SALT_BYTES)
    cipher = AESGCM(_derive(passphrase(), salt))

    def seal_text(text: str) -> str:
        nonce = os.urandom(_NONCE_BYTES)
        return base64.b64encode(salt + nonce + cipher.encrypt(nonce, text.encode(), _TEXT)).decode()

    return seal_text


def unsealer(sample: str) -> Callable[[str], str] | None:
    """Return what decrypts the texts of the `sealer` that has made this one; None for "", which none has made.

    Raises BadInput where the passphrase is missing, or is another one.
    """
    if not sample:
        return None
    secret = passphrase()
    cipher_of = cache(lambda salt: AESGCM(_derive(secret, salt)))  # one for each backup: it takes half a second

    def unseal_text(sealed: str) -> str:
        body = base64.b64decode(sealed)
        salt, nonce = body[:_SALT_BYTES], body[_SALT_BYTES : _SALT_BYTES + _NONCE_BYTES]
        try:
            return str(cipher_of(salt).decrypt(nonce, body[_SALT_BYTES + _NONCE_BYTES :], _TEXT).decode())
        except InvalidTag:
            raise _wrong_passphrase() from None

    unseal_text(sample)
    return unseal_text


def _wrong_passphrase() -> BadInput:
    return BadInput(f"{PASSPHRASE_VARIABLE} is not the passphrase with which this backup was made")


def check_writable(keys: Mapping[str, KeyFile], folder: Path) -> None:
    """Raises BadInput where the folder has files that are others than these."""
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        if path.is_file() and (name not in keys or path.read_bytes() != keys[name].data):
            raise BadInput(f"--keys {folder}: it has {name} already, which is not of the backup: name an empty folder")


def write_keys(keys: Mapping[str, KeyFile], folder: Path) -> None:
    """Write the files into a folder, for their owner alone. Raises OSError."""
    for name, key in keys.items():
        path = folder / PurePosixPath(name)
        for parent in (*reversed(path.relative_to(folder).parents),):
            (folder / parent).mkdir(mode=0o700, parents=True, exist_ok=True)
        write_private(path, key.data)
        path.chmod(key.mode & 0o700 | key.mode & 0o044)


def _content(archive: tarfile.TarFile, member: tarfile.TarInfo) -> bytes:
    file = archive.extractfile(member)
    return file.read() if file else b""


def _derive(secret: str, salt: bytes) -> bytes:
    return Scrypt(salt, _KEY_BYTES, _COST, _BLOCK, _LANES).derive(secret.encode())
