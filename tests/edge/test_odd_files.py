"""Valid but odd files of every kind are read as they are meant: count, places, colours, or none."""

from __future__ import annotations

from dataclasses import replace
from random import Random

import numpy as np
import pytest

from capture2vr.edge.capture.nouns import Capture, Cloud
from tests.support.odd.meshes import pieces, truth_of
from tests.support.odd.odd_files import KINDS, around, odd_file, verdict
from tests.support.odd.truth import Truth, fault, judge_of


@pytest.mark.parametrize("number", range(30))
def test_an_odd_file_is_read_as_it_is_meant(number: int) -> None:
    file = odd_file(number)
    assert verdict(file.files, judge_of(file.truth)) == ("right", ""), (file.kind, file.way, file.around)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_odd_files_of_a_kind_are_read_as_they_are_meant(kind: str) -> None:
    for number in range(12):
        chance = Random(f"{kind} {number}")
        file = around(chance, kind, KINDS[kind][1](chance))
        assert verdict(file.files, judge_of(file.truth)) == ("right", ""), (number, file.way, file.around)


def test_a_number_is_always_the_same_file() -> None:
    assert all(odd_file(number).files == odd_file(number).files for number in range(20))


XYZ = np.random.default_rng(0).normal(size=(300, 3))
RGB = np.random.default_rng(1).integers(0, 256, (300, 3)).astype(np.uint8)


@pytest.mark.parametrize(
    ("cloud", "reason"),
    [
        (Cloud(XYZ, RGB), ""),
        (Cloud(XYZ - 5, RGB, origin=np.full(3, 5.0)), ""),
        (Cloud(XYZ + np.array([0, 0, 0.01]), RGB), "coordinates off by 0.01"),
        (Cloud(XYZ[:, [1, 0, 2]], RGB), "coordinates off"),
        (Cloud(XYZ[1:], RGB[1:]), "299 points instead of 300"),
        (Cloud(XYZ, RGB // 2), "of the colours off"),
        (Cloud(XYZ), "no colours"),
    ],
)
def test_what_is_not_meant_of_points_is_found(cloud: Cloud, reason: str) -> None:
    found = fault(Capture("points", "ply", cloud=cloud), Truth(XYZ, RGB))
    assert found.startswith(reason) if not reason.startswith("of") else reason in found
    assert bool(found) == bool(reason)


def test_what_is_not_meant_of_a_surface_is_found() -> None:
    """A polygon as a fan of its first corner, one that is missing, and colours of another one."""
    made = pieces(Random(4))
    truth = truth_of(made, coloured=True)
    weights = np.random.default_rng(0).dirichlet(np.ones(3), 20_000)

    def of(triangles: np.ndarray, rgb: np.ndarray) -> str:
        area = np.linalg.norm(np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]), axis=1)
        chosen = np.random.default_rng(1).choice(len(triangles), 20_000, p=area / area.sum())
        cloud = Cloud(np.einsum("nc,ncd->nd", weights, triangles[chosen]), rgb[chosen].astype(np.uint8))
        return fault(Capture("points", "obj", cloud=cloud), truth)

    rgb = truth.rgb
    assert rgb is not None
    assert of(truth.xyz, rgb) == ""
    fan = truth.xyz.copy()
    start = 0
    for piece in made:
        fan[start : start + len(piece.corners), 0] = piece.corners[0]
        start += len(piece.corners)
    assert "off the surface" in of(fan, rgb) or "spread" in of(fan, rgb)
    assert of(truth.xyz[len(made[0].corners) :], rgb[len(made[0].corners) :])
    assert "colours off" in of(truth.xyz, np.roll(rgb, 9, axis=0))
    bare = Capture("points", "obj", cloud=Cloud(truth.xyz.reshape(-1, 3)))
    assert fault(bare, truth) == "no colours"
    assert fault(replace(bare, cloud=None), truth) == "taken for points"
