"""Points are turned to the cameras that see them; those in noise, specks and strips count less."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from capture2vr.edge.arrays import Bools, Floats
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


def oriented(*groups: Floats, side: float = 1.0) -> tuple[list[OrientedPoints], list[Bools]]:
    """Each group of points (N,3) as it is judged among all."""
    xyz = np.concatenate(groups)
    points, sure = orient_points(xyz, cKDTree(xyz), [photo_from(side)])
    group = np.repeat(np.arange(len(groups)), [len(each) for each in groups])
    return [points.subset(group == number) for number in range(len(groups))], [
        sure[group == number] for number in range(len(groups))
    ]


def sheet(low: float, high: float) -> Floats:
    """A square of points on z = 0, with a little noise, between these coordinates."""
    axis = np.arange(low, high, APART)
    x, y = (each.ravel() for each in np.meshgrid(axis, axis))
    return np.stack([x, y, 0 * x], axis=1) + np.random.default_rng(0).normal(0, 0.02 * APART, (len(x), 3))


def test_normals_point_to_the_camera() -> None:
    for side in (1.0, -1.0):
        (points,), (sure,) = oriented(sheet(-0.3, 0.3), side=side)
        assert (points.normal[:, 2] * side > 0.9).all()
        assert np.median(points.weight) > 0.95
        assert sure.mean() > 0.9


def test_noise_and_specks_weigh_less_than_a_surface() -> None:
    rng = np.random.default_rng(1)
    noise = sheet(0.4, 0.6) + rng.normal(0, 0.8 * APART, (400, 3))
    strip = np.stack([np.arange(-0.3, -0.1, APART), np.full(20, 0.5), np.zeros(20)], axis=1)
    points, sure = oriented(sheet(-0.3, 0.3), noise, strip)
    flat, rough, thin = (each.weight.mean() for each in points)
    assert flat > 0.9
    assert rough < 0.5 * flat
    assert thin < 0.05
    assert [round(float(each.mean())) for each in sure] == [1, 0, 0]


def test_a_straight_border_still_counts() -> None:
    (points,), _ = oriented(sheet(-0.3, 0.3))
    border = np.abs(points.xyz[:, 0]).max() - np.abs(points.xyz[:, 0]) < APART
    border &= np.abs(points.xyz[:, 1]) < 0.2
    assert points.weight[border].min() > 0.5
