"""Uploads behind gzip: what they hold is checked, cleaned and stored; kinds of files that only their names tell."""

from __future__ import annotations

import gzip
import io
import tarfile
import zipfile
from pathlib import Path

import pytest

from capture2vr.gateway.uploads.check_and_pack import CheckOrder, check_and_pack
from capture2vr.gateway.uploads.refusal import Refused
from capture2vr.gateway.uploads.sniff import Kind, sniff

CLOUD = b"ply\nformat ascii 1.0\nelement vertex 0\nend_header\n"


def check(folder: Path, files: dict[str, bytes], *, named: bool = True) -> dict[str, bytes]:
    """The files of the archive that an upload becomes."""
    for name, data in files.items():
        path = folder / "in" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
    order = CheckOrder(str(folder), list(files), named, 100, 1_000_000)
    with zipfile.ZipFile(check_and_pack(order, lambda name: None).archive) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def zipped(**files: bytes) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for name, data in files.items():
            archive.writestr(name, data)
    return buffer.getvalue()


def test_a_file_behind_gzip_is_stored_as_what_it_holds(tmp_path: Path) -> None:
    assert check(tmp_path, {"scan.ply.gz": gzip.compress(CLOUD)}) == {"scan.ply": CLOUD}


def test_so_it_is_in_a_zip_and_beside_others(tmp_path: Path) -> None:
    packed = gzip.compress(CLOUD)
    assert check(tmp_path / "a", {"a.zip": zipped(**{"scan.ply.gz": packed})}) == {"scan.ply": CLOUD}
    assert check(tmp_path / "b", {"scan.ply.gz": packed, "notes.txt": b"x"}) == {"scan.ply": CLOUD, "notes.txt": b"x"}


def test_splats_without_a_name_are_known_by_their_mark(tmp_path: Path) -> None:
    plain = b"NGSP\x03\0\0\0" + bytes(100)
    assert check(tmp_path, {"upload": gzip.compress(plain)}, named=False) == {"upload": plain}


def test_places_in_photos_behind_gzip_are_removed_too(tmp_path: Path) -> None:
    from tests.support.photos import private_pictures

    photo = private_pictures.jpeg()
    (stored,) = check(tmp_path, {"photo.jpg.gz": gzip.compress(photo)}).values()
    assert stored != photo
    assert stored.startswith(b"\xff\xd8\xff")


def _tar_gz() -> bytes:
    buffer = io.BytesIO()
    with tarfile.open(fileobj=buffer, mode="w:gz") as archive:
        archive.addfile(tarfile.TarInfo("a"))
    return buffer.getvalue()


@pytest.mark.parametrize(
    ("data", "code"),
    [
        (_tar_gz(), "CAPTURE_UNKNOWN_FORMAT"),
        (gzip.compress(zipped(a=b"1")), "CAPTURE_UNKNOWN_FORMAT"),
        (gzip.compress(CLOUD + bytes(3_000_000)), "ARCHIVE_BOMB"),
        (gzip.compress(CLOUD)[:-5], "ARCHIVE_BROKEN"),
        (gzip.compress(b""), "CAPTURE_EMPTY"),
    ],
    ids=["a tar", "a zip", "a bomb", "cut off", "nothing"],
)
def test_what_cannot_be_read_behind_gzip_is_refused(tmp_path: Path, data: bytes, code: str) -> None:
    with pytest.raises(Refused) as caught:
        check(tmp_path, {"scan.gz": data})
    assert caught.value.code == code


@pytest.mark.parametrize("name", ["hall.ptx", "garden.splat", "garden.ksplat", "garden.spz"])
def test_files_of_scans_and_splats_belong_to_captures(name: str) -> None:
    head = {"hall.ptx": b"10\n20\n0 0 0\n", "garden.splat": b"\0\x01\xfe" * 20, "garden.spz": b"NGSP\2\0\0\0"}.get(
        name, b"\0\1" + bytes(30)
    )
    assert sniff(name, head) is Kind.DATA
