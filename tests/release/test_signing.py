"""Signatures: only a listed Ed25519 key signs, and what was altered does not verify."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from release.errors import ReleaseError
from release.signing import ALLOWED_SIGNERS, sign, verify
from tests.conftest import missing
from tests.support.release_project import make_key


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """A repository whose release/allowed_signers has the key `good`, and a file to sign."""
    if shutil.which("ssh-keygen") is None:
        missing("ssh-keygen")
    (tmp_path / ALLOWED_SIGNERS).parent.mkdir()
    (tmp_path / ALLOWED_SIGNERS).write_text("# who may sign\n" + make_key(tmp_path / "good"))
    (tmp_path / "SHA256SUMS").write_text("0123  wheel\n")
    return tmp_path


def test_a_listed_key_signs(root: Path) -> None:
    signature = sign(root, root / "SHA256SUMS", root / "good")
    assert signature == root / "SHA256SUMS.sig"
    verify(root / ALLOWED_SIGNERS, root / "SHA256SUMS")
    sign(root, root / "SHA256SUMS", root / "good")  # again: the signature is replaced


def test_what_was_altered_does_not_verify(root: Path) -> None:
    sign(root, root / "SHA256SUMS", root / "good")
    (root / "SHA256SUMS").write_text("0124  wheel\n")
    with pytest.raises(ReleaseError, match=r"SHA256SUMS\.sig is not by a key of"):
        verify(root / ALLOWED_SIGNERS, root / "SHA256SUMS")


def test_a_key_that_is_not_listed_leaves_no_signature(root: Path) -> None:
    make_key(root / "other")
    with pytest.raises(ReleaseError, match=r"docs/releasing\.md"):
        sign(root, root / "SHA256SUMS", root / "other")
    assert not (root / "SHA256SUMS.sig").exists()


def test_a_signature_for_another_purpose_is_refused(root: Path) -> None:
    """The line of allowed_signers names the purpose, so that a key's other signatures are worth nothing here."""
    line = (root / ALLOWED_SIGNERS).read_text()
    (root / ALLOWED_SIGNERS).write_text(line.replace("capture2vr-release", "git"))
    with pytest.raises(ReleaseError, match="is not by a key of"):
        sign(root, root / "SHA256SUMS", root / "good")


def test_a_listed_key_of_another_kind_is_refused(root: Path) -> None:
    (root / ALLOWED_SIGNERS).write_text(make_key(root / "curve", "ecdsa"))
    with pytest.raises(ReleaseError, match="not an Ed25519 key"):
        sign(root, root / "SHA256SUMS", root / "curve")


def test_without_a_list_nothing_is_signed(root: Path) -> None:
    (root / ALLOWED_SIGNERS).unlink()
    with pytest.raises(ReleaseError, match=r"allowed_signers does not exist: docs/releasing\.md"):
        sign(root, root / "SHA256SUMS", root / "good")
