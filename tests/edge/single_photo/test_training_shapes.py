"""Generated shapes, their pictures, and the losses: properties that hold for any seed."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from tests.bench.single_photo_network.camera import about_vertical, project
from tests.bench.single_photo_network.network import BINS, GRID, base_sphere, bin_of, likeliest_yaw
from tests.bench.single_photo_training.batches import HELD_OUT, held_out_batch
from tests.bench.single_photo_training.lofts import Dice, box, loft, spindle, where
from tests.bench.single_photo_training.losses import chamfer, chamfer_loss, f_score, nearest, udf_loss
from tests.bench.single_photo_training.pictures import RenderedPictures, mirror_pictures, render_pictures
from tests.bench.single_photo_training.shapes import CLASSES, Shapes, generate_shapes, rotate_shapes

few = settings(max_examples=8)


@pytest.fixture(scope="module")
def things() -> Shapes:
    return generate_shapes(HELD_OUT + 9, 2, samples=6000)


@pytest.mark.slow
@few
@given(st.integers(0, 2**40))
def test_every_class_keeps_the_frame_for_any_seed(seed: int) -> None:
    made = generate_shapes(seed, 1, samples=400)
    assert made.xyz.isfinite().all()
    assert made.rgb.isfinite().all()
    own = about_vertical(made.xyz, -made.yaw)
    low, high = own.amin(dim=1), own.amax(dim=1)
    assert torch.allclose(low, -high, atol=1e-5)
    assert torch.allclose(made.xyz.norm(dim=2).amax(dim=1), torch.ones(len(CLASSES)), atol=1e-5)
    assert (made.normals.norm(dim=2) - 1).abs().max() < 1e-4
    assert 0 <= made.rgb.min() <= made.rgb.max() <= 1


def test_the_same_seed_makes_the_same_things_and_another_makes_others() -> None:
    first, again, other = (generate_shapes(seed, 1, samples=300) for seed in (5, 5, 6))
    assert torch.equal(first.xyz, again.xyz)
    assert torch.equal(first.rgb, again.rgb)
    assert ((first.xyz - other.xyz).abs().amax(dim=(1, 2)) > 0.05).all()


def test_points_are_spread_evenly_over_a_box() -> None:
    dice = Dice(1, torch.Generator().manual_seed(0))
    grid = box(1, (0.0, 0.0, 0.0), (1.0, 2.0, 3.0))
    assert np.allclose(grid.amax(dim=(0, 1, 2)), [0.5, 1.0, 1.5])
    from tests.bench.single_photo_training.shapes import _sample_surface

    xyz, normals, _, _ = _sample_surface(grid[:, None], 20_000, dice.generator)
    on_top = (xyz[0, :, 1] > 1 - 1e-4).float().mean().item()
    assert on_top == pytest.approx(3 / 22, abs=0.01)  # its area over that of all six sides
    top = normals[0][xyz[0, :, 1] > 1 - 1e-4]
    assert top[:, 1].abs().min() > 0.999


def test_a_part_that_is_not_there_has_no_points() -> None:
    dice = Dice(2, torch.Generator().manual_seed(0))
    there = torch.tensor([[1.0], [0.0]])
    parts = torch.stack([spindle("y", [0.0, 1.0], 1.0, 1.0, n=2), where(box(2, (0, 5, 0), (1, 1, 1)), there)], dim=1)
    from tests.bench.single_photo_training.shapes import _sample_surface

    _, _, part, _ = _sample_surface(parts, 2000, dice.generator)
    assert (part[0] == 1).any()
    assert (part[1] == 0).all()


def test_a_loft_of_circles_is_a_cylinder_and_of_squares_a_prism() -> None:
    rise = torch.tensor([[[0.0, 0, 0], [0, 1, 0]]])
    side, front = torch.tensor([[[1.0, 0, 0]] * 2]), torch.tensor([[[0.0, 0, 1]] * 2])
    tube, prism = loft(rise, side, front), loft(rise, side, front, square=1.0)
    assert torch.allclose(tube[..., [0, 2]].norm(dim=-1), torch.ones(()))
    assert torch.allclose(prism[..., [0, 2]].abs().amax(dim=-1), torch.ones(()))


def test_a_thing_turned_round_is_the_same_thing(things: Shapes) -> None:
    other = rotate_shapes(things, 3)
    assert torch.allclose(about_vertical(other.xyz, things.yaw - other.yaw), things.xyz, atol=1e-5)
    assert ((things.xyz - other.xyz).norm(dim=2).mean(dim=1) > 0.05).float().mean() > 0.8


@few
@given(st.floats(-7, 7))
def test_the_likeliest_yaw_is_the_one_that_was_put_in(yaw: float) -> None:
    angle = torch.tensor([yaw])
    logits = torch.full((1, BINS), -9.0)
    logits[0, bin_of(angle)] = 0.0
    off = likeliest_yaw(logits) - angle
    assert torch.atan2(off.sin(), off.cos()).abs().item() <= math.pi / BINS + 1e-4
    wide = torch.stack([torch.cos(2 * math.pi * torch.arange(BINS) / BINS - yaw) * 60])
    off = likeliest_yaw(wide) - angle
    assert torch.atan2(off.sin(), off.cos()).abs().item() < 0.3 * math.pi / BINS


def test_pictures_fill_the_frame_and_projection_agrees_with_them(things: Shapes) -> None:
    pictures = render_pictures(things, 4, clean=True)
    at, _ = project(things.xyz, pictures.camera)
    assert at.abs().max() < 1.03
    assert ((at.amax(dim=1) - at.amin(dim=1)).amax(dim=1) > 1.5).all()
    mask = pictures.picture[:, 3:]
    hit = torch.nn.functional.grid_sample(mask, (at * torch.tensor([1.0, -1.0]))[:, None], align_corners=False)
    assert hit.mean() > 0.9  # a point beside the outline falls half beside its pixel
    assert (pictures.picture[:, :3] <= mask + 1e-5).all()


def test_what_is_nearer_hides_what_is_behind() -> None:
    axis = torch.linspace(-0.6, 0.6, 80)
    x, y = (each.reshape(-1) for each in torch.meshgrid(axis, axis, indexing="ij"))
    sheets = [torch.stack([x, y, torch.full_like(x, z)], dim=1) for z in (-0.4, 0.4)]
    normals = torch.tensor([0.0, 0, 1]).expand(2 * len(x), 3)
    red, blue = torch.tensor([1.0, 0, 0]), torch.tensor([0.0, 0, 1])
    rgb = torch.cat([blue.expand(len(x), 3), red.expand(len(x), 3)])
    two = Shapes(torch.cat(sheets)[None], normals[None], rgb[None], torch.zeros(1, dtype=torch.long), torch.zeros(1))
    for seed in range(4):  # cameras at most 50 degrees up, so the middle always shows the sheet in front
        middle = render_pictures(two, seed, clean=True).picture[0, :, 30:34, 30:34]
        assert middle[3].min() > 0.99
        assert middle[0].mean() > 5 * middle[2].mean()


def test_a_mirrored_picture_is_that_of_the_mirrored_thing(things: Shapes) -> None:
    seen = render_pictures(things, 4, clean=True)
    flipped = mirror_pictures(seen)
    at, _ = project(things.xyz, seen.camera)
    mirrored_at, _ = project(things.xyz * torch.tensor([-1.0, 1, 1]), flipped.camera)
    assert torch.allclose(mirrored_at, at * torch.tensor([-1.0, 1]), atol=1e-5)
    twice: RenderedPictures = mirror_pictures(flipped)
    assert torch.equal(twice.picture, seen.picture)
    assert torch.equal(twice.camera, seen.camera)


@pytest.mark.slow
def test_held_out_pictures_are_spoilt_and_stay_pictures() -> None:
    spoilt, clean = held_out_batch(1, 1), held_out_batch(1, 1, clean=True)
    assert torch.equal(spoilt.surface, clean.surface)
    assert 0 <= spoilt.picture.min() <= spoilt.picture.max() <= 1
    assert (spoilt.picture - clean.picture).abs().mean() > 0.005


@few
@given(st.integers(0, 2**31), st.integers(5, 70), st.integers(5, 70))
def test_nearest_is_what_a_tree_finds(seed: int, p: int, t: int) -> None:
    generator = torch.Generator().manual_seed(seed)
    a, b = torch.rand(2, p, 3, generator=generator), torch.rand(2, t, 3, generator=generator)
    there, back = nearest(a, b)
    for one, other, found in ((a, b, there), (b, a, back)):
        for x, y, index in zip(one.numpy(), other.numpy(), found.numpy(), strict=True):
            gap = np.linalg.norm(x - y[index], axis=1)
            assert np.allclose(gap, cKDTree(y).query(x)[0], rtol=1e-2, atol=2e-3)


@few
@given(st.floats(0.001, 0.3).filter(lambda shift: abs(shift - 0.1) > 1e-4))  # at 0.1 itself rounding decides
def test_chamfer_and_f_of_a_shifted_grid_are_known(shift: float) -> None:
    axis = torch.arange(8.0)
    grid = torch.cartesian_prod(axis, axis, axis)[None]
    moved = grid + torch.tensor([shift, 0, 0])
    assert chamfer(grid, moved).item() == pytest.approx(2 * shift * shift, rel=1e-3)
    assert f_score(grid, moved, near=0.1).item() == pytest.approx(float(shift < 0.1), abs=1e-6)
    assert chamfer(grid, grid).item() == 0


def test_the_loss_pulls_a_point_to_the_surface() -> None:
    point = torch.tensor([[[0.3, 0.0, 0.0]]], requires_grad=True)
    chamfer_loss(point, torch.zeros(1, 1, 3)).backward()
    assert point.grad is not None
    assert point.grad[0, 0, 0] > 0
    assert point.grad[0, 0, 1:].abs().max() == 0


def test_the_distance_loss_is_zero_for_the_truth_and_blind_beyond_its_clamp() -> None:
    away = torch.tensor([[[0.1, 0, 0], [0, 0.5, 0]]])
    distance = away.norm(dim=2)
    direction = away / distance[..., None]
    assert udf_loss(distance, direction, distance, direction) == pytest.approx(0, abs=1e-6)
    too_far = distance + torch.tensor([[0.0, 3.0]])
    assert udf_loss(too_far, direction, distance, direction) == pytest.approx(0, abs=1e-6)
    assert udf_loss(distance + 0.05, -direction, distance, direction) > 0.04


def test_neighbours_in_the_square_are_neighbours_on_the_base_sphere() -> None:
    sphere = base_sphere().reshape(GRID, GRID, 3)
    assert torch.allclose(sphere.norm(dim=2), torch.full((GRID, GRID), 0.5))
    assert (sphere[1:] - sphere[:-1]).norm(dim=2).max() < 0.12
    assert sphere.mean(dim=(0, 1)).abs().max() < 1e-6
