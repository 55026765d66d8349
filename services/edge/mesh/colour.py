"""Colours: from the captured points to the mesh, averaged in linear light."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from services.edge.arrays import Bytes, Floats
from services.edge.mesh.nouns import Mesh
from services.edge.srgb import to_linear, to_srgb

_NEIGHBOURS = 6  # about one ring of a surface sample: smooths the noise of single pixels without washing out a print
_NEAR = 0.05  # a neighbour this share of the nearest spacing away counts as "here": bounds the weight 1/d² at d = 0


def carry_colours(mesh: Mesh, xyz: Floats, rgb: Bytes) -> Mesh:
    """The mesh with the points' colours: inverse square distance over the nearest points, in linear light.

    xyz (N,3) in the mesh's frame, rgb (N,3) uint8 sRGB, N ≥ 1. Raises ValueError where the two differ in length.
    """
    if len(xyz) != len(rgb) or len(xyz) == 0:
        raise ValueError(f"{len(xyz)} points with {len(rgb)} colours: need as many of both, and at least one")
    count = min(_NEIGHBOURS, len(xyz))
    distance, index = cKDTree(xyz).query(mesh.vertices, k=list(range(1, count + 1)), workers=-1)
    spacing = np.maximum(distance.mean(axis=1, keepdims=True), 1e-12)  # all points here: any weights will do
    weight = 1.0 / (distance**2 + (_NEAR * spacing) ** 2)
    weight /= weight.sum(axis=1, keepdims=True)
    blended = np.einsum("vk,vkc->vc", weight, to_linear(rgb)[index])
    return replace(mesh, rgb=to_srgb(blended))
