"""Materials of glTF files: where alpha cuts a surface out, and how pictures repeat beside their edges."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from capture2vr.edge.clouds.sample_surface import SAMPLES
from capture2vr.edge.errors import CaptureError
from capture2vr.edge.srgb import to_srgb
from tests.support.gltf_files import GltfWriter, cloud_of

SQUARE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], "<f4")
SIDE = 200
ROWS, COLUMNS = np.mgrid[:SIDE, :SIDE]
DISK = np.hypot(ROWS + 0.5 - SIDE / 2, COLUMNS + 0.5 - SIDE / 2) < 0.4 * SIDE
REPEAT, CLAMP, MIRROR = 10497, 33071, 33648


def square(
    material: dict[str, Any],
    picture: np.ndarray | None = None,
    *,
    uv: np.ndarray | None = None,
    light: np.ndarray | None = None,
    sampler: dict[str, int] | None = None,
    mesh_node: dict[str, Any] | None = None,
) -> bytes:
    """A square of one metre; its picture's u is x, and v, which runs down, is y."""
    writer = GltfWriter(scene=0, scenes=[{"nodes": [0]}], nodes=[{"mesh": 0} | (mesh_node or {})])
    attributes = {"POSITION": writer.add(SQUARE), "TEXCOORD_0": writer.add(SQUARE[:, :2].copy() if uv is None else uv)}
    if light is not None:
        attributes["COLOR_0"] = writer.add(light)
    faces = writer.add(np.array([[0, 1, 2, 0, 2, 3]], "<u2").T)
    writer.tree |= {
        "meshes": [{"primitives": [{"attributes": attributes, "indices": faces, "material": 0}]}],
        "materials": [material],
    }
    if picture is not None:
        writer.tree["textures"] = [{"source": writer.picture(picture)} | ({} if sampler is None else {"sampler": 0})]
        writer.tree["samplers"] = [sampler or {}]
    return writer.glb()


def painted(factor: float = 1.0, **material: Any) -> dict[str, Any]:
    base = {"baseColorTexture": {"index": 0}, "baseColorFactor": [1, 1, 1, factor]}
    return {"pbrMetallicRoughness": base, **material}


def leaf(alpha: int, around: int = 0) -> np.ndarray:
    """A green disk of some alpha, and red around it."""
    pixels = np.where(DISK[..., None], (0, 255, 0, alpha), (255, 0, 0, around))
    return pixels.astype(np.uint8)


@pytest.mark.parametrize(
    ("material", "alpha", "around"),
    [
        (painted(alphaMode="MASK"), 255, 0),
        (painted(alphaMode="MASK"), 128, 127),
        (painted(alphaMode="MASK", alphaCutoff=0.2), 60, 40),
        (painted(0.5, alphaMode="MASK"), 255, 240),
        (painted(alphaMode="BLEND"), 30, 4),
        (
            {
                "extensions": {"KHR_materials_pbrSpecularGlossiness": {"diffuseTexture": {"index": 0}}},
                "alphaMode": "MASK",
            },
            255,
            0,
        ),
    ],
)
def test_a_leaf_is_not_its_quad(material: dict[str, Any], alpha: int, around: int) -> None:
    """Points are in the disk alone, evenly, about as many as of any mesh, and none has the colour around it."""
    cloud = cloud_of(square(material, leaf(alpha, around)))
    assert cloud.rgb is not None
    radius = np.linalg.norm(cloud.xyz[:, :2] - 0.5, axis=1)
    assert radius.max() < 0.4 + 1.5 / SIDE
    assert np.mean(radius < 0.2) == pytest.approx(0.25, abs=0.01)
    assert len(cloud.xyz) == pytest.approx(SAMPLES, rel=0.03)
    assert (cloud.rgb == (0, 255, 0)).all()


@pytest.mark.parametrize(
    ("material", "alpha"),
    [
        (painted(), 0),
        (painted(alphaMode="OPAQUE", alphaCutoff=0.9), 10),
        (painted(alphaMode="MASK", alphaCutoff=0.0), 0),
        (painted(0.04, alphaMode="BLEND"), 255),
    ],
)
def test_alpha_that_cuts_nothing_leaves_the_square(material: dict[str, Any], alpha: int) -> None:
    xyz = cloud_of(square(material, leaf(alpha, alpha))).xyz
    assert len(xyz) == SAMPLES
    np.testing.assert_allclose(np.ptp(xyz, axis=0), [1, 1, 0], atol=0.01)


def test_alpha_of_the_vertices_counts_too() -> None:
    """It is 0 at the left and 1 at the right, and half of it is less than half left of the middle."""
    light = np.stack([np.ones(4), np.ones(4), np.ones(4), SQUARE[:, 0]], axis=1).astype("<f4")
    xyz = cloud_of(square({"alphaMode": "MASK", "alphaCutoff": 0.25}, light=light)).xyz
    assert xyz[:, 0].min() == pytest.approx(0.25, abs=0.002)
    bytes_of = (255 * light).astype("u1")
    half: dict[str, Any] = {"alphaMode": "MASK", "pbrMetallicRoughness": {"baseColorFactor": [1, 1, 1, 0.6]}}
    assert cloud_of(square(half, light=bytes_of)).xyz[:, 0].min() == pytest.approx(0.5 / 0.6, abs=0.002)


def test_a_mirrored_mesh_is_cut_as_it_is() -> None:
    """A quarter of the picture is there, at the origin; mirrored, on its other side."""
    pixels = np.zeros((2, 2, 4), np.uint8)
    pixels[0, 0] = 255
    data = square(painted(alphaMode="MASK"), pixels, mesh_node={"scale": [-1, 1, 1]})
    np.testing.assert_allclose(cloud_of(data).xyz.min(axis=0), [-0.5, 0, 0], atol=0.01)


def test_a_mesh_that_is_transparent_everywhere_is_named() -> None:
    with pytest.raises(CaptureError, match="transparent everywhere") as caught:
        cloud_of(square(painted(alphaMode="MASK"), leaf(0)))
    assert caught.value.code == "CAPTURE_DEGENERATE"


def test_factors_are_linear_light() -> None:
    rgb = cloud_of(square({"pbrMetallicRoughness": {"baseColorFactor": [0.2, 0.5, 0.001, 1]}})).rgb
    assert rgb is not None
    assert (rgb == to_srgb(np.array([0.2, 0.5, 0.001]))).all()


def place_of(along: float, wrap: int) -> float:
    """Where a coordinate lies in [0,1], walked from one picture to the next."""
    if wrap == CLAMP:
        return min(max(along, 0.0), 1.0)
    turned = 0
    while along < 0:
        along, turned = along + 1, turned + 1
    while along > 1:
        along, turned = along - 1, turned + 1
    return 1 - along if wrap == MIRROR and turned % 2 else along


@settings(max_examples=10, deadline=None)
@given(
    wraps=st.tuples(*[st.sampled_from([REPEAT, CLAMP, MIRROR, None])] * 2),
    low=st.tuples(*[st.floats(-2, 1)] * 2),
    size=st.tuples(*[st.floats(0.5, 3)] * 2),
)
def test_pictures_repeat_as_their_samplers_say(
    wraps: tuple[int | None, int | None], low: tuple[float, float], size: tuple[float, float]
) -> None:
    """Along u and v apart; without a word they repeat. Of some points, those near the picture's edges left out."""
    picture = np.stack([COLUMNS, ROWS, 0 * ROWS], axis=-1).astype(np.uint8)
    uv = (np.array(low) + SQUARE[:, :2] * np.array(size)).astype("<f4")
    sampler = {name: wrap for name, wrap in zip(("wrapS", "wrapT"), wraps, strict=True) if wrap is not None}
    cloud = cloud_of(square(painted(), picture, uv=uv, sampler=sampler or None))
    assert cloud.rgb is not None
    some = slice(0, None, 500)
    at = np.array(low) + cloud.xyz[some, :2] * np.array(size)
    meant = np.array([[place_of(along, wrap or REPEAT) for along, wrap in zip(row, wraps, strict=True)] for row in at])
    inner = (np.abs(at - np.rint(at)) > 0.01).all(axis=1)
    assert np.abs(cloud.rgb[some, :2][inner] - np.floor(meant[inner] * SIDE).clip(0, SIDE - 1)).max() <= 1


def test_the_upper_left_corner_of_a_picture_is_at_zero() -> None:
    """Palettes of few texels are looked up at their edges."""
    pixels = np.zeros((2, 2, 3), np.uint8)
    pixels[0, 0] = (9, 99, 199)
    rgb = cloud_of(square(painted(), pixels, uv=np.zeros((4, 2), "<f4"))).rgb
    assert rgb is not None
    assert (rgb == (9, 99, 199)).all()
