"""MoGe-2's pre- and post-processing on graphs whose outputs are known: each fault in it is noticed."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from capture2vr.edge.arrays import Bytes, Floats, Ints, Tick, no_tick
from capture2vr.edge.models import moge
from capture2vr.edge.models.graph import Graph
from capture2vr.edge.models.moge import TOKENS, MoGe, picture_size
from capture2vr.edge.models.nouns import LearnedView, ModelError, RunGraph
from tests.support.photos.depth_graphs import Seen
from tests.support.photos.mask_graphs import card_of, model_of, node, require_onnx, run_here

pytestmark = pytest.mark.usefixtures("onnx_is_there")

H, W, BLOCK = 192, 320, 32
SEEN = Seen(bend=(0.4, -0.7))
Change = Callable[[Floats], Floats]
Through = Callable[[RunGraph], RunGraph]


@pytest.fixture(scope="module")
def onnx_is_there() -> None:
    require_onnx()


@cache
def known() -> RunGraph:
    return run_here(SEEN.graph())


@cache
def blocks() -> Bytes:
    """A photo of blocks in colours that differ in every channel; where blue is weak there is no surface."""
    coarse = np.random.default_rng(7).integers(0, 256, (H // BLOCK, W // BLOCK, 3)).astype(np.uint8)
    return np.asarray(coarse.repeat(BLOCK, axis=0).repeat(BLOCK, axis=1), np.uint8)


def inside() -> np.ndarray:
    """The pixels that no resizing mixes with another block's."""
    row, column = (np.arange(side) % BLOCK for side in (H, W))
    clear = [(each > 2) & (each < BLOCK - 3) for each in (row, column)]
    return np.asarray(clear[0][:, None] & clear[1][None])


def view_of(run: RunGraph, photo: Bytes) -> LearnedView:
    (view,) = MoGe(run)([photo], no_tick)
    return view


def normals_of(shape: tuple[int, ...]) -> Floats:
    height, width = shape[:2]
    x, y = ((2 * np.arange(side) + 1 - side) / np.hypot(height, width) for side in (width, height))
    leaning = np.stack(np.broadcast_arrays(SEEN.bend[0] * x[None], SEEN.bend[1] * y[:, None], -1.0), axis=-1)
    return np.asarray(leaning / np.linalg.norm(leaning, axis=-1, keepdims=True))


def is_right(through: Through = lambda run: run) -> bool:
    """Whether depth, normals and focal length are the photo's, with a fault between the class and the graph."""
    photo = blocks()
    try:
        view = view_of(through(known()), photo)
    except ModelError:  # values that no camera sees
        return False
    if view.depth_m is None or view.normals is None:
        return False
    surface = photo[..., 2] > 127.5
    depth = np.where(surface, SEEN.depth_of(photo), 0)
    normals = np.where(surface[..., None], normals_of(photo.shape), 0)
    return bool(
        np.abs(view.depth_m - depth)[inside()].max() < 3e-5
        and np.abs(view.normals - normals)[inside()].max() < 2e-3
        and abs(view.focal_px / SEEN.focal_px(photo.shape) - 1) < 2e-3
        and view.depth_m.shape == (H, W)
    )


def test_depth_normals_and_focal_length_are_those_of_the_photo() -> None:
    assert is_right()


def fault(before: Change = lambda x: x, after: Mapping[str, Change] | None = None, tokens: int = TOKENS) -> Through:
    """Change what goes into a graph (1,3,h,w), and what comes out of it by name."""

    def through(run: RunGraph) -> RunGraph:
        def faulty(inputs: Mapping[str, Floats | Ints], tick: Tick) -> Mapping[str, Floats]:
            image = np.ascontiguousarray(before(np.asarray(inputs["image"])), np.float32)
            found = run({"image": image, "num_tokens": np.array(tokens, np.int64)}, tick)
            return {**found, **{name: np.asarray(change(found[name])) for name, change in (after or {}).items()}}

        return faulty

    return through


def half(x: Floats) -> Floats:
    return x.astype(np.float16).astype(np.float32)


def padded(x: Floats) -> Floats:
    """As if a band of 28 pixels below were padding."""
    return np.concatenate([x[:, :, 28:], np.zeros_like(x[:, :, :28])], axis=2)


def points(change: Change) -> Through:
    return fault(after={"points": change})


MEAN, SPREAD = (np.array(each, np.float32)[:, None, None] for each in ((0.485, 0.456, 0.406), (0.229, 0.224, 0.225)))
FAULTS: dict[str, Through] = {
    "axes: rows and columns of the input": fault(lambda x: x.transpose(0, 1, 3, 2)),
    "axes: channels last": fault(lambda x: x.transpose(0, 2, 3, 1).reshape(x.shape)),
    "axes: upside down": fault(lambda x: x[:, :, ::-1]),
    "axes: mirrored, both": fault(lambda x: x[..., ::-1], {"points": lambda y: y[:, :, ::-1]}),
    "axes: x and y of the points": points(lambda y: y[..., [1, 0, 2]]),
    "axes: z first": points(lambda y: y[..., [2, 0, 1]]),
    "axes: y of the points upwards": points(lambda y: y * np.float32([1, -1, 1])),
    "axes: points towards the viewer": points(lambda y: y * np.float32([1, -1, -1])),
    "axes: x and y of the normals": fault(after={"normal": lambda y: y[..., [1, 0, 2]]}),
    "axes: normals into the surface": fault(after={"normal": lambda y: -y}),
    "axes: rows and columns of the mask": fault(after={"mask": lambda y: y.reshape(1, y.shape[2], y.shape[1])}),
    "padding: a band below": fault(padded),
    "padding: the points are shifted by four pixels": points(lambda y: np.roll(y, 4, axis=2)),
    "padding: the mask is shifted by a patch": fault(after={"mask": lambda y: np.roll(y, 14, axis=1)}),
    "scale: 0 to 255": fault(lambda x: x * 255),
    "scale: of 256 levels": fault(lambda x: x * 255 / 256),
    "scale: ImageNet's mean": fault(lambda x: (x - MEAN) / SPREAD),
    "scale: metres left out": fault(after={"scale": np.ones_like}),
    "scale: metres taken for a logarithm": fault(after={"scale": np.exp}),
    "scale: the mask turned": fault(after={"mask": lambda y: 1 - y}),
    "scale: the mask before its sigmoid": fault(after={"mask": lambda y: np.log(y + 1e-6)}),
    "channels: BGR": fault(lambda x: x[:, ::-1]),
    "channels: grey": fault(lambda x: x.mean(axis=1, keepdims=True).repeat(3, axis=1)),
    "precision: the input in 16 bits": fault(half),
    "precision: the points in 16 bits": points(half),
    "precision: the points in 8 bits": points(lambda y: (np.round(y * 255) / 255).astype(np.float32)),
    "patches: another number": fault(tokens=1200),
}


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_is_noticed(name: str) -> None:
    assert not is_right(FAULTS[name])


STEPS: dict[str, tuple[str, Callable[[Any], Any]]] = {
    "shift left out": ("_camera", lambda step: lambda *found: (step(*found)[0], 0.0)),
    "shift turned": ("_camera", lambda step: lambda *found: (step(*found)[0], -step(*found)[1])),
    "focal length of the whole diagonal": (
        "_camera",
        lambda step: lambda *found: (2 * step(*found)[0], step(*found)[1]),
    ),
    "pixels taken beside their middles": (
        "_nearest",
        lambda step: lambda count, side: np.minimum(step(count, side) + 4, side - 1),
    ),
    "a stretched picture": ("picture_size", lambda step: lambda shape: (518, 518)),
    "surface from a tenth on": ("_SURFACE", lambda _: 0.1),
}


@pytest.mark.parametrize("name", STEPS)
def test_a_fault_of_a_step_is_noticed(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    step, faulty = STEPS[name]
    monkeypatch.setattr(moge, step, faulty(getattr(moge, step)))
    assert not is_right()


@pytest.mark.parametrize("shape", [(514, 686), (192, 320), (3000, 2000), (1, 1)])
def test_the_picture_has_the_photo_s_shape_and_so_many_patches(shape: tuple[int, int]) -> None:
    width, height = picture_size(shape)
    assert width * height / 14**2 == pytest.approx(TOKENS, rel=2e-3)
    assert width / height == pytest.approx(shape[1] / shape[0], rel=3e-3)


@pytest.mark.parametrize("shift", [-0.3, 0.0, 0.7])
@pytest.mark.parametrize("focal", [0.4, 3.0])
def test_camera_and_shift_are_found(shift: float, focal: float) -> None:
    seen = Seen(shift=shift, focal=focal)
    view = view_of(run_here(seen.graph()), blocks())
    assert view.focal_px == pytest.approx(seen.focal_px((H, W)), rel=2e-3)
    assert view.depth_m is not None
    surface = (blocks()[..., 2] > 127.5) & inside()
    assert np.abs(view.depth_m - seen.depth_of(blocks()))[surface].max() < 2e-4


def test_a_few_points_that_err_do_not_move_the_camera_far() -> None:
    def with_noise(y: Floats) -> Floats:
        return y * (1 + 0.02 * np.random.default_rng(1).standard_normal(y.shape)).astype(np.float32)

    view = view_of(points(with_noise)(known()), blocks())
    assert view.focal_px == pytest.approx(SEEN.focal_px((H, W)), rel=0.05)


def test_where_there_is_no_surface_nothing_is_proposed() -> None:
    dark = blocks().copy()
    dark[..., 2] = 0
    assert view_of(known(), dark) == LearnedView()


REFUSED: dict[str, tuple[Mapping[str, Change], str]] = {
    "another shape": ({"points": lambda y: y[:, 1:]}, "MoGe-2 gave results of other shapes"),
    "no size": ({"scale": lambda y: -y}, "metres to a unit"),
    "no mask": ({"mask": lambda y: y + 2}, "where a mask has 0 to 1"),
    "no camera": ({"points": lambda y: y * np.float32([-1, -1, 1])}, "points that no camera sees so"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_no_camera_sees_is_refused(name: str) -> None:
    after, words = REFUSED[name]
    with pytest.raises(ModelError, match=words) as caught:
        view_of(fault(after=after)(known()), blocks())
    assert caught.value.code == "MODEL_FAILED"


def test_photos_keep_their_order_and_the_time_goes_on() -> None:
    heard: list[float] = []

    def run(inputs: Mapping[str, Floats | Ints], tick: Tick) -> Mapping[str, Floats]:
        tick(1.0)
        return known()(inputs, tick)

    flat = [np.full((40, 60, 3), (level, 0, 255), np.uint8) for level in (0, 255)]
    near, far = MoGe(run)(flat, heard.append)
    assert heard == [0.5, 1.0]
    assert near.depth_m is not None
    assert far.depth_m is not None
    first = SEEN.near - SEEN.shift * SEEN.factor  # what is flat tells no shift, so it has none
    assert (near.depth_m.mean(), far.depth_m.mean()) == pytest.approx((first, first + SEEN.span), abs=1e-3)


def in_a_file(folder: Path, content: bytes) -> Graph:
    card = card_of(content, "moge-2-small")
    (folder / card.file).write_bytes(content)
    return Graph(card, folder / card.file)


@pytest.mark.slow
@pytest.mark.essential
def test_the_child_takes_pictures_of_any_size_and_whole_numbers(tmp_path: Path) -> None:
    graph = in_a_file(tmp_path, SEEN.graph())
    graph.check()
    for shape in ((40, 60), (75, 50)):
        photo = np.random.default_rng(3).integers(0, 256, (*shape, 3)).astype(np.uint8)
        view, here = view_of(graph.run, photo), view_of(known(), photo)
        assert view.focal_px == here.focal_px
        assert np.array_equal(view.depth_m, here.depth_m)


@pytest.mark.slow
def test_a_file_for_pictures_of_one_size_is_refused_before_it_runs(tmp_path: Path) -> None:
    size = {"FLOAT": [1, 3, 518, 518], "INT64": []}
    inputs, outputs = {"image": "FLOAT", "num_tokens": "INT64"}, {"points": "FLOAT"}
    ends = ({name: (kind, size[kind]) for name, kind in side.items()} for side in (inputs, outputs))
    graph = in_a_file(tmp_path, model_of([node("Neg", ("image",), "points")], {}, *ends, 15))
    with pytest.raises(ModelError, match=r"image \[any, 3, any, any\] float, image \[1, 3, 518, 518\] float"):
        graph.check()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("inputs", "words"),
    [
        ({"image": ("FLOAT", ["batch", "height", "width"])}, r"image \[any, 3, any, any\] float, image \['batch'"),
        ({"num_tokens": ("INT32", [])}, r"num_tokens \[\] int64, num_tokens \[\] int32"),
        ({"num_tokens": ("INT64", [1])}, r"num_tokens \[\] int64, num_tokens \[1\] int64"),
    ],
    ids=["another rank", "another type", "a row of numbers"],
)
def test_a_file_with_other_inputs_is_refused_before_it_runs(tmp_path: Path, inputs: Any, words: str) -> None:
    graph = in_a_file(tmp_path, SEEN.graph(**inputs))
    with pytest.raises(ModelError, match=words) as caught:
        graph.check()
    assert caught.value.code == "MODEL_UNAVAILABLE"
