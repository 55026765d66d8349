"""Archives from strangers: what is in a good one comes out, and nothing of a bad one stays."""

from __future__ import annotations

import io
import os
import stat
import struct
import tarfile
import warnings
import zipfile
from collections.abc import Mapping
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from capture2vr.process.archives import ArchiveError, ArchiveLimits, is_zip, pack, unpack

JPEG = b"\xff\xd8\xff\xe0" + bytes(range(256)) * 8


def zipped(path: Path, entries: Mapping[str | zipfile.ZipInfo, bytes], method: int = zipfile.ZIP_STORED) -> Path:
    with warnings.catch_warnings(), zipfile.ZipFile(path, "w", method) as archive:
        warnings.simplefilter("ignore")  # zipfile warns of duplicate names, which are the point here
        for name, content in entries.items():
            archive.writestr(name, content)
    return path


def assert_refused(code: str, archive: Path, limits: ArchiveLimits | None = None) -> ArchiveError:
    """It is refused by that code, and the folder around it is as it was."""
    before = sorted(archive.parent.rglob("*"))
    with pytest.raises(ArchiveError) as caught:
        unpack(archive, archive.parent / "into", limits or ArchiveLimits())
    assert caught.value.code == code, caught.value
    assert caught.value.hints
    assert sorted(archive.parent.rglob("*")) == before
    return caught.value


def names(folder: Path, files: list[Path]) -> list[str]:
    return [file.relative_to(folder).as_posix() for file in files]


def test_files_come_out_as_they_went_in(tmp_path: Path) -> None:
    archive = zipped(
        tmp_path / "a.zip", {"b/2.jpg": JPEG, "a.json": b"{}", "b/1.jpg": JPEG + b"1"}, zipfile.ZIP_DEFLATED
    )
    files = unpack(archive, tmp_path / "into")
    assert names(tmp_path / "into", files) == ["a.json", "b/1.jpg", "b/2.jpg"]
    assert (tmp_path / "into" / "b" / "1.jpg").read_bytes() == JPEG + b"1"


def test_a_name_that_is_no_unicode_is_packed_all_the_same(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / os.fsdecode(b"caf\xe9.ply")).write_bytes(b"ply\n")
    pack(tmp_path / "in", tmp_path / "a.zip")
    assert names(tmp_path / "into", unpack(tmp_path / "a.zip", tmp_path / "into")) == ["caf\ufffd.ply"]


def test_an_empty_folder_may_be_there_already(tmp_path: Path) -> None:
    (tmp_path / "into").mkdir()
    assert len(unpack(zipped(tmp_path / "a.zip", {"a": b"1"}), tmp_path / "into")) == 1


def test_a_full_folder_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "into").mkdir()
    (tmp_path / "into" / "mine").write_text("keep")
    with pytest.raises(OSError, match="not empty"):
        unpack(zipped(tmp_path / "a.zip", {"a": b"1"}), tmp_path / "into")
    assert [path.name for path in sorted(tmp_path.iterdir())] == ["a.zip", "into"]


def test_one_top_folder_is_stripped(tmp_path: Path) -> None:
    archive = zipped(tmp_path / "a.zip", {"scan/": b"", "scan/a.json": b"{}", "scan/depth/1.png": b"1"})
    assert names(tmp_path / "into", unpack(archive, tmp_path / "into")) == ["a.json", "depth/1.png"]


def test_two_top_folders_stay(tmp_path: Path) -> None:
    archive = zipped(tmp_path / "a.zip", {"rgb/1.jpg": b"1", "depth/1.png": b"1"})
    assert names(tmp_path / "into", unpack(archive, tmp_path / "into")) == ["depth/1.png", "rgb/1.jpg"]


def test_what_systems_leave_in_zips_is_dropped(tmp_path: Path) -> None:
    junk = {"__MACOSX/scan/._a.jpg": b"x", "scan/.DS_Store": b"x", "scan/Thumbs.db": b"x", ".git/config": b"x"}
    junk |= {"scan/Icon\r": b"x", "__MACOSX/scan/._Icon\r": b"x"}
    archive = zipped(tmp_path / "a.zip", {**junk, "scan/a.jpg": JPEG})
    assert names(tmp_path / "into", unpack(archive, tmp_path / "into")) == ["a.jpg"]


def test_backslashes_are_folders(tmp_path: Path) -> None:
    archive = zipped(tmp_path / "a.zip", {"scan\\": b"", "scan\\a.json": b"{}", "scan\\depth\\1.png": b"1"})
    assert names(tmp_path / "into", unpack(archive, tmp_path / "into")) == ["a.json", "depth/1.png"]


@pytest.mark.parametrize("stored", ["utf-8", "cp437", "cp1252"])
def test_names_without_the_flag_of_their_encoding_are_read(stored: str, tmp_path: Path) -> None:
    archive = zipped(tmp_path / "a.zip", {"M_bel.obj": b"v", "b": b"1"})
    written = "Möbel.obj".encode(stored)
    data = zipped(tmp_path / "a.zip", {"M" + "_" * (len(written) - 8) + "bel.obj": b"v", "b": b"1"}).read_bytes()
    archive.write_bytes(data.replace(b"M" + b"_" * (len(written) - 8) + b"bel.obj", written))
    assert names(tmp_path / "into", unpack(archive, tmp_path / "into")) == ["Möbel.obj", "b"]


def test_composed_and_decomposed_names_are_one(tmp_path: Path) -> None:
    archive = zipped(tmp_path / "a.zip", {"Mo\u0308bel.obj": b"v", "b": b"1"})
    assert names(tmp_path / "into", unpack(archive, tmp_path / "into")) == ["M\u00f6bel.obj", "b"]


def test_a_record3d_archive_is_an_ordinary_one(tmp_path: Path) -> None:
    archive = zipped(tmp_path / "a.r3d", {"metadata": b"{}", "rgbd/0.jpg": JPEG, "rgbd/0.depth": b"bvx2"})
    assert names(tmp_path / "into", unpack(archive, tmp_path / "into")) == ["metadata", "rgbd/0.depth", "rgbd/0.jpg"]


@pytest.mark.parametrize(
    "name",
    [
        "../a",
        "a/../../b",
        "a/..",
        "/etc/passwd",
        "//server/a",
        "C:/a",
        "c:a",
        "..\\a",
        "a\\..\\b",
        "\\\\server\\a",
        "C:\\a",
    ],
)
def test_a_name_that_leads_out_is_refused(tmp_path: Path, name: str) -> None:
    error = assert_refused("ARCHIVE_TRAVERSAL", zipped(tmp_path / "a.zip", {"good": b"1", name: b"evil"}))
    assert error.file


@pytest.mark.parametrize("kind", [stat.S_IFLNK, stat.S_IFIFO, stat.S_IFCHR, stat.S_IFSOCK])
def test_links_and_devices_are_refused(tmp_path: Path, kind: int) -> None:
    info = zipfile.ZipInfo("link")
    info.external_attr = (kind | 0o777) << 16
    error = assert_refused("ARCHIVE_TRAVERSAL", zipped(tmp_path / "a.zip", {info: b"/etc/passwd"}))
    assert error.file == "link"


def test_a_bomb_is_refused_by_its_ratio(tmp_path: Path) -> None:
    archive = zipped(tmp_path / "a.zip", {"a": JPEG, "bomb": bytes(8 << 20)}, zipfile.ZIP_DEFLATED)
    assert assert_refused("ARCHIVE_BOMB", archive).file == "bomb"


def test_a_small_text_may_shrink_a_lot(tmp_path: Path) -> None:
    archive = zipped(tmp_path / "a.zip", {"poses.csv": b"0" * (1 << 19)}, zipfile.ZIP_DEFLATED)
    assert archive.stat().st_size * 200 < 1 << 19
    assert len(unpack(archive, tmp_path / "into")) == 1


def test_many_small_bombs_are_one(tmp_path: Path) -> None:
    """Each entry stays below the floor; together they do not."""
    archive = zipped(tmp_path / "a.zip", {f"{n}": bytes(1 << 20) for n in range(64)}, zipfile.ZIP_DEFLATED)
    assert_refused("ARCHIVE_BOMB", archive)


def test_entries_that_share_their_bytes_are_a_bomb(tmp_path: Path) -> None:
    """Fifield's construction: many directory entries point at one kernel, so that no single ratio is remarkable."""
    content = bytes(range(256)) * 4096  # 1 MiB, deflates by about 90
    single = io.BytesIO()
    with zipfile.ZipFile(single, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("a", content)
    data = single.getvalue()
    start, size = struct.unpack_from("<I", data, len(data) - 6)[0], struct.unpack_from("<I", data, len(data) - 10)[0]
    record = data[start : start + size]
    end = struct.pack("<4sHHHHIIH", b"PK\5\6", 0, 0, 200, 200, size * 200, start, 0)
    (tmp_path / "a.zip").write_bytes(data[:start] + record * 200 + end)
    error = assert_refused(
        "ARCHIVE_BROKEN", tmp_path / "a.zip"
    )  # the name repeats; only zipfile's own check forbids more
    assert "two files of this name" in error.message


def test_the_total_is_limited(tmp_path: Path) -> None:
    archive = zipped(tmp_path / "a.zip", {"a": JPEG, "b": JPEG})
    assert_refused("ARCHIVE_BOMB", archive, ArchiveLimits(total_bytes=len(JPEG) * 2 - 1))


def test_too_many_entries_are_refused(tmp_path: Path) -> None:
    archive = zipped(tmp_path / "a.zip", {f"{n}": b"" for n in range(11)})
    assert_refused("ARCHIVE_TOO_MANY_ENTRIES", archive, ArchiveLimits(entries=10))
    assert len(unpack(archive, tmp_path / "into", ArchiveLimits(entries=11))) == 11


@pytest.mark.parametrize("claimed", ["32 bits", "64 bits"])
def test_an_endless_directory_is_not_even_read(tmp_path: Path, claimed: str) -> None:
    archive = zipped(tmp_path / "a.zip", {f"{n}-{'x' * 200}": b"" for n in range(120)})
    if claimed == "64 bits":
        archive.write_bytes(_as_zip64(archive.read_bytes()))
    error = assert_refused("ARCHIVE_TOO_MANY_ENTRIES", archive, ArchiveLimits(entries=10))
    assert "list of files" in error.message


def _as_zip64(data: bytes) -> bytes:
    """The same archive with its end record in the 64-bit form."""
    *_, count, size, start, _ = struct.unpack("<4sHHHHIIH", data[-22:])
    end = len(data) - 22
    wide = struct.pack("<4sQHHIIQQQQ", b"PK\6\6", 44, 45, 45, 0, 0, count, count, size, start)
    locator = struct.pack("<4sIQI", b"PK\6\7", 0, end, 1)
    narrow = struct.pack("<4sHHHHIIH", b"PK\5\6", 0, 0, 0xFFFF, 0xFFFF, 0xFFFFFFFF, 0xFFFFFFFF, 0)
    return data[:end] + wide + locator + narrow


def test_a_64_bit_archive_is_read(tmp_path: Path) -> None:
    archive = zipped(tmp_path / "a.zip", {"a": b"1"})
    archive.write_bytes(_as_zip64(archive.read_bytes()))
    assert len(unpack(archive, tmp_path / "into")) == 1


def _tar() -> bytes:
    buffer = io.BytesIO()
    with tarfile.open(fileobj=buffer, mode="w") as archive:
        info = tarfile.TarInfo("a")
        info.size = 3
        archive.addfile(info, io.BytesIO(b"abc"))
    return buffer.getvalue()


def _zip() -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        archive.writestr("a", b"1")
    return buffer.getvalue()


@pytest.mark.parametrize(
    "content",
    [_zip(), _tar(), b"7z\xbc\xaf\x27\x1c" + bytes(9), b"Rar!\x1a\x07\x01\x00", b"\xfd7zXZ\x00"],
    ids=["zip", "tar", "7z", "rar", "xz"],
)
def test_an_archive_inside_is_known_by_its_content(tmp_path: Path, content: bytes) -> None:
    error = assert_refused("ARCHIVE_NESTED", zipped(tmp_path / "a.zip", {"good.jpg": JPEG, "photo.jpg": content}))
    assert error.file == "photo.jpg"


def test_a_path_that_no_file_system_takes_is_refused(tmp_path: Path) -> None:
    deep = "/".join(["folder" * 20] * 50)
    assert_refused("ARCHIVE_BROKEN", zipped(tmp_path / "a.zip", {f"{deep}/a.jpg": JPEG}))


def test_a_name_twice_is_refused(tmp_path: Path) -> None:
    archive = zipped(tmp_path / "a.zip", {zipfile.ZipInfo("a"): b"1", zipfile.ZipInfo("./a"): b"2"})
    assert_refused("ARCHIVE_BROKEN", archive)


def test_a_file_that_is_also_a_folder_is_refused(tmp_path: Path) -> None:
    assert_refused("ARCHIVE_BROKEN", zipped(tmp_path / "a.zip", {"a": b"1", "a/b": b"2"}))


def test_a_wrong_checksum_is_refused(tmp_path: Path) -> None:
    archive = zipped(tmp_path / "a.zip", {"good": b"1", "bad": JPEG})
    data = bytearray(archive.read_bytes())
    data[data.index(JPEG) + 100] ^= 1
    archive.write_bytes(data)
    assert assert_refused("ARCHIVE_BROKEN", archive).file == "bad"


@pytest.mark.parametrize("claimed", [10, 5000])
def test_a_lie_about_the_size_is_refused(tmp_path: Path, claimed: int) -> None:
    archive = zipped(tmp_path / "a.zip", {"a": JPEG}, zipfile.ZIP_DEFLATED)
    data = bytearray(archive.read_bytes())
    directory = data.rindex(b"PK\x01\x02")
    struct.pack_into("<I", data, directory + 24, claimed)
    archive.write_bytes(data)
    assert_refused("ARCHIVE_BROKEN", archive)


def test_an_encrypted_archive_is_refused(tmp_path: Path) -> None:
    archive = zipped(tmp_path / "a.zip", {"a": JPEG})
    data = bytearray(archive.read_bytes())
    data[data.rindex(b"PK\x01\x02") + 8] |= 1
    archive.write_bytes(data)
    assert "encrypted" in assert_refused("ARCHIVE_BROKEN", archive).message


@pytest.mark.parametrize("method", [zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_methods_that_no_phone_writes_are_refused(tmp_path: Path, method: int) -> None:
    assert_refused("ARCHIVE_BROKEN", zipped(tmp_path / "a.zip", {"a": JPEG}, method))


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04", b"no zip at all" * 10, b"PK\x05\x06"])
def test_what_is_no_zip_is_refused(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "a.zip").write_bytes(content)
    assert_refused("ARCHIVE_BROKEN", tmp_path / "a.zip")


def test_a_cut_archive_is_refused_wherever_it_is_cut(tmp_path: Path) -> None:
    whole = zipped(tmp_path / "a.zip", {"a": JPEG, "b": JPEG}).read_bytes()
    for end in range(0, len(whole), 61):
        (tmp_path / "a.zip").write_bytes(whole[:end])
        assert_refused("ARCHIVE_BROKEN", tmp_path / "a.zip")


@pytest.mark.slow
@settings(max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_damage_is_an_archive_error_or_harmless(tmp_path: Path, data: st.DataObject) -> None:
    """Whatever bytes are turned over, nothing but ArchiveError comes out and nothing is left behind."""
    content = bytearray(DAMAGED)
    for _ in range(data.draw(st.integers(1, 4))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    folder = tmp_path / "one"
    folder.mkdir(exist_ok=True)
    (folder / "a.zip").write_bytes(content)
    try:
        for file in unpack(folder / "a.zip", folder / "into"):
            assert (folder / "into") in file.resolve().parents
            file.unlink()
    except ArchiveError:
        assert [path.name for path in folder.iterdir()] == ["a.zip"]
    else:
        for path in sorted((folder / "into").rglob("*"), reverse=True):
            path.rmdir()
        (folder / "into").rmdir()


def _small_zip() -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("scan/a.json", b'{"a": 1}' * 20)
        archive.writestr("scan/b.bin", bytes(range(64)))
    return buffer.getvalue()


DAMAGED = _small_zip()

FILES = st.dictionaries(
    st.from_regex(r"[a-z]{1,4}(/[a-z]{1,4}){0,2}\.bin", fullmatch=True),
    st.binary(max_size=200).map(b"raw ".__add__),
    min_size=2,
    max_size=8,
)


@settings(max_examples=30, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(files=FILES)
def test_pack_then_unpack_is_the_identity(tmp_path: Path, files: dict[str, bytes]) -> None:
    root = tmp_path / str(abs(hash(frozenset(files.items()))))
    files = {"top.bin": b"so that no top folder is stripped", **files}
    for name, content in files.items():
        (root / "in" / name).parent.mkdir(parents=True, exist_ok=True)
        (root / "in" / name).write_bytes(content)
    pack(root / "in", root / "a.zip")
    into = root / f"out{len(list(root.iterdir()))}"
    unpacked = {file.relative_to(into).as_posix(): file.read_bytes() for file in unpack(root / "a.zip", into)}
    assert unpacked == files


def test_pack_is_deterministic(tmp_path: Path) -> None:
    archives = []
    for number, order in enumerate((("a", "b/c"), ("b/c", "a"))):
        folder = tmp_path / str(number)
        (folder / "b").mkdir(parents=True)
        for name in order:
            (folder / name).write_text(name)
        pack(folder, tmp_path / f"{number}.zip")
        archives.append((tmp_path / f"{number}.zip").read_bytes())
    assert archives[0] == archives[1]
    assert is_zip(tmp_path / "0.zip")


def test_one_file_is_packed_under_its_name(tmp_path: Path) -> None:
    (tmp_path / "leaf.ply").write_bytes(b"ply")
    pack(tmp_path / "leaf.ply", tmp_path / "a.zip")
    assert names(tmp_path / "into", unpack(tmp_path / "a.zip", tmp_path / "into")) == ["leaf.ply"]
