"""Files behind gzip from strangers: what they hold takes their place, and no more than an archive may unpack to."""

from __future__ import annotations

import gzip
import io
import tarfile
from pathlib import Path

import pytest

from capture2vr.process.archives import ArchiveError, ArchiveLimits
from capture2vr.process.gunzip import gunzip, gunzip_all, gunzip_head, is_gzip, plain_name

TEXT = bytes(range(256)) * 40


def tar_gz() -> bytes:
    buffer = io.BytesIO()
    with tarfile.open(fileobj=buffer, mode="w:gz") as archive:
        archive.addfile(tarfile.TarInfo("a"))
    return buffer.getvalue()


def test_what_is_behind_gzip_takes_its_place(tmp_path: Path) -> None:
    files = {
        "a.ply.gz": gzip.compress(TEXT),
        "b.spz": gzip.compress(TEXT),
        "c.ply": TEXT,
        "sub/d.GZ": gzip.compress(TEXT[:999]) + gzip.compress(TEXT[999:]),  # two members are one content
        "e.tar.gz": tar_gz(),
        "f.gz": gzip.compress(TEXT),
        "f": b"another",
    }
    (tmp_path / "sub").mkdir()
    for name, data in files.items():
        (tmp_path / name).write_bytes(data)
    found = gunzip_all(tmp_path, list(files))
    assert found == ["a.ply", "b.spz", "c.ply", "sub/d", "e.tar.gz", "f.gz", "f"]
    assert {path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*") if path.is_file()} == set(found)
    assert all((tmp_path / name).read_bytes() == TEXT for name in found if name not in ("e.tar.gz", "f"))
    assert is_gzip(tmp_path / "e.tar.gz")


@pytest.mark.parametrize(
    ("size", "limits"), [(10_000, ArchiveLimits(total_bytes=9_999)), (20_000_000, ArchiveLimits(ratio=50))]
)
def test_a_bomb_is_refused(tmp_path: Path, size: int, limits: ArchiveLimits) -> None:
    (tmp_path / "a.gz").write_bytes(gzip.compress(bytes(size)))
    with pytest.raises(ArchiveError) as caught:
        gunzip(tmp_path / "a.gz", tmp_path / "plain", "a.gz", limits)
    assert (caught.value.code, caught.value.file) == ("ARCHIVE_BOMB", "a.gz")
    assert (tmp_path / "plain").stat().st_size <= max(limits.total_bytes, 1 << 20) + (1 << 20)


def test_all_files_behind_gzip_share_the_limit(tmp_path: Path) -> None:
    for name in ("a.gz", "b.gz"):
        (tmp_path / name).write_bytes(gzip.compress(bytes(6_000)))
    with pytest.raises(ArchiveError, match=r"b\.gz"):
        gunzip_all(tmp_path, ["a.gz", "b.gz"], ArchiveLimits(total_bytes=10_000))


@pytest.mark.parametrize(
    "data",
    [gzip.compress(TEXT)[:-9], gzip.compress(TEXT)[:-1] + b"x", gzip.compress(TEXT) + b"more", b"\x1f\x8b\x08"],
    ids=["cut off", "a wrong length", "more behind it", "nothing but its mark"],
)
def test_damage_is_told(tmp_path: Path, data: bytes) -> None:
    (tmp_path / "a.gz").write_bytes(data)
    with pytest.raises(ArchiveError) as caught:
        gunzip(tmp_path / "a.gz", tmp_path / "plain", "a.gz")
    assert caught.value.code == "ARCHIVE_BROKEN"
    assert caught.value.hints


def test_the_head_of_damage_is_what_comes_before_it(tmp_path: Path) -> None:
    (tmp_path / "a.gz").write_bytes(gzip.compress(TEXT)[:-9])
    assert gunzip_head(tmp_path / "a.gz", 100) == TEXT[:100]
    (tmp_path / "a.gz").write_bytes(b"\x1f\x8b\x08nonsense and more")
    assert gunzip_head(tmp_path / "a.gz", 100) == b""


def test_a_name_loses_its_ending() -> None:
    assert [plain_name(name) for name in ("a.ply.gz", "a.GZ", "a.spz", ".gz", "b/.gz", "b/c.gz")] == [
        "a.ply",
        "a",
        "a.spz",
        ".gz",
        "b/.gz",
        "b/c",
    ]
