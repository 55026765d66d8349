"""Trained anchors: patches, their agreement, the trust in noisy points, the fit."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.spatial import cKDTree

from capture2vr.edge.arrays import DistanceFn, Floats
from capture2vr.edge.errors import EdgeError
from capture2vr.edge.field import checkpoint as checkpoints
from capture2vr.edge.field import noise_trust
from capture2vr.edge.field.anchor_fit import fit_anchors
from capture2vr.edge.field.anchor_losses import LOOSE, NEIGHBOURS, AnchorEdges, agreement_losses, edges_between
from capture2vr.edge.field.anchors import SHAPE, AnchorField, Anchors, curved_anchors, surface_at
from capture2vr.edge.field.config import AnchorConfig
from capture2vr.edge.field.denoise import denoise
from capture2vr.edge.field.folds import noise_of
from capture2vr.edge.field.local import local_field
from capture2vr.edge.field.noise import Noise
from capture2vr.edge.field.patches import TERMS, fit_patches
from capture2vr.edge.field.planes import fit_planes
from capture2vr.edge.mesh.nouns import Mesh
from tests.support import surfaces

CONFIG = AnchorConfig(steps=40, learning_rate=0.05)
CPU = torch.device("cpu")


def plane_points(count: int, seed: int = 0) -> Floats:
    return np.pad(np.random.default_rng(seed).uniform(-0.5, 0.5, (count, 2)), ((0, 0), (0, 1)))


def anchors_of(xyz: Floats) -> Anchors:
    tree = cKDTree(xyz)
    return curved_anchors(fit_patches(fit_planes(xyz, tree), tree))


def edges_of(anchors: Anchors) -> AnchorEdges:
    _, neighbours = cKDTree(anchors.xyz).query(anchors.xyz, k=NEIGHBOURS + 1)
    return edges_between(anchors, neighbours, LOOSE, CPU)


def fitted(xyz: Floats, config: AnchorConfig = CONFIG) -> DistanceFn:
    *_, last = fit_anchors(xyz, config)
    return last.field


def miss(field: DistanceFn, truth: Mesh) -> float:
    """Mean distance that the field claims at places where it should be 0."""
    return float(field(surfaces.sampled(truth, 4_000, seed=9))[0].mean())


def _one(anchors: Anchors, which: int) -> Anchors:
    """One anchor of many, twice: a blend wants two."""
    return Anchors(*(getattr(anchors, each)[[which, which]] for each in Anchors.__slots__))


def parabola(curvature: float) -> Anchors:
    """An anchor at the origin, its patch z = ½ c (x² + y²), and one far off that must not matter."""
    xyz = np.array([[0, 0, 0], [0, 0, 9]], np.float32)
    shape = np.array([[0, 0, 0, curvature, 0, curvature]] * 2, np.float32)
    flat = np.zeros((2, len(TERMS)), np.float32)
    return Anchors(xyz, np.stack([np.eye(3, dtype=np.float32)] * 2), np.ones(2, np.float32), flat, shape)


def test_anchors_start_as_the_local_field() -> None:
    xyz = surfaces.sampled(surfaces.hemisphere(), 2_000)
    places = surfaces.sampled(surfaces.hemisphere(), 500, noise=0.003, seed=1)
    (f, gradient), (started, direction) = local_field(xyz)(places), AnchorField(anchors_of(xyz))(places)
    assert np.abs(f - started).mean() < 2e-4
    assert np.abs(np.einsum("nx,nx->n", gradient, direction)).mean() > 0.999


def test_a_flat_field_measures_the_distance_to_the_plane() -> None:
    field = AnchorField(anchors_of(plane_points(400)))
    f, gradient = field(np.array([[0.1, 0.1, 0.02], [0.0, -0.1, -0.03]]))
    np.testing.assert_allclose(f, [0.02, 0.03], atol=1e-6)
    np.testing.assert_allclose(gradient, [[0, 0, 1], [0, 0, -1]], atol=1e-5)


def test_beyond_an_open_edge_the_field_grows_sideways() -> None:
    f, _ = AnchorField(anchors_of(plane_points(400)))(np.array([[0.5, 0, 0], [0.8, 0, 0], [1.0, 0, 0]]))
    assert f[0] < 0.05 < f[1] < f[2]


def test_a_curved_patch_is_its_own_zero_set() -> None:
    x = np.array([0.3, -0.5, 0.8])
    f, gradient = AnchorField(parabola(0.6))(np.stack([x, 0 * x, 0.3 * x * x], axis=1))
    slope = np.abs(gradient[:, 0] / gradient[:, 2])
    np.testing.assert_allclose(f, 0, atol=1e-6)
    np.testing.assert_allclose(slope, np.abs(0.6 * x), atol=1e-5)


def test_far_out_a_patch_goes_on_straight() -> None:
    near, far = (AnchorField(parabola(0.6))(np.array([[x, 0, 0]]))[1] for x in (2.5, 4.0))
    np.testing.assert_allclose(near, far, atol=1e-5)


def test_the_surface_lies_where_the_field_is_zero() -> None:
    anchors = anchors_of(surfaces.sampled(surfaces.hemisphere(), 1_000))
    shape = np.zeros((1_000, SHAPE), np.float32)
    shape[:, 0], shape[:, 1] = 0.3, 0.2
    tilted = replace(anchors, shape=shape)
    xyz, normals = surface_at(tilted)
    alone = [AnchorField(_one(tilted, i))(xyz[i : i + 1])[0][0] for i in range(0, 1_000, 100)]
    assert max(alone) < 1e-6
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-5)
    assert np.median(np.linalg.norm(xyz - anchors.xyz, axis=1) / anchors.spacing) == pytest.approx(0.3, abs=0.05)


def test_a_base_counts_as_far_as_its_neighbours_support_it() -> None:
    xyz = surfaces.sampled(surfaces.bumpy_sheet(), 1_000)
    patches = fit_patches(fit_planes(xyz.astype(np.float32), cKDTree(xyz)), cKDTree(xyz))
    known, doubted = (curved_anchors(replace(patches, support=np.full(1_000, s, np.float32))) for s in (1.0, 0.1))
    np.testing.assert_array_equal(known.terms, patches.terms)
    assert not known.shape.any()
    assert not doubted.terms.any()
    # Near its point the parabola is the patch.
    np.testing.assert_allclose(surface_at(doubted)[1], surface_at(known)[1], atol=1e-5)


def test_patches_in_one_plane_agree_and_tilted_ones_do_not() -> None:
    anchors = anchors_of(plane_points(200))
    edges = edges_of(anchors)
    flat = [float(loss) for loss in agreement_losses(torch.zeros(200, 6), edges, LOOSE)]
    tilted = [float(loss) for loss in agreement_losses(0.3 * torch.randn(200, 6), edges, LOOSE)]
    assert max(flat) < 1e-6 < 1e-3 < min(tilted)


@pytest.mark.slow
def test_the_losses_by_parts_are_the_losses() -> None:
    edges, shape = edges_of(anchors_of(plane_points(200))), 0.1 * torch.randn(200, 6)
    whole = torch.stack(agreement_losses(shape, edges, LOOSE))
    parts = sum(torch.stack(agreement_losses(shape, part, LOOSE)) for part in edges.parts(100))
    torch.testing.assert_close(parts, whole)


def test_no_edge_joins_two_layers() -> None:
    xyz = surfaces.sampled(surfaces.two_sheets(), 3_000)
    edges = edges_of(anchors_of(xyz))
    top = xyz[:, 2] > 0.05 * np.sin(4 * (xyz[:, 0] + 0.5)) * np.cos(3 * (xyz[:, 1] + 0.5))
    across = top[edges.first.numpy()] != top[edges.second.numpy()]
    assert edges.weight.numpy()[across].sum() < 0.02 * float(edges.weight.sum())


def test_duplicates_and_tiny_weights_give_finite_losses() -> None:
    xyz = np.repeat(plane_points(30), 4, axis=0)
    losses = agreement_losses(torch.zeros(120, 6), edges_of(anchors_of(xyz)), LOOSE)
    assert all(bool(torch.isfinite(loss)) for loss in losses)


def test_the_best_predictor_of_unseen_points_is_chosen() -> None:
    assert (
        noise_trust.choose_trust([np.full(50, error) for error in (1.2, 1.0, 1.1, 1.3, 1.4)])
        == noise_trust.CANDIDATES[1]
    )
    assert noise_trust.choose_trust([np.empty(0)] * 5) == noise_trust.CANDIDATES[0]


def test_where_the_least_trust_predicts_best_the_denoised_points_stay() -> None:
    assert noise_trust.choose_trust([np.full(50, error) for error in (1.0, 1.1, 1.2, 1.3, 1.4)]) is None


def test_of_equal_predictors_that_which_trusts_the_points_most_is_chosen() -> None:
    assert (
        noise_trust.choose_trust([np.full(50, error) for error in (1.002, 1.0, 1.004, 1.2, 1.3)])
        == noise_trust.CANDIDATES[2]
    )


def test_strays_and_clean_points_are_not_usable() -> None:
    anchors = anchors_of(plane_points(100))
    scanned = np.array(anchors.xyz, np.float64)
    scanned[0, 2] += 0.01 * anchors.spacing[0]
    scanned[1, 2] += 50 * anchors.spacing[1]
    scan = noise_trust.scan_of(scanned, Noise(0.1 * anchors.spacing, np.ones(100)), anchors)
    assert scan.usable.tolist() == [True, False] + [False] * 98
    assert np.count_nonzero(scan.trust(1.0)) == 1


@pytest.mark.slow
def test_a_stray_of_a_real_denoising_is_not_usable() -> None:
    xyz = surfaces.sampled(surfaces.smooth_sheet(), 2_000, noise=0.005)
    xyz[:5, 2] += 0.04  # eight standard deviations
    noise = noise_of(xyz)
    smooth = denoise(xyz, noise)
    stayed = (smooth == xyz).all(axis=1)
    assert stayed[:5].any()
    anchors = curved_anchors(local_field(smooth).patches)
    usable = noise_trust.scan_of(xyz, noise, anchors).usable
    assert not usable[stayed].any()
    assert usable.mean() > 0.9


@pytest.mark.slow
def test_training_beats_the_local_field_where_points_are_sparse() -> None:
    skirt = surfaces.pleated_skirt()
    xyz = surfaces.sampled(skirt, 1_000)
    assert miss(fitted(xyz), skirt) < 0.9 * miss(local_field(xyz), skirt)


@pytest.mark.slow
def test_training_takes_noise_off() -> None:
    sheet = surfaces.smooth_sheet()
    xyz = surfaces.sampled(sheet, 1_500, noise=0.01)
    *_, last = fit_anchors(xyz, CONFIG)
    assert last.number == last.of == len(noise_trust.CANDIDATES) * 20 + 20 + 40
    assert miss(last.field, sheet) < 0.7 * miss(local_field(xyz), sheet)


def test_clean_points_stay_on_the_surface() -> None:
    xyz = surfaces.sampled(surfaces.hemisphere(), 500)
    field = fitted(xyz)
    assert isinstance(field, AnchorField)
    np.testing.assert_allclose(field.points, xyz, atol=1e-6)


def test_steps_count_up_and_every_one_has_a_field_and_losses() -> None:
    steps = list(fit_anchors(surfaces.sampled(surfaces.hemisphere(), 300), replace(CONFIG, steps=4)))
    assert [step.number for step in steps if step.losses] == [1, 2, 3, 4, 5, 6]
    assert all(step.number == 0 for step in steps[:-6])  # of the set-up
    assert all(step.of == 6 and np.isfinite(step.losses["total"]) for step in steps[-6:])
    assert all(np.isfinite(step.field(np.zeros((1, 3)))[0]).all() for step in steps)


def test_the_same_points_give_the_same_field() -> None:
    xyz = surfaces.sampled(surfaces.hemisphere(), 300)
    first, again = (fitted(xyz, replace(CONFIG, steps=6)) for _ in range(2))
    np.testing.assert_array_equal(first(xyz)[0], again(xyz)[0])


@pytest.mark.slow
@pytest.mark.parametrize(("killed_after", "goes_on_with"), [(2, 3), (9, 10), (20, 20), (27, 28)])  # 20 ends a round
def test_a_killed_fit_ends_as_if_it_had_not_been(
    killed_after: int, goes_on_with: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(checkpoints, "SECONDS", 0.0)
    xyz = surfaces.sampled(surfaces.smooth_sheet(), 400, noise=0.01)
    config = replace(CONFIG, steps=8)
    whole = list(fit_anchors(xyz, config))
    assert whole[-1].number == 32  # five trials, the first round and the second
    steps = fit_anchors(xyz, config, checkpoint=tmp_path / "fit.pt")
    next(step for step in steps if step.number == killed_after)
    steps.close()
    rest = list(fit_anchors(xyz, config, checkpoint=tmp_path / "fit.pt"))
    assert next(step.number for step in rest if step.losses) == goes_on_with
    np.testing.assert_array_equal(rest[-1].field(xyz)[0], whole[-1].field(xyz)[0])


def test_a_fit_killed_behind_its_last_step_still_gives_its_field(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(checkpoints, "SECONDS", 0.0)
    xyz, config = surfaces.sampled(surfaces.hemisphere(), 300), replace(CONFIG, steps=4)
    *_, whole = fit_anchors(xyz, config, checkpoint=tmp_path / "fit.pt")
    *_, again = fit_anchors(xyz, config, checkpoint=tmp_path / "fit.pt")
    assert (again.number, again.of, again.losses) == (whole.number, whole.of, whole.losses)
    assert isinstance(again.field, AnchorField)
    np.testing.assert_array_equal(again.field(xyz)[0], whole.field(xyz)[0])


def test_too_few_points_are_named() -> None:
    with pytest.raises(EdgeError) as caught:
        next(iter(fit_anchors(plane_points(20), CONFIG)))
    assert caught.value.code == "FIT_TOO_FEW_POINTS"


@pytest.mark.parametrize("bad", [np.full((60, 3), np.nan), np.zeros((60, 2))])
def test_bad_arrays_are_refused(bad: Floats) -> None:
    with pytest.raises(ValueError):
        next(iter(fit_anchors(bad, CONFIG)))


def test_a_fit_that_explodes_is_named() -> None:
    with pytest.raises(EdgeError) as caught:
        fitted(surfaces.sampled(surfaces.hemisphere(), 300), replace(CONFIG, learning_rate=1e30))
    assert caught.value.code == "FIT_DIVERGED"


@pytest.mark.gpu
def test_a_gpu_gives_the_same_field_as_a_cpu() -> None:
    if not torch.cuda.is_available():
        pytest.skip("no CUDA device")
    xyz = surfaces.sampled(surfaces.hemisphere(), 1_000)
    *_, on_gpu = fit_anchors(xyz, CONFIG, device="cuda")
    np.testing.assert_allclose(on_gpu.field(xyz)[0], fitted(xyz)(xyz)[0], atol=1e-4)
