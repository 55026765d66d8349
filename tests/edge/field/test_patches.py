"""Curved patches: their algebra, what they follow, and what the vote repairs."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from capture2vr.edge.arrays import Floats
from capture2vr.edge.field import patches
from capture2vr.edge.field.local import local_field
from capture2vr.edge.field.patches import Patches, fit_patches, predict
from capture2vr.edge.field.planes import Planes, fit_planes
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.mesh.sampling import sample
from tests.support import surfaces

RNG = np.random.default_rng(11)


def test_the_features_and_what_is_cut_off_are_the_whole_kernel() -> None:
    s, t = RNG.normal(size=(2, 50, 7))
    squared = s * s + t * t
    kept = np.square(patches._features(s, t) * np.exp(-squared / 2)[..., None]).sum(axis=-1)
    np.testing.assert_allclose(kept + patches._cut_off_variance(squared), 1, atol=1e-6)


def test_the_surface_is_its_features_and_the_slopes_are_its_derivatives() -> None:
    beta = RNG.normal(size=(40, len(patches.TERMS)))
    s, t = RNG.uniform(-1, 1, (2, 40))
    scale = np.array(patches._SCALE, np.float64)

    def height(s: Floats, t: Floats) -> Floats:
        return np.asarray(patches.patch_surface(beta * scale, s, t)[0])

    direct = (patches._features(s, t) * beta).sum(axis=1) * np.exp(-(s * s + t * t) / 2)
    np.testing.assert_allclose(height(s, t), direct, atol=1e-5)
    _, slope_u, slope_v, steep = patches.patch_surface(beta * scale, s, t)
    step = 1e-5
    numeric_u = (height(s + step, t) - height(s - step, t)) / (2 * step * patches.LENGTH)
    numeric_v = (height(s, t + step) - height(s, t - step)) / (2 * step * patches.LENGTH)
    np.testing.assert_allclose(slope_u, numeric_u, atol=1e-6)
    np.testing.assert_allclose(slope_v, numeric_v, atol=1e-6)
    np.testing.assert_allclose(steep, 1 / np.sqrt(1 + numeric_u**2 + numeric_v**2), atol=1e-6)


def test_beside_a_sphere_every_patch_gives_its_distance() -> None:
    points, made, tree = _fitted(surfaces.sphere(), 2_000)
    q = points[:500] * (1 + RNG.uniform(-0.02, 0.02, (500, 1)))
    index = tree.query(q, k=6)[1]
    distance, normals = predict(made, index, q.astype(np.float32))
    outward = q / np.linalg.norm(q, axis=1, keepdims=True)
    cos = np.einsum("mkx,mx->mk", normals, outward)
    error = distance * np.sign(cos) - (np.linalg.norm(q, axis=1) - 0.5)[:, None]
    assert np.abs(error).mean() < 1e-4  # planes: spacing²/2R = 1.6e-3
    assert np.abs(cos).mean() > 0.9999


def test_far_from_its_point_a_patch_is_its_plane() -> None:
    points, made, _ = _fitted(surfaces.bumpy_sheet(), 500)
    q = points[:1] + np.float32([0, 0, 3]) + 40 * made.spacing[0] * made.u[:1]
    distance, normals = predict(made, np.zeros((1, 1), int), q)
    np.testing.assert_allclose(normals[0], made.normals[:1], atol=1e-5)
    np.testing.assert_allclose(distance[0], made.normals[0] @ (q[0] - made.xyz[0]), atol=1e-4)


def test_sparse_pleats_are_followed() -> None:
    truth = sample(surfaces.pleated_skirt(), 1_000, np.random.default_rng(0))
    tree = cKDTree(truth.xyz)
    planes = fit_planes(truth.xyz.astype(np.float32), tree)
    made = fit_patches(planes, tree)
    before, after = (_cos(n, truth.normals) for n in (planes.normals, made.normals))
    assert before.mean() < 0.99
    assert after.mean() > 0.998


@pytest.mark.parametrize("wrong", [0.05, 0.15])
def test_the_vote_repairs_wrong_normals(wrong: float) -> None:
    points = surfaces.sampled(surfaces.sphere(), 3_000).astype(np.float32)
    normals = points / np.linalg.norm(points, axis=1, keepdims=True)
    bad = np.flatnonzero(RNG.random(len(points)) < wrong)
    normals[bad] = np.cross(normals[bad], [0.6, 0.0, 0.8])
    normals[bad] /= np.linalg.norm(normals[bad], axis=1, keepdims=True)
    tree = cKDTree(points)
    spacing = fit_planes(points, tree, normals).spacing
    made = fit_patches(Planes(points, normals, spacing), tree)
    assert (_cos(made.normals, points * 2) > 0.98).mean() > 0.99


def test_two_sheets_closer_than_two_spacings_keep_their_normals() -> None:
    truth = sample(surfaces.two_sheets(apart=0.06), 1_000, np.random.default_rng(0))
    tree = cKDTree(truth.xyz)
    made = fit_patches(fit_planes(truth.xyz.astype(np.float32), tree), tree)
    assert (_cos(made.normals, truth.normals) > 0.95).mean() > 0.99


def test_a_patch_among_strays_knows_that_it_explains_little() -> None:
    sheet = surfaces.sampled(surfaces.smooth_sheet(), 3_000)
    strays = RNG.uniform(-0.5, 0.5, (300, 3)) * [1, 1, 0.5] + [0, 0, 0.6]
    points = np.concatenate([sheet, strays]).astype(np.float32)
    tree = cKDTree(points)
    support = fit_patches(fit_planes(points, tree), tree).support
    assert np.median(support[:3_000]) > 0.9
    assert np.median(support[3_000:]) < 0.5


def test_it_can_be_stopped_between_chunks() -> None:
    heard: list[float] = []
    local_field(surfaces.sampled(surfaces.pleated_skirt(), 5_000), tick=heard.append)
    assert heard == sorted(heard)
    assert len(heard) > 20
    assert 0 < heard[0] < heard[-1] <= 1


def _fitted(surface: Mesh, count: int) -> tuple[Floats, Patches, cKDTree]:
    points = surfaces.sampled(surface, count).astype(np.float32)
    tree = cKDTree(points)
    return points, fit_patches(fit_planes(points, tree), tree), tree


def _cos(a: Floats, b: Floats) -> Floats:
    return np.abs(np.einsum("nx,nx->n", a, b))
