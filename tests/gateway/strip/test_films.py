"""Films keep every picture bit for bit and lose what tells who and where; what lies about its size is refused."""

from __future__ import annotations

import io
import struct
from collections.abc import Callable, Iterator
from pathlib import Path

import av
import pytest
from hypothesis import given
from hypothesis import strategies as st

from capture2vr.gateway.strip import matroska, mp4
from capture2vr.gateway.strip.in_place import CleanResult, UnreadableError
from tests.support.photos import private_pictures
from tests.support.photos.private_pictures import EBML, OPEN, OWNER, PLACE, box, element, handler

FRAMES = b"FRAMES" * 10
JUNK = PLACE * 2
Clean = Callable[[bytearray], CleanResult]

kinds = st.sampled_from([b"udta", b"meta", b"uuid", b"gps ", b"meco", b"XMP_", b"free", b"\0\0\0\1", b"GPMF"])
junk = st.lists(st.tuples(kinds, st.binary(max_size=20)), max_size=3).map(
    lambda found: b"".join(box(kind, JUNK, content) for kind, content in found)
)


def cleaned(clean: Clean, data: bytes) -> tuple[bytes, tuple[str, ...]]:
    buffer = bytearray(data)
    result = clean(buffer)
    assert result.length == len(buffer) == len(data)
    return bytes(buffer), result.removed


def filmed(*extra: bytes, media: bytes = FRAMES) -> bytes:
    """A film of one picture track; `extra` in its index."""
    moov = box(b"moov", box(b"mvhd", bytes(100)), box(b"trak", box(b"tkhd", bytes(84)), handler(b"vide")), *extra)
    return box(b"ftyp", b"isom", bytes(4)) + moov + box(b"mdat", media)


def places(chunk: int, size: int = len(PLACE), kind: bytes = b"meta", sizes: bytes = b"") -> bytes:
    """A metadata track, number 7, of one sample at the byte `chunk`. sizes: another table of sample sizes"""
    table = box(
        b"stbl",
        box(b"stsc", bytes(4), struct.pack(">I3I", 1, 1, 1, 1)),
        sizes or box(b"stsz", bytes(4), struct.pack(">III", 0, 1, size)),
        box(b"stco", bytes(4), struct.pack(">II", 1, chunk)),
    )
    header = box(b"tkhd", bytes(12), struct.pack(">I", 7), bytes(68))
    return box(b"trak", header, box(b"mdia", box(b"hdlr", bytes(8), kind, bytes(12)), box(b"minf", table)))


@given(top=junk, index=junk, track=junk, media=junk, frames=st.binary(min_size=1, max_size=60))
def test_whatever_is_added_goes_and_no_picture_changes(
    top: bytes, index: bytes, track: bytes, media: bytes, frames: bytes
) -> None:
    inner = box(b"mdia", box(b"hdlr", bytes(8), b"vide", bytes(12)), media)
    moov = box(b"moov", index, box(b"trak", box(b"tkhd", bytes(84)), track, inner))
    film = top + box(b"mdat", frames) + moov + top
    after, _ = cleaned(mp4.clean, film)
    assert PLACE not in after
    assert after[len(top) + 8 : len(top) + 8 + len(frames)] == frames
    assert cleaned(mp4.clean, after) == (after, ())


@given(data=st.data())
def test_a_damaged_index_never_reaches_the_pictures(data: st.DataObject) -> None:
    film = bytearray(private_pictures.film())
    media = film.index(b"mdat") + 4
    end = film.index(b"moov") - 4
    for _ in range(data.draw(st.integers(1, 6))):
        film[data.draw(st.integers(end, len(film) - 1))] = data.draw(st.integers(0, 255))
    before = bytes(film)
    try:
        result = mp4.clean(film)
    except UnreadableError:
        return
    assert end <= result.length <= len(before)
    has_lost_a_track = any(name.startswith("track") for name in result.removed)
    assert has_lost_a_track or film[media:end] == before[media:end]


def test_only_the_samples_of_the_removed_track_are_blanked() -> None:
    film = filmed(places(0), media=FRAMES + PLACE + FRAMES)
    film = filmed(places(film.index(PLACE)), media=FRAMES + PLACE + FRAMES)
    after, removed = cleaned(mp4.clean, film)
    assert after.endswith(FRAMES + bytes(len(PLACE)) + FRAMES)
    assert removed == ("track meta",)


@pytest.mark.parametrize(("bits", "entry"), [(4, b"\x90"), (8, b"\x09"), (16, b"\0\x09")])
def test_a_compact_table_of_sample_sizes_is_read(bits: int, entry: bytes) -> None:
    sizes = box(b"stz2", bytes(7), bytes((bits,)), struct.pack(">I", 1), entry)
    film = filmed(places(0, sizes=sizes), media=FRAMES + PLACE + FRAMES)
    film = filmed(places(film.index(PLACE), sizes=sizes), media=FRAMES + PLACE + FRAMES)
    assert cleaned(mp4.clean, film)[0].endswith(FRAMES + bytes(len(PLACE)) + FRAMES)


@pytest.mark.parametrize("behind", [b'vivo{"place":"' + PLACE + b'"}', PLACE[-3:], box(b"moof", PLACE * 9)[:-1]])
def test_what_is_no_box_behind_a_film_is_cut_off(behind: bytes) -> None:
    film = bytearray(filmed() + behind)
    assert mp4.clean(film) == CleanResult(("Trailer",), len(filmed()))
    assert film[: len(filmed())] == filmed()


spans = st.lists(st.tuples(st.integers(0, 60), st.integers(0, 60)), max_size=8)


@given(ranges=spans, media=st.lists(st.integers(0, 60), max_size=8, unique=True).map(sorted))
def test_samples_are_blanked_where_media_are_and_nowhere_else(ranges: list[tuple[int, int]], media: list[int]) -> None:
    places = list(zip(media[::2], media[1::2], strict=False))
    found = {at for start, end in mp4._clip_to_media(ranges, places) for at in range(start, end)}
    inside = {at for start, end in places for at in range(start, end)}
    assert found == inside & {at for start, end in ranges for at in range(start, end)}


def test_many_samples_among_many_pieces_of_media_cost_no_more_than_both() -> None:
    ranges, media = [(0, 10**9)] * 200_000, [(2 * at, 2 * at + 1) for at in range(100_000)]
    assert list(mp4._clip_to_media(ranges, media)) == media


def test_a_removed_track_may_have_empty_tables() -> None:
    tables = (box(kind, bytes(4 + length)) for kind, length in ((b"stsc", 4), (b"stsz", 8), (b"stco", 4)))
    media = box(b"mdia", box(b"hdlr", bytes(8), b"meta", bytes(12)), box(b"minf", box(b"stbl", *tables)))
    film = filmed(box(b"trak", box(b"tkhd", bytes(84)), media))
    assert cleaned(mp4.clean, film)[1] == ("track meta",)


@pytest.mark.parametrize("kind", [b"sbtl", b"text", b"GoPr", b"camm", b"mett"])
def test_tracks_that_are_no_picture_or_sound_go(kind: bytes) -> None:
    assert cleaned(mp4.clean, filmed(places(0, kind=kind)))[1] == (f"track {kind.decode()}",)


@pytest.mark.parametrize("kind", [b"soun", b"tmcd", b"auxv"])
def test_sound_and_depth_stay(kind: bytes) -> None:
    film = filmed(places(0, kind=kind))
    assert cleaned(mp4.clean, film) == (film, ())


def test_a_track_that_lies_about_its_samples_does_not_have_the_index_overwritten() -> None:
    after, _ = cleaned(mp4.clean, filmed(places(0, size=10_000)))
    assert b"moov" in after
    assert b"tkhd" in after
    assert after.startswith(box(b"ftyp", b"isom", bytes(4)))


def test_a_film_whose_end_is_missing_keeps_its_beginning() -> None:
    film = filmed(box(b"udta", PLACE))
    after, removed = cleaned(mp4.clean, film[:-20])
    assert after.endswith(FRAMES[:-20])
    assert (PLACE in after, removed) == (False, ("udta",))


def hostile() -> Iterator[tuple[str, Clean, bytes]]:
    index = filmed()[:-68]
    header = box(b"tfhd", bytes(4), struct.pack(">I", 7))
    yield "past the end", mp4.clean, index + struct.pack(">I4s", 0xFFFFFFFF, b"free")
    yield "huge", mp4.clean, index + struct.pack(">I4sQ", 1, b"udta", 1 << 63)
    yield "wraps", mp4.clean, index + struct.pack(">I4sQ", 1, b"udta", (1 << 64) - 8)
    yield "negative", mp4.clean, index + struct.pack(">I4s", 4, b"udta")
    yield "many boxes", mp4.clean, filmed() + box(b"free") * 100_001
    yield "inside", mp4.clean, filmed(struct.pack(">I4s", 9999, b"udta"))
    yield "no pictures", mp4.clean, box(b"moov", places(0))
    yield "no index", mp4.clean, box(b"mdat", FRAMES)
    yield "fragments", mp4.clean, filmed(places(0)) + box(b"moof", box(b"traf", header))
    segment = element(0x1654AE6B)
    yield "no header", matroska.clean, element(0x18538067, segment)
    yield "no segment", matroska.clean, EBML
    yield "no tracks", matroska.clean, EBML + element(0x18538067)
    yield "size", matroska.clean, EBML + element(0x18538067, segment, size=b"\x01" + b"\xff" * 6 + b"\xfe")
    yield "kind", matroska.clean, EBML + element(0x18538067, segment + b"\x00\x81\x00")
    yield "open tags", matroska.clean, EBML + element(0x18538067, segment, element(0x1254C367, PLACE, size=OPEN))
    yield "many", matroska.clean, EBML + element(0x18538067, segment, b"\xec\x80" * 400_000)
    number = element(0xAE, element(0x83, bytes(9)))
    yield "long number", matroska.clean, EBML + element(0x18538067, element(0x1654AE6B, number))


HOSTILE = {name: (clean, data) for name, clean, data in hostile()}


@pytest.mark.slow
@pytest.mark.parametrize("name", HOSTILE)
def test_what_lies_about_its_size_is_refused(name: str) -> None:
    clean, data = HOSTILE[name]
    with pytest.raises(UnreadableError):
        clean(bytearray(data))


@pytest.mark.parametrize("open_ended", [False, True])
def test_a_webm_keeps_its_blocks_and_loses_the_rest(open_ended: bool) -> None:
    before = private_pictures.webm(open_ended)
    after, removed = cleaned(matroska.clean, before)
    assert after.count(FRAMES) == before.count(FRAMES) == 4
    assert b"CRC4" not in after
    assert removed == ("Title", "Name", "track type 17", "Tags", "Attachments", "element A5", "BlockAdditions")


@given(cut=st.integers(0, len(private_pictures.webm()) - 1))
def test_a_cut_webm_is_refused_or_clean(cut: int) -> None:
    try:
        after, _ = cleaned(matroska.clean, private_pictures.webm(open_ended=True)[:cut])
    except UnreadableError:
        return
    assert PLACE not in after
    assert OWNER not in after


@pytest.mark.parametrize("options", [{}, {"live": "1"}])
@pytest.mark.parametrize("suffix", ["webm", "mkv"])
def test_a_real_webm_plays_the_same_frames(suffix: str, options: dict[str, str], tmp_path: Path) -> None:
    path = tmp_path / f"film.{suffix}"
    with av.open(str(path), "w", options=options) as container:
        container.metadata.update({"location": "+48.137154+011.575490/", "title": OWNER.decode()})
        stream = container.add_stream("libvpx", rate=10, options={"deadline": "realtime", "cpu-used": "8"})
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        for _ in range(5):
            container.mux(stream.encode(av.VideoFrame.from_image(private_pictures.picture())))
        container.mux(stream.encode())
    before = path.read_bytes()
    assert b"48.13" in before
    after, removed = cleaned(matroska.clean, before)
    assert b"48.13" not in after
    assert OWNER not in after
    assert {"Tags", "Title"} <= set(removed)

    def frames(data: bytes) -> list[bytes]:
        with av.open(io.BytesIO(data)) as film:
            assert data is before or not {"LOCATION", "title"} & film.metadata.keys()
            return [frame.to_ndarray().tobytes() for frame in film.decode(video=0)]

    assert frames(after) == frames(before)
    assert len(frames(after)) == 5
