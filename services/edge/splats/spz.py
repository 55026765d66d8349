"""Write and read Gaussian splats as .spz, version 3: about 15 bytes a splat instead of the 248 of a trainer's .ply.

Format: https://github.com/nianticlabs/spz (MIT). A gzip stream of a header and one section per property: positions as
24-bit fixed-point numbers, opacities, colours, logarithms of scales in steps of 1/16, and quaternions without their
largest component, 10 bits for each of the others. Axes: right, up, back, as in glTF.

Written here, because the libraries that write it bring compilers for Python along (gsply: numba) or are not on PyPI.
"""

from __future__ import annotations

import gzip
import math
import struct

import numpy as np

from capture2vr.edge.arrays import Bytes, Floats, Ints
from capture2vr.edge.splats.surface_splats import Splats

_MAGIC, _VERSION, _DEGREE, _FLAGS = 0x5053474E, 3, 0, 0
_POSITION_BITS, _MOST_FRACTION_BITS = 23, 20  # without the sign; 2^-20 m is a thousandth of a millimetre
HARMONIC = 0.28209479177387814  # of degree 0
COLOUR_GAIN = 0.15 / HARMONIC  # of a colour less one half
_HEADER, _HEADER_BYTES = "<IIIBBBB", 16
_COMPONENT_BITS = 9  # of a quaternion's component, without the sign
_LEVEL = 6  # of gzip


def to_spz(splats: Splats) -> bytes:
    """Encode splats as the bytes of a .spz file. The same splats give the same bytes."""
    farthest = float(np.abs(splats.xyz).max(initial=1e-6))
    bits = max(0, min(_MOST_FRACTION_BITS, _POSITION_BITS - 1 - math.ceil(math.log2(farthest))))
    header = struct.pack(_HEADER, _MAGIC, _VERSION, len(splats), _DEGREE, bits, _FLAGS, 0)
    colour = (splats.rgb / 255 - 0.5) * (COLOUR_GAIN * 255) + 127.5
    sections = (
        _fixed_point(splats.xyz, bits),
        _byte(splats.opacity * 255),
        _byte(colour),
        _byte((np.log(splats.scale) + 10) * 16),
        _smallest_three(splats.rotation.astype(np.float64)),
    )
    return gzip.compress(header + b"".join(each.tobytes() for each in sections), _LEVEL, mtime=0)


def from_spz(data: bytes) -> Splats:
    """Decode what `to_spz` has written. Raises ValueError where it has not."""
    whole = gzip.decompress(data)
    magic, version, count, degree, bits, *_ = struct.unpack_from(_HEADER, whole)
    if (magic, version, degree) != (_MAGIC, _VERSION, _DEGREE) or len(whole) != _HEADER_BYTES + 20 * count:
        raise ValueError("this is no .spz of version 3 without harmonics")
    bytes_of = np.frombuffer(whole, np.uint8, offset=_HEADER_BYTES)
    places, opacity, colour, scale, turns = np.split(bytes_of, np.cumsum([9 * count, count, 3 * count, 3 * count]))
    rgb = (colour.reshape(-1, 3).astype(np.float32) - 127.5) / COLOUR_GAIN + 127.5
    return Splats(
        whole_numbers(places).reshape(-1, 3).astype(np.float32) / (1 << bits),
        _turns(turns.view("<u4")),
        np.exp(scale.reshape(-1, 3).astype(np.float32) / 16 - 10),
        opacity.astype(np.float32) / 255,
        _byte(rgb),
    )


def _fixed_point(xyz: Floats, bits: int) -> Bytes:
    """Little-endian 24-bit numbers (N,3,3)."""
    whole = np.rint(xyz.astype(np.float64) * (1 << bits)).astype("<i4")
    return np.ascontiguousarray(whole[..., None].view(np.uint8)[..., :3])


def whole_numbers(thirds: Bytes) -> Ints:
    """Return little-endian 24-bit numbers (N,) of their bytes (3·N,)."""
    padded = np.zeros((len(thirds) // 3, 4), np.uint8)
    padded[:, 1:] = thirds.reshape(-1, 3)
    number: Ints = padded.view("<i4")[:, 0] >> 8  # keeps the sign
    return number


def _byte(values: Floats) -> Bytes:
    return np.rint(values).clip(0, 255).astype(np.uint8)


def _smallest_three(rotation: Floats) -> Bytes:
    """Quaternions (N,4) as 32-bit words: the number of the largest component, and the others' signs and sizes."""
    largest = np.abs(rotation).argmax(axis=1)
    sign = np.sign(np.take_along_axis(rotation, largest[:, None], axis=1))
    positive = rotation * sign  # the same turn, whose largest component is positive and need not be stored
    steps = (1 << _COMPONENT_BITS) - 1
    word = largest.astype(np.uint32)
    for axis in range(4):
        size = np.rint(np.abs(positive[:, axis]) * math.sqrt(2) * steps).clip(0, steps).astype(np.uint32)
        stored = (positive[:, axis] < 0).astype(np.uint32) << np.uint32(_COMPONENT_BITS) | size
        word = np.where(largest == axis, word, word << np.uint32(_COMPONENT_BITS + 1) | stored)
    packed: Bytes = word.astype("<u4")[:, None].view(np.uint8)
    return packed


def _turns(word: Ints) -> Floats:
    """Quaternions (N,4) of 32-bit words."""
    steps = (1 << _COMPONENT_BITS) - 1
    largest, rest = word >> np.uint32(30), word.copy()
    rotation = np.zeros((len(word), 4), np.float32)
    for axis in reversed(range(4)):
        size = (rest & np.uint32(steps)).astype(np.float32) / (math.sqrt(2) * steps)
        signed = np.where(rest >> np.uint32(_COMPONENT_BITS) & np.uint32(1), -size, size)
        stored = largest != axis
        rotation[stored, axis] = signed[stored]
        rest = np.where(stored, rest >> np.uint32(_COMPONENT_BITS + 1), rest)
    missing = np.sqrt(np.maximum(0, 1 - np.square(rotation).sum(axis=1)))
    rotation[np.arange(len(word)), largest] = missing
    return rotation
