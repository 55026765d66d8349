"""What the camera in the page computes: movement between two frames, and when a photo is taken."""

from __future__ import annotations

import base64
from typing import Any

import cv2
import numpy as np
import pytest

from capture2vr.edge.arrays import Bytes
from tests.support.page_scripts import PageScripts

WIDTH, HEIGHT = 96, 72
_COMPARE = """async (pairs) => {
    const { frameOf, isPlain, motionBetween } = await import('/web/capture/frame-motion.js');
    const { FAR } = await import('/web/capture/shutter.js');
    const bytes = (text) => Uint8ClampedArray.from(atob(text), (each) => each.charCodeAt(0));
    const frames = pairs.map((pair) => pair.map(([text, width, height]) => frameOf(bytes(text), width, height)));
    return frames.map(([one, other]) => ({ plain: isPlain(one), motion: motionBetween(one, other, FAR) }));
}"""


def wall(seed: int = 0, size: tuple[int, int] = (WIDTH + 40, HEIGHT + 40)) -> Bytes:
    """(H,W) uint8 with detail of several sizes."""
    rng = np.random.default_rng(seed)
    width, height = size
    tones = [
        cv2.resize(rng.normal(size=(height // cell + 2, width // cell + 2)), size, interpolation=cv2.INTER_CUBIC)
        for cell in (3, 6, 12)
    ]
    return np.clip(128 + 25 * sum(tones), 0, 255).astype(np.uint8)


def seen(picture: Bytes, across: float = 0, down: float = 0) -> Bytes:
    """The frame of a camera that looks so many pixels beside the middle."""
    moved = np.array([[1.0, 0, -20 - across], [0, 1, -20 - down]])
    return np.asarray(cv2.warpAffine(picture, moved, (WIDTH, HEIGHT), flags=cv2.INTER_CUBIC))


def compared(scripts: PageScripts, *pairs: tuple[Bytes, Bytes]) -> list[dict[str, Any]]:
    def sent(grey: Bytes) -> list[object]:
        rgba = cv2.cvtColor(np.ascontiguousarray(grey), cv2.COLOR_GRAY2RGBA)
        return [base64.b64encode(rgba.tobytes()).decode(), grey.shape[1], grey.shape[0]]

    found: list[dict[str, Any]] = scripts.evaluate(_COMPARE, [[sent(one), sent(other)] for one, other in pairs])
    return found


def test_a_shift_is_measured_to_a_fraction_of_a_pixel(scripts: PageScripts) -> None:
    rng = np.random.default_rng(1)
    shifts = [(0.0, 0.0), (0.4, 0.0), *map(tuple, rng.uniform(-4, 4, (10, 2)))]
    picture = wall()
    for (across, down), found in zip(
        shifts, compared(scripts, *[(seen(picture), seen(picture, *shift)) for shift in shifts]), strict=True
    ):
        assert found["motion"]["size"] * WIDTH == pytest.approx(np.hypot(across, down), abs=0.25)
        assert found["motion"]["lost"] < 0.35, "blocks at the border leave the picture"


def test_noise_exposure_and_brightness_are_no_movement(scripts: PageScripts) -> None:
    picture = seen(wall()).astype(np.float32)
    noisy = picture + np.random.default_rng(2).normal(0, 3, picture.shape)
    shaded = picture * np.linspace(0.7, 1.1, WIDTH)
    changed = [np.clip(each, 0, 255).astype(np.uint8) for each in (noisy, 0.7 * picture, picture + 30, shaded)]
    for found in compared(scripts, *[(picture.astype(np.uint8), each) for each in changed]):
        assert found["motion"]["size"] * WIDTH < 0.3
        assert found["motion"]["moved"] < 0.1


def test_another_picture_is_moved_and_a_bare_wall_says_nothing(scripts: PageScripts) -> None:
    bare = np.full((HEIGHT, WIDTH), 120, np.uint8)
    dark = (seen(wall()) * 0.03).astype(np.uint8)
    other, still, plain, night = compared(
        scripts, (seen(wall()), seen(wall(7))), (seen(wall()), seen(wall())), (bare, bare), (dark, dark)
    )
    assert other["motion"]["moved"] > 0.9
    assert (still["motion"]["moved"], still["plain"]) == (0, False)
    assert (plain["plain"], plain["motion"], night["plain"]) == (True, None, True)


_SHUTTER = """async ({ steps, ms }) => {
    const { newShutter, afterFrame, afterPhoto, afterRefusal } = await import('/web/capture/shutter.js');
    let shutter = newShutter();
    return steps.map(({ speed = 0, moved = 0, heading = null, plain = false, late = 0, photo = '' }) => {
      if (photo) shutter = photo === 'good' ? afterPhoto(shutter) : afterRefusal(shutter);
      const since = plain ? null : { size: speed * (ms + late) / 1000, lost: 0, moved: 0 };
      const motion = { since, fromPhoto: plain ? null : { size: 0, lost: 0, moved }, plain };
      shutter = afterFrame(shutter, { ms: ms + late, heading, motion });
      return shutter.cue;
    });
}"""


def cues(scripts: PageScripts, *steps: dict[str, Any]) -> list[str]:
    """What the camera waits for after each frame, a tenth of a second apart."""
    found: list[str] = scripts.evaluate(_SHUTTER, {"steps": steps, "ms": 100})
    return found


REST: dict[str, Any] = {"speed": 0.01}
GOOD: dict[str, Any] = {**REST, "photo": "good"}


def test_the_first_photo_waits_only_for_a_rest(scripts: PageScripts) -> None:
    assert cues(scripts, {"speed": 1}, REST, REST, REST) == ["hold", "hold", "hold", "take"]


def test_the_next_one_waits_for_a_step_by_the_pictures_or_by_the_compass(scripts: PageScripts) -> None:
    step = {**REST, "moved": 0.8}
    assert cues(scripts, REST, REST, REST, GOOD, *[REST] * 5, step) == [*["hold"] * 2, "take", *["move"] * 6, "take"]
    north, east = {**REST, "heading": 355}, {**REST, "heading": 8}
    turned = [north, north, north, {**north, "photo": "good"}, north, east, {**east, "heading": 350}]
    assert cues(scripts, *turned)[3:] == ["move", "move", "take", "move"], "13 degrees, across north; then 5"


def test_a_refused_photo_is_taken_again_after_a_while_without_a_step(scripts: PageScripts) -> None:
    found = cues(scripts, REST, REST, REST, {**REST, "photo": "refused"}, *[REST] * 20)
    assert found[3:17] == ["wait"] * 14
    assert found[17:] == ["take"] * 7


def test_a_pause_of_the_page_or_a_wall_is_no_rest(scripts: PageScripts) -> None:
    late = {**REST, "late": 5_000}
    assert cues(scripts, REST, REST, late, REST) == ["hold"] * 4
    assert cues(scripts, REST, REST, {"plain": True}, REST) == ["hold", "hold", "plain", "hold"]


def test_no_photo_is_ever_taken_while_the_phone_moves(scripts: PageScripts) -> None:
    rng = np.random.default_rng(3)
    steps = [{"speed": float(speed), "moved": 1.0} for speed in rng.choice([0.01, 0.05, 0.08, 0.5], 400)]
    for number, cue in enumerate(cues(scripts, *steps)):
        rested = all(step["speed"] < 0.06 for step in steps[max(0, number - 2) : number + 1])
        assert (cue == "take") == (rested and number >= 2)
