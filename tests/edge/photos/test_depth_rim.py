"""Stereo's rim around a thing: what has the background's colour goes, the thing stays."""

from __future__ import annotations

import numpy as np
import pytest

from capture2vr.edge.arrays import Bools, Bytes, Floats
from capture2vr.edge.photos.depth_rim import remove_rim

_SIZE = (120, 160)
_RIM = 3  # pixels that the depth reaches too far


def _disc(radius: float) -> Bools:
    rows, columns = np.mgrid[: _SIZE[0], : _SIZE[1]]
    return np.asarray(np.hypot(rows - 60, columns - 80) < radius)


def _picture(thing: Bools, *, thing_rgb: tuple[int, int, int], beyond: tuple[int, int, int]) -> Bytes:
    rng = np.random.default_rng(0)
    rgb = np.where(thing[..., None], thing_rgb, beyond) + rng.normal(0, 4, (*_SIZE, 3))
    return np.clip(rgb, 0, 255).astype(np.uint8)


def _depth(thing: Bools, beyond: float) -> Floats:
    """A slanted surface 1 m away, before one at `beyond` m (0: where nothing is known)."""
    slant = np.broadcast_to(np.linspace(0.98, 1.02, _SIZE[1]), _SIZE)
    return np.where(thing, slant, beyond).astype(np.float32)


@pytest.mark.parametrize("beyond", [0.0, 2.0], ids=["nothing behind", "a wall behind"])
def test_a_rim_of_the_backgrounds_colour_goes_and_the_thing_stays(beyond: float) -> None:
    thing = _disc(40)
    rgb = _picture(thing, thing_rgb=(150, 90, 60), beyond=(110, 120, 135))
    fat = _depth(_disc(40 + _RIM), beyond)
    kept = remove_rim(fat, rgb)
    surface = (kept > 0) & (kept < 1.5)
    assert (surface & ~thing).sum() < 0.05 * (_disc(40 + _RIM) & ~thing).sum()
    assert (surface & thing).sum() > 0.99 * thing.sum()
    assert (kept[surface] == fat[surface]).all()
    assert (kept[fat == beyond] == fat[fat == beyond]).all(), "the background lost something"


def test_what_cannot_be_told_from_the_background_stays() -> None:
    rgb = _picture(_disc(40), thing_rgb=(120, 120, 120), beyond=(120, 120, 120))
    depth = _depth(_disc(40), 0.0)
    assert (remove_rim(depth, rgb) > 0).sum() > 0.99 * (depth > 0).sum()


def test_a_patch_without_depth_on_the_thing_is_no_background() -> None:
    shine = _disc(6)
    rgb = _picture(~_disc(9), thing_rgb=(90, 60, 50), beyond=(240, 240, 240))
    depth = _depth(~shine, 0.0)
    assert (remove_rim(depth, rgb) == depth).all()


def test_a_surface_without_an_outline_stays() -> None:
    rgb = _picture(_disc(30), thing_rgb=(200, 60, 50), beyond=(40, 40, 240))
    depth = _depth(np.ones(_SIZE, bool), 0.0)
    assert (remove_rim(depth, rgb) == depth).all()


def test_a_thing_thinner_than_the_rim_stays() -> None:
    leaf = np.zeros(_SIZE, bool)
    leaf[58:62] = True
    rgb = _picture(leaf, thing_rgb=(60, 160, 60), beyond=(200, 200, 200))
    depth = _depth(leaf, 0.0)
    assert (remove_rim(depth, rgb) == depth).all()


@pytest.mark.parametrize("beyond", [0.0, 2.0], ids=["nothing behind", "a cloth behind"])
def test_the_rim_of_a_stem_goes_and_the_stem_stays(beyond: float) -> None:
    stem, rim = np.zeros(_SIZE, bool), np.zeros(_SIZE, bool)
    stem[58:60], rim[54:64] = True, True
    rgb = _picture(stem, thing_rgb=(90, 160, 60), beyond=(20, 20, 24))
    kept = remove_rim(_depth(rim, beyond), rgb)
    near = (kept > 0) & (kept < 1.5)
    assert (near & stem).sum() > 0.95 * stem.sum()
    assert (near & ~stem).sum() < 0.05 * (rim & ~stem).sum()
