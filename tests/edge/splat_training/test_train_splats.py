"""Training makes splats look like photos that it has not seen; what it cannot know it leaves alone."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import torch

from capture2vr.edge.arrays import Bytes, Floats
from capture2vr.edge.errors import EdgeError
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.render.posed_picture import PosedPicture
from capture2vr.edge.splat_training.splat_rendering import PinholeView, SplatTensors, draw_splats
from capture2vr.edge.splat_training.train_splats import train_splats
from capture2vr.edge.splats.surface_splats import Splats, cover_with_splats

WIDTH, HEIGHT, FOCAL = 108, 81, 120.0
BACKGROUND = np.array([40, 60, 80], np.uint8)
COUNT, STEPS = 400, 150


def sheet(width: float = 0.3) -> Mesh:
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * [width, 0.2, 0.0]
    return Mesh(corners, np.array([[0, 1, 2], [0, 2, 3]]))


def striped(splats: Splats) -> Splats:
    """The same with stripes of red and green along x."""
    red = np.sin(splats.xyz[:, 0] * 40) > 0
    return replace(splats, rgb=np.where(red[:, None], [200, 40, 40], [40, 180, 60]).astype(np.uint8))


def camera(angle: float) -> Floats:
    """From the sheet's frame to a camera that looks at it from a metre away."""
    pose = np.eye(4)
    pose[:3, :3] = [[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]]
    pose[2, 3] = 1.0
    return pose


def drawn(splats: Splats, pose: Floats) -> Bytes:
    """What a camera sees of splats, before the background."""
    tensors = SplatTensors.of(splats, torch.device("cpu"))
    focal, middle = torch.tensor([FOCAL, FOCAL]), torch.tensor([WIDTH / 2, HEIGHT / 2])
    view = PinholeView(torch.tensor(pose, dtype=torch.float32), focal, middle, WIDTH, HEIGHT)
    with torch.no_grad():
        colours, covered = draw_splats(tensors, view)
    picture = 255 * colours.numpy() + (1 - covered.numpy()[..., None]) * BACKGROUND
    found: Bytes = np.rint(picture).clip(0, 255).astype(np.uint8)
    return found


def photo(rgb: Bytes, pose: Floats, depth: Floats | None = None) -> PosedPicture:
    load_depth = None if depth is None else partial(np.array, depth)
    focal = np.array([FOCAL / WIDTH, FOCAL / HEIGHT])
    return PosedPicture(pose, focal, np.array([0.5, 0.5]), partial(np.array, rgb), load_depth)


def photos(thing: Splats, change: Callable[[int, Bytes], Bytes] = lambda number, rgb: rgb) -> list[PosedPicture]:
    angles = np.linspace(-0.6, 0.6, 7)
    return [photo(change(n, drawn(thing, camera(angle))), camera(angle)) for n, angle in enumerate(angles)]


def reach(splats: Splats) -> float:
    """How far from the middle along x splats show something."""
    return float((np.abs(splats.xyz[:, 0]) + splats.scale.max(axis=1)).max())


def error(splats: Splats, thing: Splats, angles: Sequence[float] = (-0.35, 0.05, 0.45)) -> float:
    """Mean difference, in bytes, from views that no photo was taken from."""
    pairs = [(drawn(splats, camera(angle)), drawn(thing, camera(angle))) for angle in angles]
    return float(np.mean([np.abs(one.astype(float) - other).mean() for one, other in pairs]))


@pytest.mark.slow
def test_colours_come_from_the_photos() -> None:
    start = cover_with_splats(sheet(), COUNT)
    thing = striped(start)
    trained = train_splats(start, sheet(), photos(thing), steps=STEPS)
    assert error(trained, thing) < 0.25 * error(start, thing)


@pytest.mark.slow
def test_splats_grow_beyond_the_mesh_where_the_photos_show_more() -> None:
    thing = striped(cover_with_splats(sheet(0.33), COUNT))
    start = cover_with_splats(sheet(), COUNT)
    trained = train_splats(start, sheet(), photos(thing), steps=STEPS)
    assert reach(trained) > reach(start) + 0.005
    assert error(trained, thing) < 0.9 * error(striped(start), thing)


@pytest.mark.slow
def test_photos_of_other_exposures_give_the_same_colours() -> None:
    start = cover_with_splats(sheet(), COUNT)
    thing = striped(start)

    def exposed(number: int, rgb: Bytes) -> Bytes:
        changed: Bytes = np.rint(rgb * (0.85 + 0.05 * number)).clip(0, 255).astype(np.uint8)
        return changed

    trained = train_splats(start, sheet(), photos(thing, exposed), steps=STEPS)
    assert error(trained, thing) < 0.35 * error(start, thing)


@pytest.mark.slow
def test_what_stands_before_the_thing_is_not_painted_on_it() -> None:
    start = cover_with_splats(sheet(), COUNT)
    thing = striped(start)
    post = np.zeros((HEIGHT, WIDTH), bool)
    post[:, WIDTH // 2 - 9 : WIDTH // 2 + 9] = True
    depth = np.where(post, 0.5, 0.0).astype(np.float32)
    taken = []
    for angle in np.linspace(-0.6, 0.6, 7):
        rgb = drawn(thing, camera(angle))
        rgb[post] = (0, 0, 255)
        taken.append((rgb, camera(angle)))
    known = train_splats(start, sheet(), [photo(*each, depth) for each in taken], steps=STEPS)
    unknown = train_splats(start, sheet(), [photo(*each) for each in taken], steps=STEPS)
    assert known.rgb[:, 2].max() < 170 < unknown.rgb[:, 2].max()


@pytest.mark.slow
def test_the_same_photos_give_the_same_splats_and_the_work_can_be_stopped() -> None:
    start, ticks = cover_with_splats(sheet(), COUNT), list[float]()
    once, again = (train_splats(start, sheet(), photos(striped(start)), steps=20, tick=ticks.append) for _ in range(2))
    np.testing.assert_array_equal(once.xyz, again.xyz)
    np.testing.assert_array_equal(once.rgb, again.rgb)
    assert ticks[: len(ticks) // 2] == sorted(ticks[: len(ticks) // 2])
    assert all(0 <= each <= 1 for each in ticks)

    def stop(part: float) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train_splats(start, sheet(), photos(start), steps=20, tick=stop)


@pytest.mark.slow
def test_photos_of_something_else_are_told() -> None:
    away = camera(0.0)
    away[0, 3] = 9.0
    with pytest.raises(EdgeError, match="no photo shows the mesh") as raised:
        train_splats(
            cover_with_splats(sheet(), COUNT), sheet(), [photo(np.zeros((HEIGHT, WIDTH, 3), np.uint8), away)], steps=5
        )
    assert raised.value.code == "SPLATS_UNSEEN"


@pytest.mark.gpu
def test_a_gpu_trains_as_well() -> None:
    if not torch.cuda.is_available():
        pytest.skip("there is no CUDA device")
    start = cover_with_splats(sheet(), COUNT)
    thing = striped(start)
    trained = train_splats(start, sheet(), photos(thing), steps=STEPS, device="cuda:0")
    assert error(trained, thing) < 0.25 * error(start, thing)
