"""A .spz file is read back by the format's own words: places, sizes, turns and colours are as they were."""

from __future__ import annotations

import gzip
import struct
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from capture2vr.edge.arrays import Floats
from capture2vr.edge.splats.spz import from_spz, to_spz
from capture2vr.edge.splats.surface_splats import Splats


@st.composite
def splat_sets(draw: st.DrawFn) -> Splats:
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    count, side = draw(st.integers(1, 200)), draw(st.sampled_from([0.01, 1.0, 30.0, 2_000.0]))
    turns = rng.normal(size=(count, 4))
    return Splats(
        rng.uniform(-side, side, (count, 3)).astype(np.float32),
        (turns / np.linalg.norm(turns, axis=1, keepdims=True)).astype(np.float32),
        np.exp(rng.uniform(-9.5, 2, (count, 3))).astype(np.float32),
        rng.uniform(0, 1, count).astype(np.float32),
        rng.integers(0, 256, (count, 3)).astype(np.uint8),
    )


@dataclass(frozen=True)
class Decoded:
    """What a reader makes of a file, section by section."""

    xyz: Floats
    opacity: Floats
    rgb: Floats
    scale: Floats
    rotation: Floats


def decoded(data: bytes) -> Decoded:
    whole = gzip.decompress(data)
    magic, version, count, degree, bits, _, _ = struct.unpack_from("<IIIBBBB", whole)
    assert (magic, version, degree) == (0x5053474E, 3, 0)
    rest = np.frombuffer(whole[16:], np.uint8)
    places, opacity, colour, scale, turns = np.split(rest, np.cumsum([9 * count, count, 3 * count, 3 * count]))
    assert len(turns) == 4 * count
    thirds = places.reshape(-1, 3).astype(np.int64)
    number = thirds[:, 0] | thirds[:, 1] << 8 | thirds[:, 2] << 16
    number -= (number >= 1 << 23) * (1 << 24)
    return Decoded(
        number.reshape(-1, 3) / 2**bits,
        opacity / 255,
        ((colour.reshape(-1, 3) - 127.5) / (0.15 * 255) * 0.28209479177387814 + 0.5) * 255,
        np.exp(scale.reshape(-1, 3) / 16 - 10),
        np.stack([unpacked(int(word)) for word in turns.view("<u4")]),
    )


def unpacked(word: int) -> Floats:
    """A quaternion: the last component is in the lowest bits, the largest is what makes the length 1."""
    largest, turn = word >> 30, np.zeros(4)
    for axis in reversed([axis for axis in range(4) if axis != largest]):
        size = (word & 511) / 511 / np.sqrt(2)
        turn[axis] = -size if word & 512 else size
        word >>= 10
    turn[largest] = np.sqrt(max(0.0, 1 - np.square(turn).sum()))
    return turn


@given(splat_sets())
@settings(max_examples=60, deadline=None)
def test_splats_are_read_back_as_they_were(splats: Splats) -> None:
    found = decoded(to_spz(splats))
    farthest = np.abs(splats.xyz).max()
    np.testing.assert_allclose(found.xyz, splats.xyz, atol=max(1e-6, farthest * 2**-21))
    np.testing.assert_allclose(found.opacity, splats.opacity, atol=0.51 / 255)
    np.testing.assert_allclose(found.rgb, splats.rgb, atol=1)
    np.testing.assert_allclose(np.log(found.scale), np.log(splats.scale), atol=0.51 / 16)
    assert np.abs((found.rotation * splats.rotation).sum(axis=1)).min() > 1 - 1e-4


@given(splat_sets())
@settings(max_examples=30, deadline=None)
def test_the_product_reads_the_same(splats: Splats) -> None:
    data = to_spz(splats)
    found, expected = from_spz(data), decoded(data)
    np.testing.assert_allclose(found.xyz, expected.xyz, rtol=1e-6, atol=1e-7)
    np.testing.assert_allclose(found.rotation, expected.rotation, atol=1e-5)
    np.testing.assert_allclose(found.scale, expected.scale, rtol=1e-5)
    np.testing.assert_allclose(found.opacity, expected.opacity, atol=1e-6)
    np.testing.assert_allclose(found.rgb, expected.rgb.clip(0, 255), atol=0.51)


@pytest.mark.parametrize(
    "wrong",
    [b"nonsense!", gzip.compress(b"x"), gzip.compress(bytes(16))],
    ids=["no gzip", "gzip of one byte", "gzip of 16 zeros"],
)
def test_another_file_is_refused(wrong: bytes) -> None:
    with pytest.raises((ValueError, OSError, struct.error)):
        from_spz(wrong)


@given(splat_sets())
@settings(max_examples=10, deadline=None)
def test_the_same_splats_give_the_same_bytes(splats: Splats) -> None:
    assert to_spz(splats) == to_spz(splats)
