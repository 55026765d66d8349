"""IS-Net's pre- and post-processing on graphs whose outputs are known: each fault in it is noticed."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache

import cv2
import numpy as np
import pytest

from capture2vr.edge.arrays import Bytes, Floats, Tick, no_tick
from capture2vr.edge.models.isnet import SIDE, IsNet
from capture2vr.edge.models.nouns import ModelError, RunGraph
from tests.support.photos.mask_graphs import constant_mask, require_onnx, run_here, scaled_channel

pytestmark = pytest.mark.usefixtures("onnx_is_there")

H, W, BLOCK = 192, 320, 32
SCALE, SHIFT = 0.7, 0.1  # so that the mask's values are no multiples of 1/255
ALONG = (np.arange(SIDE) / (SIDE - 1)).astype(np.float32)
Change = Callable[[Floats], Floats]


@pytest.fixture(scope="module")
def onnx_is_there() -> None:
    require_onnx()
    graphs()


def blocks() -> Bytes:
    """A photo of blocks in colours that differ in every channel."""
    rng = np.random.default_rng(7)
    coarse = rng.integers(0, 256, (H // BLOCK, W // BLOCK, 3)).astype(np.uint8)
    return np.asarray(coarse.repeat(BLOCK, axis=0).repeat(BLOCK, axis=1), np.uint8)


def inside() -> np.ndarray:
    """The pixels that no resizing mixes with another block's."""
    row, column = (np.arange(side) % BLOCK for side in (H, W))
    clear = [(each > 2) & (each < BLOCK - 3) for each in (row, column)]
    return np.asarray(clear[0][:, None] & clear[1][None])


@cache
def graphs() -> dict[str, RunGraph]:
    """Graphs that show what reaches them, and where."""
    shown: dict[str, RunGraph] = {f"channel {at}": run_here(scaled_channel(at, SCALE, SHIFT)) for at in range(3)}
    return {**shown, "columns": run_here(constant_mask(ALONG)), "rows": run_here(constant_mask(ALONG[:, None]))}


def mask_of(run: RunGraph, photo: Bytes) -> Floats:
    (view,) = IsNet(run)([photo], no_tick)
    assert view.mask is not None
    return view.mask


def is_right(through: Callable[[RunGraph], RunGraph] = lambda run: run) -> bool:
    """Whether masks lie where the photo has what they show, with a fault between the class and the graph."""
    photo = blocks()
    try:
        found = {name: mask_of(through(run), photo) for name, run in graphs().items()}
    except ModelError:  # values that no mask has
        return False
    wanted = {f"channel {at}": photo[..., at] / 255 * SCALE + SHIFT for at in range(3)}
    shown = all(np.abs(found[name] - each)[inside()].max() < 1e-4 for name, each in wanted.items())
    x, y = ((((np.arange(side) + 0.5) / side * SIDE) - 0.5) / (SIDE - 1) for side in (W, H))
    placed = np.abs(found["columns"] - x[None]).max() < 6e-4 and np.abs(found["rows"] - y[:, None]).max() < 6e-4
    return bool(shown and placed and all(each.shape == (H, W) for each in found.values()))


def test_the_graph_sees_the_whole_photo_and_its_mask_lies_on_it() -> None:
    assert is_right()


def fault(before: Change = lambda x: x, after: Change = lambda y: y) -> Callable[[RunGraph], RunGraph]:
    """Change what goes into a graph (1,3,S,S), and what comes out of it (1,1,S,S)."""

    def through(run: RunGraph) -> RunGraph:
        def faulty(inputs: Mapping[str, Floats], tick: Tick) -> Mapping[str, Floats]:
            x = np.ascontiguousarray(before(inputs["input"]), np.float32)
            return {"output": after(run({"input": x}, tick)["output"])}

        return faulty

    return through


def turned(x: Floats) -> Floats:
    return x.transpose(0, 1, 3, 2)


def padded(x: Floats) -> Floats:
    """As if the photo kept its shape, with a band below it."""
    rows = round(SIDE * H / W)
    low = cv2.resize(x[0].transpose(1, 2, 0), (SIDE, rows), interpolation=cv2.INTER_AREA)
    return np.pad(low, ((0, SIDE - rows), (0, 0), (0, 0))).transpose(2, 0, 1)[None]


def without_band(y: Floats) -> Floats:
    return np.asarray(cv2.resize(y[0, 0, : round(SIDE * H / W)], (SIDE, SIDE)))[None, None]


MEAN, SPREAD = (np.array(each, np.float32)[:, None, None] for each in ((0.485, 0.456, 0.406), (0.229, 0.224, 0.225)))
FAULTS = {
    "axes: rows and columns of the input": fault(turned),
    "axes: rows and columns of the output": fault(after=turned),
    "axes: rows and columns of both": fault(turned, turned),
    "axes: channels last": fault(lambda x: x.transpose(0, 2, 3, 1).reshape(x.shape)),
    "axes: upside down": fault(lambda x: x[:, :, ::-1]),
    "axes: mirrored, both": fault(lambda x: x[..., ::-1], lambda y: y[..., ::-1]),
    "padding: a band below, input alone": fault(padded),
    "padding: a band below, both": fault(padded, without_band),
    "padding: the output is shifted by a pixel": fault(after=lambda y: np.roll(y, 1, axis=3)),
    "scale: 0 to 1": fault(lambda x: (x * 256 + 128) / 255),
    "scale: by 255": fault(lambda x: x * 256 / 255),
    "scale: not centred": fault(lambda x: x + 0.5),
    "scale: ImageNet's mean": fault(lambda x: ((x * 256 + 128) / 255 - MEAN) / SPREAD),
    "scale: the output stretched to 0…1": fault(after=lambda y: (y - y.min()) / np.ptp(y)),
    "scale: the output turned": fault(after=lambda y: 1 - y),
    "channels: BGR": fault(lambda x: x[:, ::-1]),
    "channels: grey": fault(lambda x: x.mean(axis=1, keepdims=True).repeat(3, axis=1)),
    "precision: the input in steps of 1/32": fault(lambda x: np.round(x * 32) / 32),
    "precision: the output in 8 bits": fault(after=lambda y: np.round(y * 255).astype(np.uint8) / np.float32(255)),
    "precision: the output is only yes and no": fault(after=lambda y: (y > 0.5).astype(np.float32)),
}


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_is_noticed(name: str) -> None:
    assert not is_right(FAULTS[name])


@pytest.mark.parametrize("size", [(1, 1), (3, 900), (1200, 1100)])
def test_a_photo_of_any_size_has_a_mask_of_its_own_size(size: tuple[int, int]) -> None:
    photo = np.full((*size, 3), 51, np.uint8)
    mask = mask_of(graphs()["channel 1"], photo)
    assert mask.shape == size
    assert np.abs(mask - (51 / 255 * SCALE + SHIFT)).max() < 1e-3


def test_photos_keep_their_order_and_the_time_goes_on() -> None:
    heard: list[float] = []

    def run(inputs: Mapping[str, Floats], tick: Tick) -> Mapping[str, Floats]:
        tick(1.0)
        return graphs()["channel 0"](inputs, tick)

    photos = [np.full((4, 4, 3), level, np.uint8) for level in (0, 255)]
    dark, bright = IsNet(run)(photos, heard.append)
    assert heard == [0.5, 1.0]
    assert dark.mask is not None
    assert bright.mask is not None
    assert (dark.mask.max(), bright.mask.min()) == pytest.approx((SHIFT, SCALE + SHIFT), abs=1e-3)


@pytest.mark.parametrize("shift", [-0.2, 0.2])
def test_what_is_no_mask_is_refused(shift: float) -> None:
    with pytest.raises(ModelError, match="IS-Net gave values from") as caught:
        mask_of(run_here(scaled_channel(0, 1.0, shift)), blocks())
    assert caught.value.code == "MODEL_FAILED"
