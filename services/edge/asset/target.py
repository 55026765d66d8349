"""Device classes and what one asset may cost on them. `target=quest3` of a job names one; a bundle proves that it keeps
within it, or the job fails.

A Quest 3 draws 1 to 2 million triangles and 200 to 300 draw calls in the 11.1 ms of a frame at 90 Hz, the whole scene
together; a Quest 2 half of that. The smallest level is to be on screen within a second at 20 Mbit/s.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Sequence
from dataclasses import dataclass, replace
from io import BytesIO
from typing import Any

from services.edge.errors import EdgeError
from services.edge.mesh.glb import KTX2, Packing
from services.edge.mesh.ktx2 import Encode, Ktx2Header, unavailable

_MIB = 1 << 20
_UNLIT, _KTX2 = "-unlit", "-ktx2"
_ALL = 100_000_000  # triangles: more than any extraction makes


@dataclass(frozen=True, slots=True)
class Target:
    """What may be spent on one asset; a limit of 0 is none.

    lod_faces        most triangles of each level, finest first; () leaves them to the preset
    last_bytes       most bytes of the coarsest level's file
    unpacked_bytes   most bytes of a level on the device: vertices, indices and textures with their mips
    texture_px       longest side of a texture; 0: colours stay at the vertices
    packing          of the files; None: the smallest that can be written
    unlit            whether colours are shown as they were captured, rather than in the light of the scene
    ktx2             packs textures as KTX2; None: they are JPEG
    """

    name: str
    summary: str
    lod_faces: tuple[int, ...] = ()
    last_bytes: int = 0
    unpacked_bytes: int = 0
    texture_px: int = 2048
    packing: Packing | None = None
    unlit: bool = False
    ktx2: Encode | None = None


NO_TARGET = Target("", "the preset's levels, nothing proved")
TARGETS = {
    target.name: target
    for target in (
        Target("quest3", "Meta Quest 3 and its like", (100_000, 25_000, 5_000), 300_000, 40 * _MIB),
        Target("quest2", "Meta Quest 2 and its like", (50_000, 12_500, 2_500), 300_000, 20 * _MIB, 1024),
        Target("web", "phones and laptops, in a page", (100_000, 25_000, 5_000), 150_000, 40 * _MIB, 1024),
        Target(
            "archive",
            "other programs: every triangle, as floats",
            (_ALL, 100_000, 25_000),
            texture_px=0,
            packing="float",
        ),
    )
}


@dataclass(frozen=True, slots=True)
class Cost:
    """What one level costs, read from its file. Bytes of textures are those on the device, with mips."""

    triangles: int
    vertices: int
    draw_calls: int
    bytes: int
    unpacked_bytes: int
    texture_bytes: int


def wants_ktx2(name: str) -> bool:
    """Whether a target's name asks for textures as KTX2."""
    return name.endswith(_KTX2)


def target_of(name: str, ktx2: Encode | None = None) -> Target:
    """By name; "quest3-unlit" is quest3 with its colours as captured, rather than in the light of the scene, and
    "quest3-ktx2" or "quest3-unlit-ktx2" has its textures packed by `ktx2`.

    Raises EdgeError TARGET_UNKNOWN, naming all, and KTX2_UNAVAILABLE where that is wanted and nothing packs it.
    """
    if not name:
        return NO_TARGET
    plain = name.removesuffix(_KTX2)
    base = plain.removesuffix(_UNLIT)
    if base not in TARGETS or (wants_ktx2(name) and not TARGETS[base].texture_px):
        known = ", ".join(TARGETS)
        hints = (f"use one of: {known}", f"or one of them with {_UNLIT} behind it, or {_KTX2} if it has textures")
        raise EdgeError("TARGET_UNKNOWN", f"there is no target '{name}'", hints=hints)
    if wants_ktx2(name) and ktx2 is None:
        raise unavailable("EDGE_KTX2 is not set")
    return replace(TARGETS[base], name=name, unlit=plain != base, ktx2=ktx2 if wants_ktx2(name) else None)


def cost_of(glb: bytes) -> Cost:
    """The figures of a .glb that `to_glb` wrote."""
    (length,) = struct.unpack_from("<I", glb, 12)
    document = json.loads(glb[20 : 20 + length])
    primitives = [primitive for mesh in document["meshes"] for primitive in mesh["primitives"]]
    counts = [accessor["count"] for accessor in document["accessors"]]
    binary = glb[28 + length :]
    geometry = sum(view["byteLength"] for view in document["bufferViews"] if "target" in view)
    return Cost(
        triangles=sum(counts[each["indices"]] for each in primitives) // 3,
        vertices=sum(counts[each["attributes"]["POSITION"]] for each in primitives),
        draw_calls=len(primitives),
        bytes=len(glb),
        unpacked_bytes=geometry,
        texture_bytes=sum(_texture_bytes(document, image, binary) for image in document.get("images", [])),
    )


def _texture_bytes(document: dict[str, Any], image: dict[str, Any], binary: bytes) -> int:
    """Of a JPEG four bytes a texel, of KTX2 a quarter of that; and a third more for the mips."""
    from PIL import Image

    view = document["bufferViews"][image["bufferView"]]
    start = view.get("byteOffset", 0)
    content = binary[start : start + view["byteLength"]]
    if image["mimeType"] == KTX2:
        return Ktx2Header.of(content).device_bytes
    with Image.open(BytesIO(content)) as picture:
        width, height = picture.size
    texels = width * height
    while width > 1 or height > 1:
        width, height = max(width // 2, 1), max(height // 2, 1)
        texels += width * height
    return 4 * texels


def require_within(target: Target, levels: Sequence[Cost]) -> None:
    """Raises EdgeError BUDGET_UNREACHABLE that names every level and figure beyond the target's."""
    over = [
        f"LOD {level} has {having:,} {what} of {limit:,}"
        for level, cost in enumerate(levels)
        for what, having, limit in _limits(target, level, cost, last=level == len(levels) - 1)
        if limit and having > limit
    ]
    if over:
        wider = ", ".join(name for name in TARGETS if name != target.name)
        hints = ("capture less around the thing, or use a coarser preset", f"other targets: {wider}")
        raise EdgeError("BUDGET_UNREACHABLE", f"target {target.name} cannot be met: {'; '.join(over)}", hints=hints)


def _limits(target: Target, level: int, cost: Cost, *, last: bool) -> list[tuple[str, int, int]]:
    faces = target.lod_faces[level] if level < len(target.lod_faces) else 0
    unpacked = cost.unpacked_bytes + cost.texture_bytes
    return [
        ("triangles", cost.triangles, faces),
        ("bytes", cost.bytes, target.last_bytes if last else 0),
        ("bytes on the device", unpacked, target.unpacked_bytes),
    ]
