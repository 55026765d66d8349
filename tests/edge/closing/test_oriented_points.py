"""Points are turned to the cameras that see them; those in noise, specks and strips count less."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from capture2vr.edge.arrays import Floats
from capture2vr.edge.closing.oriented_points import OrientedPoints, orient_points
from capture2vr.edge.render.posed_picture import PosedPicture

APART, DISTANCE = 0.01, 2.0


def photo_from(side: float) -> PosedPicture:
    """A picture from above or below, whose depth image shows the plane z = 0."""
    to_camera = np.diag([1.0, -side, -side, 1.0])
    to_camera[2, 3] = DISTANCE

    def depth() -> Floats:
        return np.full((64, 64), DISTANCE, np.float32)

    def rgb() -> Floats:
        return np.zeros((64, 64, 3), np.uint8)

    return PosedPicture(to_camera, np.ones(2), np.full(2, 0.5), rgb, depth)


def oriented(*groups: Floats, side: float = 1.0) -> list[tuple[OrientedPoints, Floats]]:
    """Each group of points (N,3) as it is turned and judged among all."""
    xyz = np.concatenate(groups)
    points, certain = orient_points(xyz, cKDTree(xyz), [photo_from(side)])
    group = np.repeat(np.arange(len(groups)), [len(each) for each in groups])
    return [(points.subset(group == number), certain[group == number]) for number in range(len(groups))]


def sheet(low: float, high: float) -> Floats:
    """A square of points on z = 0, with a little noise, between these coordinates."""
    axis = np.arange(low, high, APART)
    x, y = (each.ravel() for each in np.meshgrid(axis, axis))
    return np.stack([x, y, 0 * x], axis=1) + np.random.default_rng(0).normal(0, 0.02 * APART, (len(x), 3))


def test_normals_point_to_the_camera() -> None:
    for side in (1.0, -1.0):
        ((points, certain),) = oriented(sheet(-0.3, 0.3), side=side)
        assert (points.normal[:, 2] * side > 0.9).all()
        assert np.median(points.weight) > 0.95
        assert np.median(certain) > 0.96


def test_noise_and_strips_are_less_certain_than_a_surface() -> None:
    rng = np.random.default_rng(1)
    noise = sheet(0.4, 0.6) + rng.normal(0, 0.8 * APART, (400, 3))
    strip = np.stack([np.arange(-0.3, -0.1, APART), np.full(20, 0.5), np.zeros(20)], axis=1)
    flat, rough, thin = (certain for _, certain in oriented(sheet(-0.3, 0.3), noise, strip))
    assert np.percentile(flat, 10) > 0.9
    assert np.median(rough) < 0.85
    assert thin.max() < 0.3


def test_a_straight_border_is_still_certain() -> None:
    ((points, certain),) = oriented(sheet(-0.3, 0.3))
    border = np.abs(points.xyz[:, 0]).max() - np.abs(points.xyz[:, 0]) < APART
    border &= np.abs(points.xyz[:, 1]) < 0.2
    assert certain[border].min() > 0.7


def test_where_all_is_rough_nothing_is_less_certain_for_it() -> None:
    ((_, certain),) = oriented(sheet(-0.3, 0.3) + np.random.default_rng(1).normal(0, 0.8 * APART, (3600, 3)))
    assert np.median(certain) > 0.9
