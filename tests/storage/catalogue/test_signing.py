"""Keys and signatures: RFC 8032's own example, and everything that is no key."""

from __future__ import annotations

import base64
import os
import subprocess
import sys
from pathlib import Path

import pytest
from cryptography.hazmat.primitives import serialization as pem
from cryptography.hazmat.primitives.asymmetric import ec, ed25519
from hypothesis import given
from hypothesis import strategies as st

from capture2vr.process.strict_settings import SettingsError
from capture2vr.storage.catalogue.faults import KEY_UNKNOWN, SIGNATURE_MISSING, SIGNATURE_WRONG, CatalogueFault
from capture2vr.storage.catalogue.signing import (
    KeyFileError,
    Keys,
    Signer,
    check_signatures,
    generate_key,
    public_key,
    read_public_key,
    read_signer,
)
from capture2vr.storage.settings import StorageSettings, open_keys


def signer(seed: int = 0) -> Signer:
    private = ed25519.Ed25519PrivateKey.from_private_bytes(bytes([seed]) * 32)
    return Signer(public_key(private.public_key().public_bytes_raw()), private)


ONE, TWO = signer(1), signer(2)


def test_the_example_of_the_rfc() -> None:
    """RFC 8032, 7.1, test 2."""
    seed = bytes.fromhex("4ccd089b28ff96da9db6c346ec114e0f5b8a319f35aba624da8cf6ed4fb8a6fb")
    private = ed25519.Ed25519PrivateKey.from_private_bytes(seed)
    public = public_key(private.public_key().public_bytes_raw())
    assert public.raw.hex() == "3d4017c3e843895a92b70aa74d1b7ebc9c982ccf2ec4968cc0cd55f12af4660c"
    assert base64.b64decode(Signer(public, private).sign(b"\x72")["ed25519"]).hex() == (
        "92a009a9f0d4cab8720e820b5f642540a2b27b5416503f8fb3762223ebdb69da"
        "085ac1e43e15996e458f3613d0f11d8c387b2eaeb4302aeeb00d291612bb0c00"
    )


@given(text=st.binary(max_size=200), at=st.integers(0, 10_000))
def test_one_changed_bit_is_noticed(text: bytes, at: int) -> None:
    signature = ONE.sign(text)
    check_signatures("x", text, [signature], (ONE.public,))
    longer = text + b"!"
    changed = bytearray(longer)
    changed[at % len(longer)] ^= 1 << at % 8
    for other in (longer, bytes(changed)):
        with pytest.raises(CatalogueFault) as caught:
            check_signatures("x", other, [signature], (ONE.public,))
        assert caught.value.code == SIGNATURE_WRONG


@pytest.mark.parametrize("signature", ["", "!", "AAAA", base64.b64encode(bytes(64)).decode(), "é"])
def test_what_is_no_signature_is_a_wrong_one(signature: str) -> None:
    with pytest.raises(CatalogueFault) as caught:
        check_signatures("x", b"text", [{"key": ONE.public.id, "ed25519": signature}], (ONE.public,))
    assert caught.value.code == SIGNATURE_WRONG


def test_who_signed_matters() -> None:
    both = [ONE.sign(b"text"), TWO.sign(b"text")]
    for believed in ((ONE.public,), (TWO.public,), (ONE.public, TWO.public)):
        check_signatures("x", b"text", both, believed)
    check_signatures("x", b"text", [], ())
    for signatures, code in (([], SIGNATURE_MISSING), ([TWO.sign(b"text")], KEY_UNKNOWN)):
        with pytest.raises(CatalogueFault) as caught:
            check_signatures("x", b"text", signatures, (ONE.public,))
        assert caught.value.code == code


def test_a_key_signs_under_another_id_in_vain() -> None:
    forged = {**TWO.sign(b"text"), "key": ONE.public.id}
    with pytest.raises(CatalogueFault) as caught:
        check_signatures("x", b"text", [forged], (ONE.public,))
    assert caught.value.code == SIGNATURE_WRONG


def test_a_made_key_comes_back_from_its_files(tmp_path: Path) -> None:
    public = generate_key(tmp_path / "key")
    assert (tmp_path / "key").stat().st_mode & 0o777 == 0o600
    assert read_signer(tmp_path / "key").public == read_public_key(tmp_path / "key.pub") == public
    assert b"PRIVATE" not in (tmp_path / "key.pub").read_bytes()
    assert "private" not in repr(read_signer(tmp_path / "key"))


@pytest.mark.parametrize("taken", ["key", "key.pub"])
def test_no_key_is_overwritten(tmp_path: Path, taken: str) -> None:
    (tmp_path / taken).write_text("mine")
    with pytest.raises(FileExistsError, match="exists already"):
        generate_key(tmp_path / "key")
    assert [file.name for file in tmp_path.iterdir()] == [taken]
    assert (tmp_path / taken).read_text() == "mine"


def test_what_is_no_key_is_said(tmp_path: Path) -> None:
    generate_key(tmp_path / "key")
    other = ec.generate_private_key(ec.SECP256R1())
    plain, pkcs8 = pem.NoEncryption(), pem.PrivateFormat.PKCS8
    (tmp_path / "ec").write_bytes(other.private_bytes(pem.Encoding.PEM, pkcs8, plain))
    locked = ed25519.Ed25519PrivateKey.generate()
    (tmp_path / "locked").write_bytes(locked.private_bytes(pem.Encoding.PEM, pkcs8, pem.BestAvailableEncryption(b"x")))
    (tmp_path / "text").write_text("hello")
    for name in ("none", "text", "ec", "locked", "key.pub"):
        with pytest.raises(KeyFileError, match=name):
            read_signer(tmp_path / name)
    for name in ("none", "text", "ec", "key"):
        with pytest.raises(KeyFileError, match=name):
            read_public_key(tmp_path / name)


def test_keys_come_from_the_settings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    one, two = generate_key(tmp_path / "one"), generate_key(tmp_path / "two")
    monkeypatch.setenv("STORAGE_SIGNING_KEY", f"{tmp_path}/one")
    monkeypatch.setenv("STORAGE_TRUSTED_KEYS", f"{tmp_path}/one.pub,{tmp_path}/two.pub")
    keys = open_keys(StorageSettings())
    assert (keys.signers[0].public, keys.verification_keys) == (one, (one, two))
    assert open_keys(StorageSettings(signing_key=(), trusted_keys=())) == Keys()
    with pytest.raises(SettingsError, match=r"STORAGE_SIGNING_KEY.*nowhere"):
        open_keys(StorageSettings(signing_key=("nowhere",)))
    with pytest.raises(SettingsError, match=r"STORAGE_TRUSTED_KEYS.*one"):
        open_keys(StorageSettings(trusted_keys=(f"{tmp_path}/one",)))
    with pytest.raises(SettingsError, match="STORAGE_COLLECTION"):
        StorageSettings(collection="a/b")


def test_who_signs_nothing_need_not_load_cryptography() -> None:
    loaded = "import capture2vr.storage.catalogue.publish, capture2vr.storage.settings, sys"
    code = f"{loaded}; print('cryptography' in sys.modules)"
    done = subprocess.run(
        [sys.executable, "-c", code], env=dict(os.environ), capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "False"
