"""What is cut out of a single photo: in a rectangle, in an ordinary scene, and where there is nothing."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from capture2vr.edge.arrays import Bools, Bytes
from capture2vr.edge.capture.nouns import Photo
from capture2vr.edge.errors import CaptureError
from capture2vr.edge.read_capture import read_capture
from capture2vr.edge.render.rays import RaycastingScene, pinhole
from capture2vr.edge.single_photo.cutout import CutOut, cut_out
from capture2vr.edge.single_photo.plain_background import segment_by_colour
from capture2vr.edge.single_photo.proposal import propose
from capture2vr.edge.single_photo.saliency import saliency
from capture2vr.order.photo_box import PhotoBox
from tests.support.photos.single_photos import photo
from tests.support.photos.walkaround import render_walkaround

W, H = 400, 300
VIEWS = 4


def in_photo(cut: CutOut, shape: tuple[int, int]) -> Bools:
    """The mask of a cut-out in the whole photo."""
    height, width = shape
    mask = np.zeros(shape, bool)
    left, right = (round(x * width) for x in (cut.area.left, cut.area.right))
    top, bottom = (round(y * height) for y in (cut.area.top, cut.area.bottom))
    part = cv2.resize(cut.mask.astype(np.uint8), (right - left, bottom - top), interpolation=cv2.INTER_NEAREST)
    mask[top:bottom, left:right] = part > 0
    return mask


def overlap(one: Bools, other: Bools) -> float:
    """Intersection over union."""
    return float((one & other).sum() / (one | other).sum())


def box_around(mask: Bools, *, loose: float = 0.0) -> PhotoBox:
    """The mask's bounding box, larger on every side by a share of its own sides."""
    return CutOut(np.zeros((*mask.shape, 3), np.uint8), mask).bounds().grown(loose)


def two_discs() -> tuple[Bytes, Bools, Bools]:
    """A red disc and a blue one before a wall, and the masks of both."""
    rgb = np.clip(np.random.default_rng(0).normal(210, 4, (H, W, 3)), 0, 255).astype(np.uint8)
    masks = []
    for centre, colour in (((120, 150), (180, 40, 30)), ((300, 150), (30, 60, 170))):
        drawn = cv2.circle(np.zeros((H, W), np.uint8), centre, 55, 1, cv2.FILLED) > 0
        rgb[drawn] = colour
        masks.append(drawn)
    return rgb, masks[0], masks[1]


@pytest.fixture(scope="module")
def scenes(tmp_path_factory: pytest.TempPathFactory) -> list[tuple[Photo, Bools]]:
    """Photos of a thing on a patterned table with boxes around it, each with the thing's mask."""
    walk = render_walkaround(tmp_path_factory.mktemp("scenes"), views=VIEWS, size=(480, 360))
    camera, thing = walk.intrinsics, RaycastingScene(walk.thing)
    x, y = (
        ((np.arange(side) - middle) / camera.fx).astype(np.float32)
        for side, middle in ((camera.width, camera.cx), (camera.height, camera.cy))
    )
    found = []
    for path, pose in zip(walk.photos, walk.camera_to_world, strict=True):
        hits = thing.cast(pose[None, :3, 3], pinhole(x, y, *pose[:3, :3].T))
        found.append((read_capture(path).photos[0], (hits.face >= 0).reshape(camera.height, camera.width)))
    return found


@pytest.mark.parametrize("which", [0, 1])
def test_the_rectangle_says_which_of_two_things_is_meant(which: int) -> None:
    rgb, *discs = two_discs()
    both = in_photo(cut_out(photo(rgb)), (H, W))
    assert overlap(both, discs[0] | discs[1]) > 0.9
    cut = cut_out(photo(rgb), box_around(discs[which], loose=0.1))
    assert overlap(in_photo(cut, (H, W)), discs[which]) > 0.95
    assert cut.warnings == ()


@pytest.mark.slow
@settings(max_examples=25, deadline=None)
@given(st.lists(st.floats(0, 1), min_size=4, max_size=4))
def test_nothing_outside_of_the_rectangle_belongs_to_the_thing(values: list[float]) -> None:
    left, right, top, bottom = *sorted(values[:2]), *sorted(values[2:])
    if right - left < 0.05 or bottom - top < 0.06:
        return
    rgb, *_ = two_discs()
    box = PhotoBox.of((left, top, right, bottom))
    try:
        cut = cut_out(photo(rgb), box)
    except CaptureError:  # nothing but the wall in it
        return
    drawn = cut.bounds()
    pixel = 1 / min(cut.mask.shape) * max(cut.area.width, cut.area.height)
    assert drawn.left > left - pixel
    assert drawn.top > top - pixel
    assert drawn.right < right + pixel
    assert drawn.bottom < bottom + pixel


@pytest.mark.parametrize("turns", [0, 1, 2, 3])
def test_the_rectangle_is_of_the_upright_photo(turns: int) -> None:
    rgb, red, _ = two_discs()
    upright = cut_out(photo(rgb), box_around(red, loose=0.1))
    turned = cut_out(photo(np.rot90(rgb, turns).copy(), turns=turns), box_around(red, loose=0.1))
    assert overlap(in_photo(turned, (H, W)), in_photo(upright, (H, W))) > 0.95


def test_a_small_rectangle_is_seen_as_finely_as_the_photo_shows_it() -> None:
    rgb, red, _ = two_discs()
    large = cv2.resize(rgb, (8 * W, 8 * H), interpolation=cv2.INTER_NEAREST)
    box = box_around(red, loose=0.1)
    fine, coarse = cut_out(photo(large), box), cut_out(photo(rgb), box)
    assert max(fine.mask.shape) == pytest.approx(320, abs=2)
    assert max(coarse.mask.shape) < 200
    assert overlap(in_photo(fine, (H, W)), red) > 0.97


def test_a_rectangle_of_the_whole_photo_is_none() -> None:
    rgb, *_ = two_discs()
    whole, none = cut_out(photo(rgb), PhotoBox(0, 0, 1, 1)), cut_out(photo(rgb))
    assert np.array_equal(whole.mask, none.mask)


def test_the_outline_runs_around_the_mask() -> None:
    rgb, red, _ = two_discs()
    cut = cut_out(photo(rgb), box_around(red, loose=0.1))
    canvas = np.zeros((H, W), np.uint8)
    for line in cut.outline():
        cv2.fillPoly(canvas, [np.round(np.array(line) * [W, H] - 0.5).astype(np.int32)], 1)
    assert overlap(canvas > 0, red) > 0.93
    assert len(cut.outline()) == 1
    assert len(cut.outline()[0]) < 60


@pytest.mark.slow
def test_an_ordinary_scene_gets_a_proposal_that_says_so(scenes: list[tuple[Photo, Bools]]) -> None:
    """Where the table's pattern is all around, nothing stands out; the thing is proposed all the same."""
    cuts = [(each, truth, cut_out(each)) for each, truth in scenes]
    doubtful = [cut for cut in cuts if cut[2].warnings]
    assert doubtful, "everything stood out"
    for each, truth, cut in doubtful:
        with pytest.raises(CaptureError):
            segment_by_colour(cut.rgb, each.name)
        (warning,) = cut.warnings
        assert each.name in warning
        said = PhotoBox.parse(warning.split("rectangle ")[1].split(". ")[0])
        assert np.allclose(said.values, box_around(truth).values, atol=0.1)


@pytest.mark.slow
def test_the_proposal_is_the_thing(scenes: list[tuple[Photo, Bools]]) -> None:
    overlaps = []
    for each, truth in scenes:
        rgb = each.load(320)
        small = cv2.resize(truth.astype(np.uint8), rgb.shape[1::-1], interpolation=cv2.INTER_AREA) > 0
        overlaps.append(overlap(propose(rgb, each.name)[0], small))
    assert np.mean(overlaps) > 0.85


@pytest.mark.slow
def test_a_loose_rectangle_in_an_ordinary_scene_finds_the_thing(scenes: list[tuple[Photo, Bools]]) -> None:
    for each, truth in scenes:
        cut = cut_out(each, box_around(truth, loose=0.1))
        assert overlap(in_photo(cut, truth.shape), truth) > 0.85


def sky(clouds: float) -> Bytes:
    """A sky that is lighter towards the horizon, with soft clouds."""
    y = np.linspace(0, 1, H)[:, None, None]
    blue = (1 - y) * np.array([85, 135, 215]) + y * np.array([150, 190, 235])
    rng = np.random.default_rng(3)
    soft = cv2.GaussianBlur(rng.normal(0, 1, (H, W)), (0, 0), 25)
    white = clouds * ((soft - soft.min()) / np.ptp(soft))[..., None]
    return np.clip(blue * (1 - white) + 240 * white + rng.normal(0, 2, (H, W, 3)), 0, 255).astype(np.uint8)


@pytest.mark.slow
@pytest.mark.parametrize("box", [None, PhotoBox(0.2, 0.2, 0.8, 0.8)], ids=["whole", "rectangle"])
@pytest.mark.parametrize(
    "rgb",
    [
        sky(0),
        sky(0.8),
        np.zeros((H, W, 3), np.uint8),
        np.random.default_rng(0).normal(4, 2, (H, W, 3)).clip(0, 255).astype(np.uint8),
        np.full((H, W, 3), 128, np.uint8),
        np.random.default_rng(0).integers(0, 255, (H, W, 3)).astype(np.uint8),
    ],
    ids=["sky", "clouds", "black", "lens cap", "grey", "noise"],
)
def test_where_there_is_nothing_a_sentence_says_so(rgb: Bytes, box: PhotoBox | None) -> None:
    with pytest.raises(CaptureError) as caught:
        cut_out(photo(rgb, name="sky.jpg"), box)
    assert caught.value.code == "CAPTURE_NO_OBJECT"
    assert caught.value.file == "sky.jpg"
    assert caught.value.message.startswith("shows nothing")
    assert caught.value.hints


def test_a_rectangle_of_a_few_pixels_is_told_its_size() -> None:
    rgb, *_ = two_discs()
    with pytest.raises(CaptureError, match="12 x 9 pixels"):
        cut_out(photo(rgb), PhotoBox(0.3, 0.5, 0.33, 0.53))


def test_a_rectangle_chooses_within_an_alpha_channel() -> None:
    rgb, red, blue = two_discs()
    alpha = np.where(red | blue, 255, 0).astype(np.uint8)
    cut = cut_out(replace(photo(rgb), load_alpha=lambda: alpha), box_around(blue))
    assert overlap(in_photo(cut, (H, W)), blue) > 0.95
    with pytest.raises(CaptureError, match="transparent everywhere in the rectangle"):
        cut_out(replace(photo(rgb), load_alpha=lambda: alpha), PhotoBox(0.0, 0.0, 0.1, 0.1))


def test_a_mask_of_another_shape_or_broken_is_not_used_and_said() -> None:
    rgb, _, blue = two_discs()
    wide = replace(photo(rgb, name="discs.jpg"), load_mask=lambda: np.ones((H, 3 * W), bool))

    def broken() -> Bools:
        raise CaptureError("IMAGE_UNREADABLE", "cannot be decoded", file="discs_mask.png")

    for masked, why in (
        (wide, f"{3 * W} × {H}"),
        (replace(wide, load_mask=broken), "discs_mask.png: cannot be decoded"),
    ):
        cut = cut_out(masked, box_around(blue))
        assert overlap(in_photo(cut, (H, W)), blue) > 0.95
        (warning,) = cut.warnings
        assert why in warning
    given = replace(wide, load_mask=lambda: blue)
    assert cut_out(given).warnings == ()
    assert overlap(in_photo(cut_out(given), (H, W)), blue) > 0.95


@pytest.mark.slow
def test_real_photos_of_ordinary_scenes_are_not_refused(data_dir: Path) -> None:
    """A statue before houses, and a white chair before a white curtain: proposed at least, and found in a rectangle."""
    statue = read_capture(data_dir / "photos_statue" / "images" / "IMG_3047.JPG").photos[0]
    proposed = cut_out(statue)
    assert proposed.warnings
    assert proposed.bounds().left < 0.55 < proposed.bounds().right
    room = read_capture(data_dir / "rgbd_livingroom" / "color" / "00000.jpg").photos[0]
    assert cut_out(room).mask.mean() > 0.01
    chair = cut_out(room, PhotoBox(0.47, 0.38, 0.97, 0.82))
    assert chair.mask.mean() > 0.2


def test_the_narrowest_photo_has_a_saliency() -> None:
    """Of a strip whose superpixels are all neighbours, scipy's shortest ways take another method."""
    assert saliency(np.full((8, 4000, 3), 99, np.uint8)).shape == (8, 4000)


@pytest.mark.parametrize(("width", "height"), [(1, 1), (3, 1), (1, 500), (7, 400)])
def test_a_photo_of_hardly_any_pixels_shows_nothing(width: int, height: int) -> None:
    with pytest.raises(CaptureError) as caught:
        cut_out(photo(np.full((height, width, 3), 99, np.uint8)))
    assert caught.value.code == "CAPTURE_NO_OBJECT"
    assert "too few" in str(caught.value)
