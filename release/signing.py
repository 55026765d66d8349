"""Sign a release and verify its signature, by OpenSSH's ssh-keygen, which every machine has.

The public keys that may sign stand in release/allowed_signers, a file in the form of ssh-keygen(1), ALLOWED SIGNERS.
"""

from __future__ import annotations

from pathlib import Path

from release.errors import ReleaseError
from release.process import output_of

IDENTITY = "capture2vr"
NAMESPACE = "capture2vr-release"
"""What a signature is for: one made for another purpose with the same key is refused."""
ALLOWED_SIGNERS = Path("release", "allowed_signers")
_KEYGEN = ("ssh-keygen", "-Y")
_KEY_TYPES = ("ssh-ed25519", "sk-ssh-ed25519@openssh.com")


def sign(root: Path, file: Path, key: Path) -> Path:
    """Sign a file -> FILE.sig, verified. Raises ReleaseError where the key is not one that may sign."""
    signature = file.with_name(f"{file.name}.sig")
    signature.unlink(missing_ok=True)
    # A passphrase is asked for at the terminal.
    output_of([*_KEYGEN, "sign", "-f", str(key), "-n", NAMESPACE, str(file)], f"{key} cannot sign")
    try:
        verify(root / ALLOWED_SIGNERS, file)
    except ReleaseError:
        signature.unlink()
        raise
    return signature


def verify(allowed_signers: Path, file: Path) -> None:
    """Check the signature FILE.sig. Raises ReleaseError where it is not that of an Ed25519 key that may sign."""
    if not allowed_signers.is_file():
        raise ReleaseError(f"{allowed_signers} does not exist: docs/releasing.md tells how to make it")
    listed = [line.split() for line in allowed_signers.read_text().splitlines() if line.strip()[:1] not in ("", "#")]
    if others := [" ".join(line) for line in listed if not set(_KEY_TYPES) & set(line)]:
        raise ReleaseError(f"{allowed_signers} names a key that is not an Ed25519 key, remove it: {others[0]}")
    options = ["-f", str(allowed_signers), "-I", IDENTITY, "-n", NAMESPACE, "-s", f"{file}.sig"]
    why = f"{file.name}.sig is not by a key of {allowed_signers} (docs/releasing.md tells how to add one)"
    output_of([*_KEYGEN, "verify", *options], why, content=file.read_text())
