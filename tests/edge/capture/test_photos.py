"""Photos of every format, turned, deep, grey, cut off and hostile: their headers are believed, their pixels agree."""

from __future__ import annotations

import io
import math
import struct
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import cv2
import numpy as np
import pillow_heif
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image, ImageOps

from capture2vr.edge.capture import photos
from capture2vr.edge.capture.files import Folder, open_folder
from capture2vr.edge.capture.nouns import Photo
from capture2vr.edge.errors import CaptureError
from capture2vr.edge.read_capture import read_capture
from tests.edge.capture.test_bad_captures import png_header
from tests.support import captures

pillow_heif.register_heif_opener()
RGB = np.random.default_rng(3).integers(0, 256, (6, 8, 3), np.uint8).repeat(8, axis=0).repeat(8, axis=1)  # 64 x 48
LOSSLESS = {"PNG": {}, "WEBP": {"lossless": True}, "TIFF": {}, "HEIF": {"quality": -1, "chroma": 444}}
SUFFIXES = {"JPEG": ".jpg", "PNG": ".png", "WEBP": ".webp", "TIFF": ".tif", "HEIF": ".heic"}


def exif(orientation: int = 1, camera: dict[int, Any] | None = None, **tags: Any) -> Image.Exif:
    """`camera`: the tags of the camera's directory."""
    found = Image.Exif()
    found[0x0112], found[0x010F], found[0x0110] = orientation, tags.get("make", "Maker"), tags.get("model", "Phone 9")
    found.get_ifd(0x8769).update(camera or {0xA405: 26})
    return found


def encoded(rgb: np.ndarray = RGB, kind: str = "JPEG", **options: Any) -> bytes:
    buffer = io.BytesIO()
    image = rgb if isinstance(rgb, Image.Image) else Image.fromarray(rgb)
    chosen = LOSSLESS.get(kind, {}) | {"exif": exif()} | options
    tags = chosen["exif"]
    chosen["exif"] = (
        tags if isinstance(tags, bytes) else tags.tobytes()
    )  # HEIC's writer turns the picture by bytes only
    image.save(buffer, kind, **chosen)
    return buffer.getvalue()


@pytest.fixture
def photo_of(tmp_path: Path) -> Callable[..., Photo]:
    """The photo of some bytes."""

    def make(data: bytes, name: str = "IMG_1.jpg") -> Photo:
        (tmp_path / name).write_bytes(data)
        return photos.read_photo(Folder(tmp_path, (name,)), name)

    return make


def folder_of(root: Path, **contents: bytes) -> Folder:
    for name, data in contents.items():
        (root / f"{name}.jpg").write_bytes(data)
    return open_folder(root)


@pytest.mark.parametrize("kind", SUFFIXES)
@pytest.mark.parametrize("orientation", [1, 3, 6, 8])
def test_pixels_are_as_stored_and_turns_bring_them_upright(photo_of: Any, kind: str, orientation: int) -> None:
    """Also for HEIC and TIFF, whose decoders turn by themselves."""
    data = encoded(kind=kind, exif=exif(orientation))
    photo = photo_of(data, "IMG_1" + SUFFIXES[kind])
    pixels = photo.load()
    assert photo.size == (64, 48)
    assert pixels.shape == (48, 64, 3)
    upright = np.asarray(ImageOps.exif_transpose(Image.open(io.BytesIO(data))).convert("RGB"), int)
    assert np.abs(np.rot90(pixels, -photo.turns) - upright).mean() < (4 if kind == "JPEG" else 0.01)
    assert photo.turns == {1: 0, 3: 2, 6: 1, 8: 3}[orientation]


@pytest.mark.parametrize("kind", SUFFIXES)
@pytest.mark.parametrize("orientation", [0, 2, 4, 5, 7, 9])
def test_mirrored_and_senseless_orientations_are_read(photo_of: Any, kind: str, orientation: int) -> None:
    photo = photo_of(encoded(kind=kind, exif=exif(orientation)), "IMG_1" + SUFFIXES[kind])
    assert photo.load().shape == (photo.size[1], photo.size[0], 3)
    assert set(photo.size) == {64, 48}


def test_one_phone_held_both_ways_is_one_camera(photo_of: Any) -> None:
    level, upright = (photo_of(encoded(kind="HEIF", exif=exif(turn)), f"{turn}.heic") for turn in (1, 6))
    assert level.camera == upright.camera
    assert level.focal_px == upright.focal_px


@pytest.mark.parametrize(
    "other",
    [
        {"exif": exif(model="Phone 8")},
        {"exif": exif(camera={0xA405: 13})},
        {"exif": exif(camera={0xA405: 26, 0x920A: 2.2})},
        {"rgb": RGB.transpose(1, 0, 2)},
    ],
    ids=["model", "focal length on film", "focal length", "size"],
)
def test_another_lens_or_size_is_another_camera(photo_of: Any, other: dict[str, Any]) -> None:
    assert photo_of(encoded(), "a.jpg").camera != photo_of(encoded(**other), "b.jpg").camera


@settings(max_examples=40)
@given(
    width=st.integers(8, 300),  # linear from end to end, narrower ones have another mean when they are scaled
    height=st.integers(8, 300),
    longest=st.integers(16, 400),
    kind=st.sampled_from(["JPEG", "PNG"]),
)
def test_longest_scales_down_and_never_up(width: int, height: int, longest: int, kind: str) -> None:
    rgb = np.broadcast_to(np.linspace(20, 230, width).astype(np.uint8)[None, :, None], (height, width, 3))
    with TemporaryDirectory() as root:
        (Path(root) / "a.jpg").write_bytes(encoded(rgb, kind))
        photo = photos.read_photo(Folder(Path(root), ("a.jpg",)), "a.jpg")
        pixels = photo.load(longest)
    assert photo.size == (width, height)
    shrink = max(1, max(width, height) / longest)
    assert pixels.shape == (max(1, round(height / shrink)), max(1, round(width / shrink)), 3)
    assert abs(float(pixels.mean()) - float(rgb.mean())) < 4


def _sixteen(suffix: str) -> bytes:
    return cv2.imencode(suffix, RGB[..., ::-1].astype(np.uint16) * 257)[1].tobytes()


GREY = np.asarray(Image.fromarray(RGB).convert("L"))
MODES: dict[str, tuple[Callable[[], bytes], np.ndarray]] = {
    "16-bit PNG": (lambda: _sixteen(".png"), RGB),
    "16-bit TIFF": (lambda: _sixteen(".tiff"), RGB),
    "grey JPEG": (lambda: encoded(Image.fromarray(GREY)), GREY[..., None]),
    "grey HEIC": (lambda: encoded(Image.fromarray(GREY), "HEIF"), GREY[..., None]),
    "grey PNG with alpha": (lambda: encoded(Image.fromarray(GREY).convert("LA"), "PNG"), GREY[..., None]),
    "PNG with alpha": (lambda: encoded(Image.fromarray(RGB).convert("RGBA"), "PNG"), RGB),
    "PNG with palette": (lambda: encoded(Image.fromarray(RGB).quantize(), "PNG"), RGB),
    "WebP with alpha": (lambda: encoded(Image.fromarray(RGB).convert("RGBA"), "WEBP"), RGB),
    "HEIC with alpha": (lambda: encoded(Image.fromarray(RGB).convert("RGBA"), "HEIF"), RGB),
    "CMYK JPEG": (lambda: encoded(Image.fromarray(RGB).convert("CMYK"), quality=95), RGB),
    "CMYK TIFF, turned": (lambda: encoded(Image.fromarray(RGB).convert("CMYK"), "TIFF", exif=exif(6)), RGB),
}


@pytest.mark.parametrize("mode", MODES)
def test_every_kind_of_pixels_becomes_rgb(photo_of: Any, mode: str) -> None:
    make, expected = MODES[mode]
    photo = photo_of(make())
    pixels = photo.load()
    assert pixels.dtype == np.uint8
    assert pixels.flags.c_contiguous
    assert np.abs(pixels.astype(int) - expected).mean() < 6
    assert photo.load(20).shape == (15, 20, 3)


@pytest.mark.parametrize("size", [(4032, 3024), (3024, 4032), (4000, 3000)])
def test_focal_length_on_film_compares_diagonals(photo_of: Any, size: tuple[int, int]) -> None:
    photo = photo_of(encoded(np.zeros((size[1], size[0], 3), np.uint8), exif=exif(camera={0xA405: 26})))
    assert photo.focal_px == pytest.approx(26 * math.hypot(*size) / math.hypot(36, 24))


SENSOR = {0x920A: 50.0, 0xA20E: 100.0, 0xA210: 4}  # 50 mm, 100 pixels a millimetre


@pytest.mark.parametrize(
    ("camera", "focal"),
    [
        ({}, None),
        ({0xA405: 0}, None),
        ({0xA405: 26, **SENSOR}, 26 * 80 / math.hypot(36, 24)),  # of a picture of 64 x 48
        ({**SENSOR, 0xA20E: 2.0}, 100.0),
        ({**SENSOR, 0xA20E: 50.8, 0xA210: 2}, 100.0),
        ({**SENSOR, 0xA20E: 20.0, 0xA210: 3}, 100.0),
        ({**SENSOR, 0xA002: 6400, 0xA003: 4800}, 50.0),  # shrunk since, to a hundredth
        (SENSOR, None),  # shrunk by a program that did not say so: 78 times the width
        ({**SENSOR, 0xA210: 99}, None),
    ],
)
def test_focal_length_of_the_sensor(photo_of: Any, camera: dict[int, Any], focal: float | None) -> None:
    found = photo_of(encoded(exif=exif(camera=camera or {0x829D: 1.8}))).focal_px
    assert found == (None if focal is None else pytest.approx(focal))


@settings(max_examples=60)
@given(block=st.binary(max_size=200))
def test_damaged_tags_cost_only_themselves(block: bytes) -> None:
    with TemporaryDirectory() as root:
        (Path(root) / "a.jpg").write_bytes(encoded(exif=b"Exif\0\0" + block))
        photo = photos.read_photo(Folder(Path(root), ("a.jpg",)), "a.jpg")
        assert photo.load().shape == (48, 64, 3)


@pytest.mark.slow
@settings(max_examples=150)
@given(kind=st.sampled_from(list(SUFFIXES)), data=st.data())
def test_broken_bytes_are_an_answer(kind: str, data: st.DataObject) -> None:
    """Cut, or overwritten anywhere: a photo of the size that it told, or an error that names the file."""
    whole = bytearray(encoded(kind=kind))
    for _ in range(data.draw(st.integers(0, 4))):
        whole[data.draw(st.integers(0, len(whole) - 1))] = data.draw(st.integers(0, 255))
    cut = whole[: data.draw(st.integers(12, len(whole)))]
    with TemporaryDirectory() as root:
        (Path(root) / "a.jpg").write_bytes(cut)
        folder = Folder(Path(root), ("a.jpg",))
        error = None
        try:
            photo = photos.read_photo(folder, "a.jpg")
            assert photo.load().shape == (photo.size[1], photo.size[0], 3)
        except CaptureError as raised:
            error = raised
    assert error is None or (error.code in ("IMAGE_UNREADABLE", "IMAGE_TOO_LARGE") and error.file == "a.jpg")


@pytest.mark.parametrize("kept", [0.5, 0.9])
def test_a_cut_jpeg_is_not_grey_below(photo_of: Any, kept: float) -> None:
    """With a preview among its tags, which has an end of its own."""
    preview = exif(camera={0x927C: encoded(RGB[:16, :16])})
    data = encoded(exif=preview)
    assert photo_of(data).load().shape == (48, 64, 3)
    pixels = data.index(b"\xff\xda", len(preview.tobytes()))
    photo = photo_of(data[: pixels + int(kept * (len(data) - pixels))])
    with pytest.raises(CaptureError, match="is cut off"):
        photo.load()


def test_a_film_behind_the_picture_is_no_damage(photo_of: Any) -> None:
    assert photo_of(encoded() + b"\0\0\0\x18ftypmp42" + b"\xff\xda" * 9).load().shape == (48, 64, 3)


def test_unreadable_photos_are_told_and_the_rest_goes_on(tmp_path: Path) -> None:
    huge = png_header(12_000, 9_000)
    folder = folder_of(tmp_path, a10=encoded(), a2=encoded(), a3=encoded()[:20], a4=encoded(), b=huge, c=b"")
    capture = photos.read(folder)
    assert (capture.kind, capture.format, capture.scale_confidence) == ("photos", "photos", "unknown")
    assert [photo.name for photo in capture.photos] == ["a2.jpg", "a4.jpg", "a10.jpg"]
    told = {verdict.name: (verdict.verdict, verdict.advice) for verdict in capture.verdicts}
    assert set(told) == {"a3.jpg", "b.jpg", "c.jpg"}
    assert all(verdict == "unreadable" and advice.endswith(".") for verdict, advice in told.values())
    assert "at most 100 megapixels" in told["b.jpg"][1]


@pytest.mark.parametrize(
    ("broken", "code"),
    [(b"\xff\xd8\xff" + bytes(40), "CAPTURE_UNREADABLE"), (png_header(12_000, 9_000), "IMAGE_TOO_LARGE")],
)
def test_too_few_are_an_error_about_the_first(tmp_path: Path, broken: bytes, code: str) -> None:
    with pytest.raises(CaptureError) as caught:
        photos.read(folder_of(tmp_path, a=encoded(), b=encoded(), c=broken))
    assert (caught.value.code, caught.value.file) == (code, "c.jpg")


def test_a_raw_picture_is_not_its_preview(photo_of: Any) -> None:
    raw = exif()
    raw[0xC612] = b"\1\4\0\0"
    with pytest.raises(CaptureError, match="raw picture"):
        photo_of(encoded(kind="TIFF", exif=raw), "IMG_1.tif")
    with pytest.raises(CaptureError, match="raw picture"):
        photo_of(encoded(kind="TIFF"), "DSC_1.NEF")


def test_two_photos_are_a_capture(tmp_path: Path) -> None:
    capture = photos.read(folder_of(tmp_path, a=encoded(), b=encoded()))
    assert (capture.kind, len(capture.photos)) == ("photos", 2)
    assert len(photos.read(folder_of(tmp_path, c=encoded())).photos) == 3


def test_one_photo_is_a_capture_of_its_own_kind(tmp_path: Path) -> None:
    capture = photos.read(folder_of(tmp_path, a=encoded()))
    assert capture.kind == "image"
    assert [photo.name for photo in capture.photos] == ["a.jpg"]
    assert "guess" in capture.warnings[0]
    assert "15 to 30 photos" in capture.warnings[0]


@pytest.mark.parametrize("depth", [np.uint8, np.uint16])
def test_an_alpha_channel_comes_as_stored(tmp_path: Path, depth: type) -> None:
    alpha = np.zeros((90, 60), np.uint8)
    alpha[20:70, 10:40] = 255
    rgba = np.dstack([np.full((90, 60, 3), 90, np.uint8), alpha]).astype(depth) * (257 if depth is np.uint16 else 1)
    cv2.imwrite(str(tmp_path / "a.png"), rgba)
    (photo,) = photos.read(Folder(tmp_path, ("a.png",))).photos
    assert photo.load_alpha is not None
    found = photo.load_alpha()
    assert found is not None
    assert np.array_equal(found, alpha)


def test_most_photos_have_no_alpha_channel(tmp_path: Path) -> None:
    (photo,) = photos.read(folder_of(tmp_path, a=encoded())).photos
    assert photo.load_alpha is None


def huge_heic() -> bytes:
    """It says 12,000 x 9,000 in its box of the image's extent, as those of phones with 108 megapixels do."""
    data = bytearray(encoded(np.zeros((64, 64, 3), np.uint8), "HEIF"))
    struct.pack_into(">II", data, data.index(b"ispe") + 8, 12_000, 9_000)
    return bytes(data)


def test_a_heic_of_108_megapixels_is_told_and_the_rest_goes_on(tmp_path: Path) -> None:
    for number in range(3):
        (tmp_path / f"{number}.heic").write_bytes(encoded(kind="HEIF"))
    (tmp_path / "large.heic").write_bytes(huge_heic())
    capture = photos.read(open_folder(tmp_path))
    assert len(capture.photos) == 3
    (verdict,) = capture.verdicts
    assert (verdict.name, verdict.verdict) == ("large.heic", "unreadable")
    assert verdict.advice == "It is 12000 x 9000 pixels; at most 100 megapixels are read; send a smaller picture."


def test_heics_of_108_megapixels_alone_have_their_name(tmp_path: Path) -> None:
    for number in range(4):
        (tmp_path / f"{number}.heic").write_bytes(huge_heic())
    with pytest.raises(CaptureError, match="12000 x 9000") as caught:
        photos.read(open_folder(tmp_path))
    assert (caught.value.code, caught.value.file) == ("IMAGE_TOO_LARGE", "0.heic")
    assert caught.value.hints


def test_photos_of_every_kind_make_one_capture(tmp_path: Path) -> None:
    """Level, upright by tag and by pixels, CMYK, 16 bits: a phone held both ways is one camera where its files are."""
    (tmp_path / "1 level.jpg").write_bytes(encoded())
    (tmp_path / "2 by tag.jpg").write_bytes(encoded(exif=exif(6)))
    (tmp_path / "3 by pixels.jpg").write_bytes(encoded(np.rot90(RGB).copy()))
    (tmp_path / "4 cmyk.jpg").write_bytes(MODES["CMYK JPEG"][0]())
    (tmp_path / "5 deep.png").write_bytes(MODES["16-bit PNG"][0]())
    (tmp_path / "6 deep.tiff").write_bytes(MODES["16-bit TIFF"][0]())
    capture = photos.read(open_folder(tmp_path))
    level, tagged, upright, *_ = capture.photos
    assert len(capture.photos) == 6
    assert level.camera == tagged.camera != upright.camera
    for photo in capture.photos:
        assert photo.size == ((48, 64) if photo is upright else (64, 48))
        assert photo.load().shape == (photo.size[1], photo.size[0], 3)


def test_hundreds_of_photos_are_thinned_evenly(tmp_path: Path) -> None:
    data = encoded()
    capture = photos.read(folder_of(tmp_path, **{f"{index}": data for index in range(601)}))
    numbers = [int(Path(photo.name).stem) for photo in capture.photos]
    assert len(numbers) == photos.MAX_PHOTOS
    assert (numbers[0], numbers[-1]) == (0, 600)
    assert set(np.diff(numbers)) <= {2, 3}
    assert "300 of 601" in capture.warnings[0]


@pytest.mark.parametrize(
    ("name", "head", "found"),
    [
        ("a.heic", b"\0\0\0\x18ftypheic", True),
        ("a.mp4", b"\0\0\0\x18ftypmp42", False),
        ("a.jpg", b"Dear reader,", False),
        ("a.wav", b"RIFF\0\0\0\0WAVE", False),
        ("noname", b"\xff\xd8\xff\xe0", True),
    ],
)
def test_pictures_are_told_by_their_bytes(tmp_path: Path, name: str, head: bytes, found: bool) -> None:
    (tmp_path / name).write_bytes(head)
    assert photos.matches(open_folder(tmp_path)) is found


@pytest.mark.parametrize(
    ("place", "materials", "warned"),
    [
        ("{}.jpg", "", True),
        ("textures/{}.jpg", "", False),
        ("{}.jpg", "map_Kd 0.jpg\nmap_Kd 1.jpg\nmap_Kd 2.jpg\n", False),
        ("a {}.jpg", '{"images": [{"uri": "a%200.jpg"}, {"uri": "a%201.jpg"}, {"uri": "a%202.jpg"}]}', False),
    ],
)
def test_a_mesh_never_takes_the_place_of_photos_in_silence(
    place: str, materials: str, warned: bool, tmp_path: Path
) -> None:
    (tmp_path / "mesh.obj").write_text("".join(f"v {x} {y} {x * y}\n" for x in range(10) for y in range(10)))
    (tmp_path / ("scene.gltf" if materials.startswith("{") else "mesh.mtl")).write_text(materials)
    for index in range(3):
        captures.save_jpg(tmp_path / place.format(index), captures.picture(index))
    capture = read_capture(tmp_path)
    assert capture.kind == "points"
    assert any("the 3 photos beside it" in warning for warning in capture.warnings) == warned
