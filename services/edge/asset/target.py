"""Targets: device classes with a budget for one asset. A job names one, as in `target=quest3`; a bundle that exceeds
its budget makes the job fail.

A Quest 3 draws 1 to 2 million triangles and 200 to 300 draw calls in the 11.1 ms of a frame at 90 Hz, the whole scene
together; a Quest 2 half of that. The smallest level must be on screen within a second at 20 Mbit/s.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Sequence
from dataclasses import dataclass, replace
from io import BytesIO
from typing import Any

from capture2vr.edge.errors import EdgeError
from capture2vr.edge.export.glb import KTX2, Packing
from capture2vr.edge.export.ktx2 import Ktx2Header, ktx2_unavailable
from capture2vr.sentences.sentence import in_row, say

_MIB = 1 << 20
_UNLIT, _KTX2, _NORMALS = "-unlit", "-ktx2", "-normals"
_NORMAL_PX = 1024  # side of a normal map: with its mips it takes 5.6 MB on the device
_ALL = 100_000_000  # triangles: more than any extraction makes


@dataclass(frozen=True, slots=True)
class Target:
    """Device class with the budget of one asset; a limit of 0 means no limit.

    lod_faces        most triangles of each level, finest first; (): as in the preset
    last_bytes       most bytes of the coarsest level's file
    unpacked_bytes   most bytes of a level on the device: vertices, indices and textures with their mips
    texture_px       longest side of a texture; 0: colours stay at the vertices
    normal_px        longest side of a normal map; 0: none
    packing          of the files
    unlit            whether colours are shown as they were captured, rather than in the light of the scene
    ktx2             whether textures are KTX2, by an encoder that is passed beside the target; otherwise JPEG
    """

    name: str
    summary: str
    lod_faces: tuple[int, ...] = ()
    last_bytes: int = 0
    unpacked_bytes: int = 0
    texture_px: int = 2048
    normal_px: int = 0
    packing: Packing = "meshopt"
    unlit: bool = False
    ktx2: bool = False


NO_TARGET = Target("", "the preset's levels of detail, without limits")
TARGETS = {
    target.name: target
    for target in (
        Target("quest3", "Meta Quest 3 and similar headsets", (100_000, 25_000, 5_000), 300_000, 40 * _MIB),
        Target("quest2", "Meta Quest 2 and similar headsets", (50_000, 12_500, 2_500), 300_000, 20 * _MIB, 1024),
        Target("web", "phones and laptops, in a web page", (100_000, 25_000, 5_000), 150_000, 40 * _MIB, 1024),
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
    """Figures of one level of detail, read from its file; texture_bytes: on the device, with mips."""

    triangles: int
    vertices: int
    draw_calls: int
    bytes: int
    unpacked_bytes: int
    texture_bytes: int


def target_of(name: str) -> Target:
    """Find a target by its name.

    "quest3-unlit" is quest3 with colours as captured, rather than in the light of the scene; "quest3-ktx2" and
    "quest3-unlit-ktx2" have KTX2 textures; "quest3-normals" has normal maps, which need the scene's light and are not
    compressed. Raises EdgeError TARGET_UNKNOWN, naming all targets.
    """
    if not name:
        return NO_TARGET
    if (base := name.removesuffix(_NORMALS)) != name and base in TARGETS and TARGETS[base].texture_px:
        return replace(TARGETS[base], name=name, normal_px=_NORMAL_PX)
    plain = name.removesuffix(_KTX2)
    base = plain.removesuffix(_UNLIT)
    ktx2 = plain != name
    if base not in TARGETS or (ktx2 and not TARGETS[base].texture_px):
        known = ", ".join(TARGETS)
        suffixes = f"or one of them followed by {_UNLIT}, or by {_KTX2} or {_NORMALS} if it has textures"
        hints = (say("use_one", names=known), suffixes)
        raise EdgeError("TARGET_UNKNOWN", say("no_target", name=name), hints=hints)
    return replace(TARGETS[base], name=name, unlit=plain != base, ktx2=ktx2)


def require_encoder(target: Target, *, has_encoder: bool) -> None:
    """Raise EdgeError KTX2_UNAVAILABLE where a target wants KTX2 textures and there is no encoder."""
    if target.ktx2 and not has_encoder:
        raise ktx2_unavailable("EDGE_KTX2 is not set")


def measure_cost(glb: bytes) -> Cost:
    """Read the figures of a .glb that `to_glb` wrote."""
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
    """Bytes of a texture on the device: four per texel of a JPEG, one per texel of KTX2, and a third more for mips."""
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


def require_budget(target: Target, levels: Sequence[Cost]) -> None:
    """Raise EdgeError BUDGET_UNREACHABLE, naming every level and figure that exceeds the target's budget."""
    exceeded = [
        say("lod_has", level=level, value=value, unit=unit, limit=limit)
        for level, cost in enumerate(levels)
        for unit, value, limit in _limits(target, level, cost, last=level == len(levels) - 1)
        if limit and value > limit
    ]
    if exceeded:
        others = ", ".join(name for name in TARGETS if name != target.name)
        hints = (say("capture_less_around_object_use"), say("other_targets", names=others))
        message = say("budget_target_exceeded", target=target.name, what=in_row("; ", exceeded))
        raise EdgeError("BUDGET_UNREACHABLE", message, hints=hints)


def _limits(target: Target, level: int, cost: Cost, *, last: bool) -> list[tuple[str, int, int]]:
    """(unit, value, limit) of every figure of a level that has a budget."""
    faces = target.lod_faces[level] if level < len(target.lod_faces) else 0
    unpacked = cost.unpacked_bytes + cost.texture_bytes
    return [
        ("triangles", cost.triangles, faces),
        ("bytes", cost.bytes, target.last_bytes if last else 0),
        (say("bytes_on_device"), unpacked, target.unpacked_bytes),
    ]
