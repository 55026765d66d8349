"""Prepared points: what is written is read again to the bit, and nothing else is read at all."""

from __future__ import annotations

import io
import json
import tempfile
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from capture2vr.edge.capture.facts import CaptureFacts
from capture2vr.edge.capture.nouns import Cloud, CloudParts, Intrinsics, PhotoVerdict, PictureCamera, UpSource
from capture2vr.edge.capture.photo_copy import encode_copy
from capture2vr.edge.capture_to_points import PreparedPoints
from capture2vr.edge.errors import EdgeError
from capture2vr.edge.jobs.archived_views import MOST_VIEWS
from capture2vr.edge.jobs.points_archive import MOST_POINTS, read_prepared, write_prepared
from capture2vr.edge.jobs.points_cache import load_points, save_points
from capture2vr.edge.models.nouns import UsedModel
from capture2vr.edge.origin import FILLED, MEASURED
from capture2vr.edge.points.nouns import CutReport, Points, TextureView, UnseenSide
from capture2vr.edge.read_capture import read_capture
from capture2vr.edge.worker.capabilities import POINTS_VERSION
from capture2vr.order.edits import CropBox, Edits
from capture2vr.process.archives import unpack

VERDICTS = (PhotoVerdict("a.jpg", "ok"), PhotoVerdict("b.jpg", "blur", "hold still"))
CAMERA = PictureCamera(
    "IMG_0.jpg",
    (64, 48),
    (50.0, 51.0, 31.5, 23.5),
    (0.1, -0.02, 0.0, 1e-3, 0.0),
    ((1, 0, 0, 0.5), (0, 1, 0, 2), (0, 0, 1, -3.0)),
)
COORDINATES = st.floats(-1e9, 1e9)
TEXT = st.text(st.characters(exclude_categories=["Cs"]), max_size=20)


def view(number: int) -> TextureView:
    """A smooth picture with its depth, where a third is unknown; every second one has a mask, of a size of its own."""
    place = np.linspace(0, 1, 60)
    rgb = np.asarray(255 * np.stack([np.outer(place, place), *np.meshgrid(place, place)], axis=-1), np.uint8)
    depth = np.float32(1 + number + np.outer(place[:40], place[:40]))
    depth[:, :13] = 0
    angle = 0.3 * number
    pose = np.eye(4)
    pose[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    pose[:3, 3] = number, -1.0, 1e5
    lens = Intrinsics(50.0, 51.0, 29.5, 30.5, 60, 60)
    mask = np.add.outer(np.arange(30), np.arange(45)) % 3 > number % 2
    load_mask = None if number == 1 else lambda: mask
    return TextureView(lens, pose, lambda: rgb, lambda: depth, f"IMG_{number}.jpg", number == 1, load_mask)


def prepared_points(count: int = 120, *, pictured: bool = True) -> PreparedPoints:
    """A photographed thing with everything that there may be, with or without its pictures."""
    rng = np.random.default_rng(0)
    points = Points(
        xyz=rng.normal(size=(count, 3)),
        rgb=rng.integers(0, 256, (count, 3), np.uint8),
        confidence=rng.random(count).astype(np.float32),
        metres_per_unit=0.5,
        scale_confidence="metric",
        up=np.array([0.0, 0.6, 0.8]),
        warnings=("two photos were left out",),
        unseen=(UnseenSide("shoot from the left", (-1.0, 0.0, 0.0), 0.25),),
        cut=CutReport("object", "it stands in the middle", "a box was removed", 0.5),
        up_source=UpSource("lines", 0.9),
        edits=Edits(crop=CropBox((0.1, 0.0, 0.0), (9.0, 9.0, 9.0)), up=(0.0, 0.6, 0.8), fill="none"),
        cameras=(CAMERA, replace(CAMERA, name="IMG_1.jpg")) if pictured else (),
        texture_views=(view(0), view(1)) if pictured else (),
        held_out_views=(view(2),) if pictured else (),
        origin=np.where(np.arange(count) >= count - 10, FILLED, MEASURED).astype(np.uint8),
        closed=True,
        offset=np.array([345_678.25, 5_432_100.5, 321.0]),
        crs="EPSG:25832",
        models=(UsedModel("isnet", "b6e8" * 16),),
        scale_by_model=True,
    )
    return PreparedPoints(points, CaptureFacts("photos", "jpeg", 2, VERDICTS), {"ALIGNING": 1.5, "POINT_CLOUD": 0.25})


@st.composite
def anything(draw: st.DrawFn) -> PreparedPoints:
    """Points with whatever a capture may have or lack."""
    count = draw(st.integers(110, 120))
    xyz = draw(arrays(np.float64, (count, 3), elements=COORDINATES)).copy()
    xyz[0, 0] = xyz[1, 0] + 1e6  # not all in one place
    points = replace(
        prepared_points(count).points,
        xyz=xyz,
        confidence=draw(arrays(np.float32, count, elements=st.floats(0, 1, width=32))),
        metres_per_unit=draw(st.floats(1e-6, 1e6)),
        scale_confidence=draw(st.sampled_from(["metric", "estimated", "unknown"])),
        warnings=tuple(draw(st.lists(TEXT, max_size=3))),
    )
    if draw(st.booleans()):
        points = replace(points, rgb=None, up=None, unseen=(), cut=None, up_source=None, origin=None, closed=False)
        points = replace(points, offset=None, crs="")
    source = CaptureFacts(draw(st.sampled_from(["points", "rgbd", "image"])), draw(TEXT), draw(st.integers(0, 1 << 40)))
    return PreparedPoints(points, source, draw(st.dictionaries(st.just("POINT_CLOUD"), st.floats(0, 1e6))))


def same(first: PreparedPoints, second: PreparedPoints) -> bool:
    ours, theirs = first.points, second.points
    return (
        all(
            (one is None) == (other is None)
            and (one is None or (one.dtype == other.dtype and one.tobytes() == other.tobytes()))
            for one, other in [
                (ours.xyz, theirs.xyz),
                (ours.rgb, theirs.rgb),
                (ours.confidence, theirs.confidence),
                (ours.up, theirs.up),
                (ours.origin, theirs.origin),
                (ours.offset, theirs.offset),
            ]
        )
        and (
            ours.crs,
            ours.models,
            ours.metres_per_unit,
            ours.scale_confidence,
            ours.warnings,
            ours.unseen,
            ours.cut,
            ours.up_source,
            ours.edits,
            ours.closed,
        )
        == (
            theirs.crs,
            theirs.models,
            theirs.metres_per_unit,
            theirs.scale_confidence,
            theirs.warnings,
            theirs.unseen,
            theirs.cut,
            theirs.up_source,
            theirs.edits,
            theirs.closed,
        )
        and (first.source, dict(first.seconds)) == (second.source, dict(second.seconds))
    )


@pytest.mark.slow
@settings(max_examples=50)
@given(anything())
def test_what_is_written_is_read(prepared: PreparedPoints) -> None:
    with tempfile.TemporaryDirectory() as folder:
        archive = Path(folder, "points.zip")
        write_prepared(prepared, archive)
        assert same(read_prepared(archive, Path(folder, "scratch")), prepared)
        assert [path.name for path in Path(folder).glob("*.zip*")] == ["points.zip"]


def test_everything_is_kept(tmp_path: Path) -> None:
    write_prepared(prepared_points(), tmp_path / "points.zip")
    assert same(read_prepared(tmp_path / "points.zip", tmp_path / "scratch"), prepared_points())


def large_scene(count: int = 2_500, *, coloured: bool = True) -> PreparedPoints:
    """Points of which a large scene has more, far from the origin, in parts of which one is empty."""
    few = prepared_points(pictured=False)
    rng = np.random.default_rng(1)
    xyz = rng.uniform(-50, 50, (count, 3)) + np.array([4e5, 0, -3e5])
    rgb = rng.integers(0, 256, (count, 3), np.uint8) if coloured else None

    def read() -> Iterator[Cloud]:
        for rows in (slice(0, 1_000), slice(0, 0), slice(1_000, None)):
            yield Cloud(xyz[rows], None if rgb is None else rgb[rows])

    announced = CloudParts(count + 7, read)  # seven were no numbers
    some, sure = xyz[::20], np.ones(count // 20, np.float32)
    return replace(few, points=replace(few.points, xyz=some, rgb=None, confidence=sure, whole=announced, origin=None))


@pytest.mark.parametrize("coloured", [True, False])
def test_all_points_of_a_large_scene_come_along(tmp_path: Path, coloured: bool) -> None:
    prepared = large_scene(coloured=coloured)
    write_prepared(prepared, tmp_path / "points.zip")
    whole = read_prepared(tmp_path / "points.zip", tmp_path / "scratch").points.whole
    assert whole is not None
    assert prepared.points.whole is not None
    wanted, found = (list(each.read()) for each in (prepared.points.whole, whole))
    assert whole.count == 2_500
    for _ in range(2):  # they can be read again
        xyz = np.concatenate([part.xyz for part in whole.read()])
        assert np.abs(xyz - np.concatenate([part.xyz for part in wanted])).max() < 1e-5
    rgb = [np.concatenate([part.rgb for part in parts if part.rgb is not None and len(part.rgb)] or [np.empty(0)])
           for parts in (wanted, found)]  # fmt: skip
    assert np.array_equal(*rgb)
    assert len(rgb[0]) == 2_500 * coloured


@pytest.mark.parametrize("what", ["cut off", "not a number", "far away", "missing"])
def test_a_large_scene_that_is_none_is_named(tmp_path: Path, what: str) -> None:
    write_prepared(large_scene(), tmp_path / "points.zip")
    unpack(tmp_path / "points.zip", tmp_path / "files")
    files = {path.name: path.read_bytes() for path in (tmp_path / "files").iterdir()}
    bad = np.full(1, {"not a number": np.nan, "far away": 1e30}.get(what, 0), "<f4").tobytes()
    match what:
        case "missing":
            del files["whole.bin"]
        case "cut off":
            files["whole.bin"] = files["whole.bin"][:-4]
        case _:
            files["whole.bin"] = bad + files["whole.bin"][4:]
    refused = refusal(tmp_path, files)
    assert "whole.bin" in f"{refused.message} {refused.file}"


Files = dict[str, bytes]


@pytest.fixture
def files(tmp_path: Path) -> Files:
    """What a good archive holds."""
    write_prepared(prepared_points(), tmp_path / "good.zip")
    with zipfile.ZipFile(tmp_path / "good.zip") as packed:
        return {name: packed.read(name) for name in packed.namelist()}


def refusal(tmp_path: Path, files: Files) -> EdgeError:
    with zipfile.ZipFile(tmp_path / "bad.zip", "w") as packed:
        for name, content in files.items():
            packed.writestr(name, content)
    with pytest.raises(EdgeError) as refused:
        read_prepared(tmp_path / "bad.zip", tmp_path / f"scratch-{len(list(tmp_path.iterdir()))}")
    assert refused.value.code == "POINTS_INVALID"
    assert refused.value.hints
    assert not refused.value.retryable
    return refused.value


def npy(array: np.ndarray) -> bytes:
    packed = io.BytesIO()
    np.save(packed, array, allow_pickle=True)
    return packed.getvalue()


def spoilt(change: Callable[[np.ndarray], None]) -> bytes:
    xyz = prepared_points().points.xyz.copy()
    change(xyz)
    return npy(xyz)


def set_at(value: float) -> Callable[[np.ndarray], None]:
    return lambda xyz: xyz.__setitem__((5, 1), value)


ARRAYS: dict[str, tuple[str, bytes]] = {
    "a NaN": ("xyz.npy", spoilt(set_at(np.nan))),
    "an infinity": ("xyz.npy", spoilt(set_at(-np.inf))),
    "a number whose square is none": ("xyz.npy", spoilt(set_at(1e300))),
    "one place": ("xyz.npy", spoilt(lambda xyz: xyz.fill(3.0))),
    "too few rows": ("xyz.npy", npy(np.zeros((119, 3)))),
    "two columns": ("xyz.npy", npy(np.zeros((120, 2)))),
    "single precision": ("xyz.npy", npy(np.zeros((120, 3), np.float32))),
    "columns first": ("xyz.npy", npy(np.asfortranarray(np.ones((120, 3))))),
    "pickled objects": ("xyz.npy", npy(np.full((120, 3), None, object))),
    "no array": ("xyz.npy", b"xyz"),
    "a torn array": ("xyz.npy", npy(prepared_points().points.xyz)[:-1]),
    "more than an array": ("xyz.npy", npy(prepared_points().points.xyz) + b"more"),
    "a header that promises more": ("xyz.npy", npy(np.zeros((120, 3))).replace(b"(120, 3)", b"(9**9,3)")),
    "confidence above 1": ("confidence.npy", npy(np.full(120, 1.5, np.float32))),
    "confidence that is no number": ("confidence.npy", npy(np.full(120, np.nan, np.float32))),
    "no measured point": ("origin.npy", npy(np.full(120, FILLED, np.uint8))),
    "an origin that there is not": ("origin.npy", npy(np.full(120, 3, np.uint8))),
    "origins as truths": ("origin.npy", npy(np.zeros(120, bool))),
    "colours as floats": ("rgb.npy", npy(np.zeros((120, 3), np.float32))),
}

HEADS: dict[str, Any] = {
    "no version": {"version": None},
    "a newer version": {"version": POINTS_VERSION + 1},
    "a count below any capture's": {"points": 99},
    "a count beyond any capture's": {"points": MOST_POINTS + 1},
    "no scale": {"metres_per_unit": 0},
    "a scale that is no number": {"metres_per_unit": "1"},
    "an unknown confidence of scale": {"scale_confidence": "certain"},
    "no direction": {"up": [0, 0, 0]},
    "a direction from nowhere": {"up_source": {"teller": "a dream", "confidence": 1}},
    "a direction surer than sure": {"up_source": {"teller": "walk", "confidence": 1.5}},
    "edits inside out": {"edits": {"crop": {"centre": [0, 0, 0], "size": [0, 1, 1]}}},
    "a cut that does not exist": {"cut": {"kept": "half", "because": "", "doubt": "", "removed": 0}},
    "half a direction": {"up": [0, 1]},
    "a side that is no direction": {"unseen": [{"advice": "a", "toward": [0, 0, 9], "share": 0.5}]},
    "a side without a share": {"unseen": [{"advice": "a", "toward": [0, 0, 1], "share": 2}]},
    "an unknown kind": {"source": {"kind": "dream", "format": "ply", "frames": 0, "verdicts": []}},
    "less than no frames": {"source": {"kind": "points", "format": "ply", "frames": -1, "verdicts": []}},
    "an unknown stage": {"seconds": {"DREAMING": 1}},
    "seconds back": {"seconds": {"ALIGNING": -1}},
    "an unknown field": {"owner": "root"},
    "views that are none": {"views": [7]},
    "more views than any capture has": {"views": [{}] * (MOST_VIEWS + 1)},
}


def test_pictures_come_along_with_their_cameras_depths_and_masks(tmp_path: Path) -> None:
    prepared = prepared_points()
    write_prepared(prepared, tmp_path / "points.zip")
    found = read_prepared(tmp_path / "points.zip", tmp_path / "scratch").points
    assert [len(found.texture_views), len(found.held_out_views)] == [2, 1]
    for ours, theirs in zip(
        (*prepared.points.texture_views, *prepared.points.held_out_views),
        (*found.texture_views, *found.held_out_views),
        strict=True,
    ):
        assert (ours.name, ours.tracked, ours.intrinsics) == (theirs.name, theirs.tracked, theirs.intrinsics)
        np.testing.assert_array_equal(ours.camera_to_world, theirs.camera_to_world)
        assert np.abs(ours.load_rgb().astype(int) - theirs.load_rgb()).mean() < 2
        depth, read = ours.load_depth_m(), theirs.load_depth_m()
        np.testing.assert_array_equal(depth == 0, read == 0)
        np.testing.assert_allclose(read, depth, rtol=1e-4)
        assert (ours.load_mask is None) == (theirs.load_mask is None)
        if ours.load_mask and theirs.load_mask:
            np.testing.assert_array_equal(theirs.load_mask(), ours.load_mask())


VIEWS: dict[str, dict[str, Any]] = {
    "a pose that mirrors": {"camera_to_world": [[-1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]]},
    "a pose that stretches": {"camera_to_world": [[2, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]]},
    "no focal length": {"camera": [0, 50, 1, 1]},
    "a depth image beyond any": {"depth_shape": [40, 1 << 20]},
    "a depth without a step": {"depth_step": 0},
    "an image without a width": {"size": [0, 60]},
    "a mask beyond any": {"mask_shape": [1 << 20, 40]},
}


@pytest.mark.parametrize("what", VIEWS)
def test_a_view_that_is_none_is_refused(tmp_path: Path, files: Files, what: str) -> None:
    head = json.loads(files["points.json"])
    head["views"][1].update(VIEWS[what])
    assert refusal(tmp_path, {**files, "points.json": json.dumps(head).encode()}).file == "points.json"


@pytest.mark.parametrize(
    "what", ["no picture", "a huge picture", "a torn depth", "a depth of another size", "a torn mask"]
)
def test_a_picture_that_is_none_is_named(tmp_path: Path, files: Files, what: str) -> None:
    huge = np.zeros((16, 2_000, 3), np.uint8)
    name, content = {
        "no picture": ("view-1.picture", b"\xff\xd8 no picture"),
        "a huge picture": ("view-1.picture", encode_copy(huge)),
        "a torn depth": ("view-2.depth", files["view-2.depth"][:-3]),
        "a depth of another size": ("view-0.depth", npy(np.zeros((4, 4), np.uint16))),
        "a torn mask": ("view-2.mask", files["view-2.mask"][:-1]),
    }[what]
    assert refusal(tmp_path, {**files, name: content}).file == name


@pytest.mark.parametrize("what", ARRAYS)
def test_an_array_that_is_none_is_named(tmp_path: Path, files: Files, what: str) -> None:
    name, content = ARRAYS[what]
    assert refusal(tmp_path, {**files, name: content}).file == name


@pytest.mark.parametrize("what", HEADS)
def test_a_head_that_is_none_is_named(tmp_path: Path, files: Files, what: str) -> None:
    head = {**json.loads(files["points.json"]), **HEADS[what]}
    refused = refusal(tmp_path, {**files, "points.json": json.dumps(head).encode()})
    assert refused.file == "points.json"
    if what == "a newer version":
        assert f"is of version {POINTS_VERSION + 1}; this worker reads {POINTS_VERSION}" in refused.message


@pytest.mark.parametrize("text", [b"", b"{", b"[]", b"7", b"[" * 100_000, b'{"version": 1}', b"\xff", b" " * (5 << 20)])
def test_a_head_that_is_no_document_is_named(tmp_path: Path, files: Files, text: bytes) -> None:
    assert refusal(tmp_path, {**files, "points.json": text}).file == "points.json"


@pytest.mark.parametrize(
    "name", ["points.json", "xyz.npy", "rgb.npy", "confidence.npy", "view-0.picture", "view-2.depth"]
)
def test_a_missing_file_is_named(tmp_path: Path, files: Files, name: str) -> None:
    refused = refusal(tmp_path, {each: content for each, content in files.items() if each != name})
    assert name in f"{refused.message} {refused.file}"


def test_a_file_too_many_and_a_way_out_are_refused(tmp_path: Path, files: Files) -> None:
    assert "more.npy" in refusal(tmp_path, {**files, "more.npy": b"x"}).message
    many = {f"more-{number}.npy": b"x" for number in range(200)}
    assert f"{len(files) + 200} entries" in refusal(tmp_path, {**files, **many}).message
    named = {("other.npy" if name == "rgb.npy" else name): content for name, content in files.items()}
    assert "other.npy" in refusal(tmp_path, named).message
    refusal(tmp_path, {**files, "../escaped": b"x"})
    assert not (tmp_path.parent / "escaped").exists()


def test_what_is_no_archive_is_refused(tmp_path: Path) -> None:
    (tmp_path / "bad.zip").write_bytes(b"no zip at all")
    with pytest.raises(EdgeError) as refused:
        read_prepared(tmp_path / "bad.zip", tmp_path / "scratch")
    assert refused.value.code == "POINTS_INVALID"


def test_read_as_a_capture_they_claim_no_scale(tmp_path: Path) -> None:
    """Without the workers' flag they are a phone's upload like any other."""
    write_prepared(prepared_points(pictured=False), tmp_path / "points.zip")
    unpack(tmp_path / "points.zip", tmp_path / "capture")
    capture = read_capture(tmp_path / "capture")
    assert (capture.kind, capture.format, capture.scale_confidence) == ("points", "npy", "unknown")


def test_points_are_kept_from_lease_to_lease(tmp_path: Path) -> None:
    assert load_points(tmp_path / "job" / "1.checkpoint", tmp_path / "none") is None
    older, newer = prepared_points(110), prepared_points(120)
    save_points(older, tmp_path / "job" / "9.checkpoint")
    save_points(newer, tmp_path / "job" / "10.checkpoint")
    found = load_points(tmp_path / "job" / "11.checkpoint", tmp_path / "first")
    assert found is not None
    assert same(found, newer)
    (tmp_path / "job" / "10.points").write_bytes(b"torn")
    assert load_points(tmp_path / "job" / "11.checkpoint", tmp_path / "second") is None
