"""Films of every container and codec: their key frames are the pictures that went in, sharp and spread; bad ones have
names, and nothing hangs."""

from __future__ import annotations

import itertools
import struct
import time
from collections.abc import Callable, Iterator, Sequence
from fractions import Fraction
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import av
import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from capture2vr.edge.cameras.screening import screen
from capture2vr.edge.cameras.structure_from_motion import align
from capture2vr.edge.capture.nouns import Capture, Photo
from capture2vr.edge.errors import Cancelled, CaptureError
from capture2vr.edge.films import film_scan, video_streams
from capture2vr.edge.films.keyframes import MAX_KEY_FRAMES, MIN_PATH, PathTracker, ScannedFrame, key_frames
from capture2vr.edge.films.video import VideoFrames
from capture2vr.edge.read_capture import read_capture
from tests.support.captures import turn_film
from tests.support.photos.spherical_films import spherical
from tests.support.photos.walkaround import render_walkaround

WIDTH, HEIGHT, RATE = 320, 240, 30
STEP = 6  # pixels from picture to picture: 0.019 of the width, 60 pictures are a way of 1.1
AV_ERROR = 4.0  # mean difference in 8-bit steps that these encoders make; pictures next to each other differ by 20


def wide(columns: int) -> np.ndarray:
    """(HEIGHT,columns,3) uint8: a wall with spots of all sizes, and soft colours, of which films keep a quarter."""
    rng = np.random.default_rng(1)
    sizes = [(HEIGHT // cell + 2, columns // cell + 2) for cell in (4, 8, 16, 32, 64)]
    tones = sum(cv2.resize(rng.normal(size=size), (columns, HEIGHT), interpolation=cv2.INTER_CUBIC) for size in sizes)
    tints = cv2.resize(rng.normal(size=(*sizes[-1], 3)), (columns, HEIGHT), interpolation=cv2.INTER_CUBIC)
    return np.clip(128 + 24 * tones[..., None] + 16 * tints, 0, 255).astype(np.uint8)


WALL = wide(WIDTH + 90 * STEP)


def view(number: float) -> np.ndarray:
    """(HEIGHT,WIDTH,3): what a camera sees that moves along the wall."""
    at = round(number * STEP)
    return WALL[:, at : at + WIDTH].copy()


VIEWS = [view(number) for number in range(60)]

Options = dict[str, str]
FAST: dict[str, Options] = {
    "libx264": {"preset": "veryfast", "crf": "16"},
    "libx265": {"preset": "ultrafast", "crf": "14", "x265-params": "log-level=none:bframes=4:keyint=20"},
    "libvpx-vp9": {"deadline": "realtime", "cpu-used": "8", "crf": "16"},
    "mpeg4": {"qscale": "2", "b": "8000000"},
}


def encode(
    path: Path,
    pictures: Sequence[np.ndarray],
    codec: str = "libx264",
    *,
    container: Options | None = None,
    pixels: str = "yuv420p",
    stamps: Sequence[int] | None = None,
    group: int = 20,
) -> Path:
    """stamps: in 1/600 s, else 30 a second; group: pictures from a key frame to the next."""
    with av.open(str(path), "w", options=container or {}) as target:
        stream = target.add_stream(codec, rate=RATE, options=FAST[codec])
        stream.height, stream.width = pictures[0].shape[:2]
        stream.pix_fmt, stream.codec_context.gop_size = pixels, group
        stream.codec_context.time_base = Fraction(1, 600)
        for number, rgb in enumerate(pictures):
            frame = av.VideoFrame.from_ndarray(rgb, format="rgb24")
            frame.pts, frame.time_base = (stamps[number] if stamps else 20 * number), Fraction(1, 600)
            target.mux(stream.encode(frame))
        target.mux(stream.encode())
    return path


@settings(max_examples=20, deadline=None)
@given(st.integers(1, 24))
def test_the_speed_of_the_picture_is_how_far_it_moves(pixels: int) -> None:
    tracker = PathTracker()
    for number in range(2):
        tracker.track(cv2.cvtColor(np.ascontiguousarray(WALL[:, pixels * number :][:, :WIDTH]), cv2.COLOR_RGB2GRAY))
    assert tracker.step == pytest.approx(pixels / WIDTH, rel=0.05)


def second(photo: Photo) -> float:
    return float(photo.name.rsplit(" at ", 1)[1].removesuffix(" s"))


def assert_shows(photo: Photo, expected: np.ndarray) -> None:
    assert np.abs(photo.load().astype(int) - expected).mean() < AV_ERROR


def assert_shows_its_moment(photos: Sequence[Photo], pictures: Sequence[np.ndarray]) -> None:
    for photo in photos:
        assert_shows(photo, pictures[round(second(photo) * RATE)])


FILMS: dict[str, tuple[str, Callable[[Path, Sequence[np.ndarray]], Path]]] = {
    "H.264": ("a.mp4", encode),
    "H.264, index first": ("a.m4v", partial(encode, container={"movflags": "faststart"})),
    "H.264 in pieces": ("a.mp4", partial(encode, container={"movflags": "frag_keyframe+empty_moov"})),
    "H.264 in one group": ("a.mov", partial(encode, group=250)),
    "HEVC": ("a.mov", partial(encode, codec="libx265")),
    "HEVC of 10 bits": ("a.mp4", partial(encode, codec="libx265", pixels="yuv420p10le")),
    "MPEG-4": ("a.mp4", partial(encode, codec="mpeg4")),
    "VP9": ("a.webm", partial(encode, codec="libvpx-vp9")),
    "Matroska": ("a.mkv", encode),
}


@pytest.fixture(scope="module")
def flat_film(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """A video of 2:1."""
    return encode(tmp_path_factory.mktemp("flat") / "a.mp4", [each[:160] for each in VIEWS]).read_bytes()


@pytest.mark.parametrize(("step", "swept"), [(4, False), (16, True)])
def test_a_fast_pan_is_named(step: int, swept: bool, tmp_path: Path) -> None:
    """Of 30 pictures a second, 320 wide: 0.4 and 1.5 of the width in a second."""
    shown = wide(WIDTH + 40 * step)
    encode(tmp_path / "a.mp4", [shown[:, step * number :][:, :WIDTH] for number in range(40)])
    told = " ".join(read_capture(tmp_path).warnings)
    assert ("rolling shutter" in told) == swept


def test_frames_of_all_sides_are_split_as_panoramas_are(flat_film: bytes, tmp_path: Path) -> None:
    (tmp_path / "a.mp4").write_bytes(flat_film)
    plain = read_capture(tmp_path).photos
    spherical(tmp_path / "a.mp4")
    capture = read_capture(tmp_path)
    assert {photo.name.split("@")[0] for photo in capture.photos} == {photo.name for photo in plain}
    assert len(capture.photos) == 8 * len(plain)
    assert "all 360 degrees" in capture.warnings[0]
    ahead = next(photo for photo in capture.photos if photo.name == f"{plain[3].name}@000")
    assert (ahead.size, ahead.focal_px) == ((80, 80), 40)
    assert np.abs(ahead.load()[40, 40].astype(int) - plain[3].load()[80, 160]).max() < 12


@pytest.mark.parametrize("stereo", ["top-bottom", "left-right"])
def test_a_video_of_all_sides_for_each_eye_is_refused_by_its_name(
    stereo: str, flat_film: bytes, tmp_path: Path
) -> None:
    (tmp_path / "a.mp4").write_bytes(flat_film)
    spherical(tmp_path / "a.mp4", stereo)
    with pytest.raises(CaptureError, match="360° video of a kind that is not read"):
        read_capture(tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("kind", FILMS)
def test_key_frames_are_photos(kind: str, tmp_path: Path) -> None:
    name, make = FILMS[kind]
    capture = read_capture(make(tmp_path / name, VIEWS))
    assert (capture.kind, capture.format, capture.warnings, capture.scale_confidence) == (
        "photos",
        "video",
        (),
        "unknown",
    )
    assert 16 <= len(capture.photos) <= 30
    assert [second(photo) for photo in capture.photos] == sorted({second(photo) for photo in capture.photos})
    assert len({photo.camera for photo in capture.photos}) == 1
    for photo in capture.photos:
        assert (photo.size, photo.focal_px, photo.turns, photo.camera_to_world) == ((WIDTH, HEIGHT), None, 0, None)
    shuffled = [capture.photos[index] for index in np.random.default_rng(0).permutation(len(capture.photos))]
    assert_shows_its_moment(shuffled, VIEWS)
    assert capture.photos[0].load(100).shape == (75, 100, 3)


@pytest.mark.slow
def test_a_walk_filmed_is_placed(tmp_path: Path) -> None:
    """From a rendered walk to cameras: none is a copy of another, and all find their place."""
    walk = render_walkaround(tmp_path / "walk", views=20, size=(400, 300), arc=80)
    pictures = [np.ascontiguousarray(cv2.imread(str(path))[..., ::-1]) for path in walk.photos]
    capture = read_capture(encode(tmp_path / "walk.mp4", pictures, stamps=range(0, 20 * 60, 60)))
    kept, verdicts = screen(capture.photos, tick=lambda fraction: None)
    assert verdicts == ()
    assert len(align(kept).views) == len(capture.photos) >= 12


@pytest.mark.parametrize("turns", range(4))
def test_a_phone_held_upright_is_told_and_not_turned(turns: int, tmp_path: Path) -> None:
    path = turn_film(encode(tmp_path / "a.mp4", VIEWS[:20]), turns)
    capture = read_capture(path)
    assert {photo.turns for photo in capture.photos} == {turns}
    assert_shows_its_moment(capture.photos, VIEWS)


def test_a_variable_frame_rate(tmp_path: Path) -> None:
    stamps = np.cumsum(np.random.default_rng(4).integers(8, 60, len(VIEWS))).tolist()
    capture = read_capture(encode(tmp_path / "a.mp4", VIEWS, stamps=stamps))
    seconds = (np.array(stamps) - stamps[0]) / 600
    assert len(capture.photos) >= 16
    for photo in capture.photos:
        assert_shows(photo, VIEWS[int(np.abs(seconds - second(photo)).argmin())])


def test_what_an_edit_leaves_out_is_left_out(tmp_path: Path) -> None:
    """Phones trim a film by a list of edits; its first third stays in the file."""
    path = encode(tmp_path / "a.mp4", VIEWS)
    data = bytearray(path.read_bytes())
    at = data.index(b"elst") + 16  # version and flags, count, duration
    (start,) = struct.unpack_from(">i", data, at)
    with av.open(str(path)) as whole:
        per_frame = round(1 / (RATE * whole.streams.video[0].time_base))
    struct.pack_into(">i", data, at, start + 20 * per_frame)
    path.write_bytes(data)
    capture = read_capture(path)
    assert second(capture.photos[0]) < 0.3
    assert_shows_its_moment(capture.photos, VIEWS[20:])


def cut(path: Path, keep: float) -> None:
    data = path.read_bytes()
    path.write_bytes(data[: int(keep * len(data))])


def scratched(path: Path, keep: float) -> None:
    """A thousand bytes overwritten."""
    data = bytearray(path.read_bytes())
    at = int(keep * len(data))
    data[at : at + 1000] = np.random.default_rng(0).bytes(1000)
    path.write_bytes(data)


@pytest.mark.parametrize(
    ("kind", "spoil", "says"),
    [
        ("H.264, index first", cut, "is damaged at 1."),
        ("H.264 in pieces", cut, "is damaged at 1."),
        ("Matroska", cut, "is cut off at 1."),
        ("VP9", cut, "is cut off at 1."),
        ("H.264, index first", scratched, "is damaged at 1."),
    ],
)
def test_of_a_broken_film_the_rest_is_used(kind: str, spoil: Any, says: str, tmp_path: Path) -> None:
    name, make = FILMS[kind]
    pictures = [view(number / 2) for number in range(120)]  # 4 s
    path = make(tmp_path / name, pictures)
    spoil(path, 0.4)
    capture = read_capture(path)
    assert len(capture.warnings) == 1
    assert says in capture.warnings[0]
    assert len(capture.photos) >= 8
    assert (max(map(second, capture.photos)) > 2) == (spoil is scratched)
    assert_shows_its_moment(capture.photos, pictures)


def noisy(rgb: np.ndarray, seed: int) -> np.ndarray:
    noise = np.random.default_rng(seed).normal(0, 3, rgb.shape)
    return np.clip(rgb + noise, 0, 255).astype(np.uint8)


def trembling() -> list[np.ndarray]:
    steps = np.random.default_rng(2).normal(0, 1, (240, 2)).cumsum(axis=0)
    away = 5 * steps / np.abs(steps).max(axis=0)
    return [np.roll(VIEWS[0], tuple(np.rint(step).astype(int)), (0, 1)) for step in away]


SLOPE = np.broadcast_to(np.linspace(180, 220, WIDTH).astype(np.uint8)[None, :, None], (HEIGHT, WIDTH, 3))
STILLS: dict[str, Callable[[], list[np.ndarray]]] = {
    "a tripod": lambda: [noisy(VIEWS[0], seed) for seed in range(20)] * 12,
    "a hand that trembles": trembling,
    "a white wall": lambda: [noisy(SLOPE, seed) for seed in range(20)] * 12,
    "a white wall in a flickering light": lambda: [SLOPE - np.uint8(30 * (at % 7 > 3)) for at in range(240)],
    "somebody who walks past": lambda: [
        np.where(np.arange(WIDTH)[None, :, None] // 40 == at // 8 % 8, VIEWS[at % 50], VIEWS[0]) for at in range(240)
    ],
}


@pytest.mark.slow
@pytest.mark.parametrize("still", STILLS)
def test_nothing_that_moves_has_its_name(still: str, tmp_path: Path) -> None:
    path = encode(tmp_path / "a.mp4", STILLS[still](), group=60)
    with pytest.raises(CaptureError, match="in 8 s hardly anything moves") as caught:
        read_capture(path)
    assert (caught.value.code, caught.value.file) == ("CAPTURE_LOW_OVERLAP", "a.mp4")
    assert "walk around the object" in caught.value.hints[0]


@pytest.mark.slow
def test_a_camera_that_waits_gets_no_further(tmp_path: Path) -> None:
    waited = [*VIEWS[:30], *[noisy(VIEWS[30], seed) for seed in range(90)], *VIEWS[30:]]
    capture = read_capture(encode(tmp_path / "a.mp4", waited))
    during = [photo for photo in capture.photos if 1.05 < second(photo) < 3.95]
    assert len(during) <= 2
    assert len(capture.photos) >= 16


@pytest.mark.slow
def test_the_sharpest_of_each_stretch_is_taken(tmp_path: Path) -> None:
    """Every other pair is smeared, as by a hand that jerks."""
    pictures = [view(number / 4) for number in range(240)]
    smeared = [rgb if at % 4 < 2 else cv2.blur(rgb, (7, 1)) for at, rgb in enumerate(pictures)]
    capture = read_capture(encode(tmp_path / "a.mp4", smeared, codec="mpeg4"))
    sharp = [round(second(photo) * RATE) % 4 < 2 for photo in capture.photos]
    assert np.mean(sharp) > 0.9


WAYS = st.lists(st.floats(0, 0.05), min_size=1, max_size=300)


@settings(max_examples=40)
@given(steps=WAYS, blur=st.lists(st.floats(0, 1), min_size=300, max_size=300))
def test_key_frames_are_few_in_order_and_spread(steps: list[float], blur: list[float]) -> None:
    frames = [ScannedFrame(at, *pair) for at, pair in enumerate(zip(blur, np.cumsum(steps).tolist(), strict=False))]
    chosen = key_frames(frames)
    stamps = [frame.stamp for frame in chosen]
    assert stamps == sorted(set(stamps))
    assert len(chosen) <= MAX_KEY_FRAMES
    length = frames[-1].path
    assert bool(chosen) == (length >= MIN_PATH)
    if chosen:
        stretch = length / min(MAX_KEY_FRAMES, max(16, round(length / 0.05)))
        widest = max(steps)
        paths = [frame.path for frame in chosen]
        assert max(np.diff(paths), default=0) <= 1.6 * stretch + 2 * widest + 1e-9
        assert paths[0] <= stretch + widest
        assert paths[-1] >= length - stretch - widest


@pytest.mark.parametrize("speed", [1, 3, 8])
def test_the_path_is_as_long_as_the_camera_went(speed: int) -> None:
    tracker = PathTracker()
    paths = [tracker.track(cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY)) for rgb in VIEWS[::speed]]
    went = (len(paths) - 1) * speed * STEP / WIDTH
    assert paths == sorted(paths)
    assert paths[-1] == pytest.approx(went, rel=0.1)


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return encode(tmp_path_factory.mktemp("film") / "a.mp4", VIEWS[:30], group=7)


@settings(max_examples=8)
@given(wanted=st.lists(st.integers(0, 31), min_size=1, max_size=12))
def test_frames_come_in_any_order(film: Path, wanted: list[int]) -> None:
    video = VideoFrames(film, "a.mp4")
    for index in wanted:
        if index < 30:
            assert np.abs(video.rgb(index).astype(int) - VIEWS[index]).mean() < AV_ERROR
            continue
        with pytest.raises(CaptureError, match=f"ends before frame {index}"):
            video.rgb(index)


def there(video: VideoFrames, index: int) -> bool:
    try:
        return video.rgb(index) is not None
    except CaptureError as error:
        return error.code != "IMAGE_UNREADABLE"


def test_damage_among_the_frames_is_not_decoded_again_and_again(tmp_path: Path) -> None:
    path = encode(tmp_path / "a.mp4", VIEWS * 4, container={"movflags": "faststart"}, group=60)
    data = bytearray(path.read_bytes())
    data[len(data) // 2 : len(data) // 2 + 20_000] = bytes(20_000)
    path.write_bytes(data)
    video = VideoFrames(path, "a.mp4")
    missing = [index for index in range(240) if not there(video, index)]
    assert 1 <= len(missing) < 60
    began = time.process_time()
    assert not any(there(video, index) for index in missing * 100)
    assert time.process_time() - began < 1


def test_of_a_long_film_the_beginning_of_each_group_is_seen(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where frames shown before a key frame refer to what was left out before it."""
    monkeypatch.setattr(film_scan, "_BUDGET", 0.35 * len(VIEWS) * WIDTH * HEIGHT)
    capture = read_capture(encode(tmp_path / "a.mp4", VIEWS, codec="libx265", group=10))
    starts = [round(second(photo) * RATE) for photo in capture.photos]
    assert 3 <= len(starts) < 24
    assert capture.warnings == ()
    assert_shows_its_moment(capture.photos, VIEWS)


def test_the_time_for_decoding_ends(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ticks: Iterator[float] = itertools.count(0, film_scan.DEADLINE_S / 50)
    path = encode(tmp_path / "a.mp4", [view(number / 2) for number in range(120)])
    monkeypatch.setattr(film_scan.time, "monotonic", lambda: next(ticks))
    capture = read_capture(path)
    assert "only the first 1 s of 4 s were decoded" in capture.warnings[0]
    assert max(map(second, capture.photos)) < 2
    monkeypatch.setattr(film_scan, "DEADLINE_S", 0.0)
    with pytest.raises(CaptureError, match="takes too long to decode") as caught:
        read_capture(path)
    assert caught.value.code == "CAPTURE_TOO_LARGE"


def audio(path: Path) -> Path:
    with av.open(str(path), "w") as target:
        stream = target.add_stream("aac", rate=8000, layout="mono")
        frame = av.AudioFrame.from_ndarray(np.zeros((1, 1024), np.float32), "fltp", "mono")
        frame.sample_rate = 8000
        target.mux(stream.encode(frame))
        target.mux(stream.encode())
    return path


def without_frames(path: Path) -> Path:
    """An index that lists no samples."""
    data = bytearray(encode(path, VIEWS[:3]).read_bytes())
    for box in (b"stts", b"stsz", b"stsc", b"stco", b"stss", b"ctts"):
        at = data.find(box)
        if at > 0:
            struct.pack_into(">I", data, at + (12 if box == b"stsz" else 8), 0)
    path.write_bytes(data)
    return path


def spoiled(spoil: Callable[[Path], object]) -> Callable[[Path], Path]:
    def make(path: Path) -> Path:
        spoil(encode(path, VIEWS[:20]))
        return path

    return make


BAD: dict[str, tuple[str, Callable[[Path], Any]]] = {
    "sound alone": ("CAPTURE_UNREADABLE", audio),
    "no frames": ("CAPTURE_EMPTY", without_frames),
    "never finished": ("CAPTURE_UNREADABLE", spoiled(lambda path: cut(path, 0.6))),
    "a header": ("CAPTURE_UNREADABLE", lambda path: path.write_bytes(b"\0\0\0\x18ftypmp42" + bytes(80))),
    "two pictures": ("CAPTURE_UNREADABLE", lambda path: encode(path, VIEWS[:2])),
    "empty": ("CAPTURE_EMPTY", lambda path: path.write_bytes(b"")),
    "a playlist": ("CAPTURE_UNKNOWN_FORMAT", lambda path: path.write_text("#EXTM3U\n#EXTINF:1,\n/etc/passwd\n")),
}


@pytest.mark.parametrize("kind", BAD)
def test_what_is_no_film_has_its_name(kind: str, tmp_path: Path) -> None:
    code, make = BAD[kind]
    make(tmp_path / "a.mp4")
    for place in (tmp_path, tmp_path / "a.mp4"):
        with pytest.raises(CaptureError) as caught:
            read_capture(place)
        assert (caught.value.code, caught.value.file) == (code, "a.mp4")
        assert all(caught.value.hints)
        assert str(tmp_path) not in str(caught.value)


def test_stray_recordings_open_nothing_but_videos(tmp_path: Path) -> None:
    """FFmpeg would read a playlist under any name, and whatever it lists."""
    (tmp_path / "rgb.mp4").write_text("#EXTM3U\n#EXT-X-TARGETDURATION:1\n#EXTINF:1,\n/etc/passwd\n")
    with pytest.raises(CaptureError, match="is not an mp4, mov or webm video"):
        VideoFrames(tmp_path / "rgb.mp4", "rgb.mp4").size()


@pytest.mark.parametrize(
    ("limit", "value", "code"), [("MAX_PIXELS", 1000, "IMAGE_TOO_LARGE"), ("MAX_FRAMES", 9, "CAPTURE_TOO_LARGE")]
)
def test_limits_have_names(limit: str, value: int, code: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(video_streams, limit, value)
    with pytest.raises(CaptureError) as caught:
        read_capture(encode(tmp_path / "a.mp4", VIEWS[:10]))
    assert (caught.value.code, caught.value.file) == (code, "a.mp4")


@settings(max_examples=25)
@given(data=st.data())
def test_damaged_films_are_read_or_named(film: Path, data: st.DataObject) -> None:
    """Cut, or overwritten anywhere: photos that load or have a name for why not."""
    whole = bytearray(film.read_bytes())
    for _ in range(data.draw(st.integers(0, 6))):
        at = data.draw(st.integers(8, len(whole) - 1))
        whole[at : at + 4] = data.draw(st.binary(min_size=4, max_size=4))
    with TemporaryDirectory() as root:
        path = Path(root) / "a.mp4"
        path.write_bytes(whole[: data.draw(st.integers(12, len(whole)))])
        try:
            for photo in read_capture(path).photos:
                assert photo.load(64).shape == (48, 64, 3)
        except CaptureError as error:
            assert error.file == "a.mp4"  # noqa: PT017 - either is right


def beside(folder: Path, photos: int) -> Capture:
    encode(folder / "IMG_9.MOV", VIEWS[:30])
    (folder / "IMG_9.AAE").write_text("<?xml?>")
    for number in range(photos):
        cv2.imwrite(str(folder / f"IMG_{number}.JPG"), VIEWS[number])
    return read_capture(folder)


@pytest.mark.parametrize("photos", [0, 2, 3])
def test_photos_beside_a_film(photos: int, tmp_path: Path) -> None:
    capture = beside(tmp_path, photos)
    assert capture.format == ("photos" if photos == 3 else "video")
    warning = {0: None, 2: "2 photos beside IMG_9.MOV were not used", 3: "IMG_9.MOV was not used"}[photos]
    assert [warning in told for told in capture.warnings] == ([] if warning is None else [True])


def test_of_two_films_the_larger_is_read(tmp_path: Path) -> None:
    encode(tmp_path / "a.mp4", VIEWS[:10])
    encode(tmp_path / "b.mp4", VIEWS[:40])
    capture = read_capture(tmp_path)
    assert capture.photos[0].name.startswith("b.mp4 at ")
    assert capture.warnings == ("a.mp4 was not used",)


def test_looking_through_a_film_can_be_cancelled(film: Path) -> None:
    heard: list[float] = []

    def stop_halfway(fraction: float) -> None:
        heard.append(fraction)
        if fraction > 0.5:
            raise Cancelled

    with pytest.raises(Cancelled):
        read_capture(film.parent, tick=stop_halfway)
    assert heard == sorted(heard)
    assert 0.5 < heard[-1] < 0.7
