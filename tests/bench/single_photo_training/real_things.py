"""Shapes from real meshes: a folder of files, to train on beside the generated shapes, or to evaluate with."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor
from torch.nn import functional

from capture2vr.edge.errors import CaptureError, EdgeError
from capture2vr.edge.read_capture import read_capture
from tests.bench.single_photo_network.camera import about_vertical
from tests.bench.single_photo_training.shapes import SAMPLES, Shapes, normalise

SUFFIXES = (".obj", ".off", ".stl", ".ply", ".glb", ".gltf")
_STRETCH = 0.1  # most change of a thing's length along each axis: no two dresses are alike
UNKNOWN = -1
"""Label of a thing that is of no class of `shapes.py`."""


@dataclass(frozen=True, slots=True)
class RealThing:
    """Points sampled on a mesh, y up: xyz, normals (m,3) float32; rgb (m,3) in [0,1], or None for a plain mesh."""

    name: str
    xyz: Tensor
    normals: Tensor
    rgb: Tensor | None


def read_things(files: Sequence[Path], report: Callable[[str], None] = print) -> list[RealThing]:
    """Read mesh files; one that cannot be read is left out, and reported with the reason.

    Raises EdgeError MESHES_ABSENT where none is left.
    """
    things = []
    for path in files:
        try:
            cloud = read_capture(path).cloud
            if cloud is None or cloud.normals is None:
                raise CaptureError("CAPTURE_NOT_A_MESH", "has no triangles", file=path.name)
        except CaptureError as error:
            report(f"{path} is left out: {error.message}")
            continue
        xyz, normals = torch.from_numpy(cloud.xyz).float(), torch.from_numpy(cloud.normals).float()
        rgb = None if cloud.rgb is None else torch.from_numpy(cloud.rgb).float() / 255
        things.append(RealThing(path.stem, xyz, normals, rgb))
    if not things:
        where = ", ".join(sorted({str(path.parent) for path in files})) or "the folder"
        raise EdgeError("MESHES_ABSENT", f"there is no mesh that can be read in {where}", hints=(_ADVICE,))
    return things


_ADVICE = f"give a folder with files of the kinds {', '.join(SUFFIXES)}"


def mesh_files(folder: Path) -> list[Path]:
    """All mesh files in a folder and below it, in the order of their names. Raises EdgeError MESHES_ABSENT."""
    if not folder.is_dir():
        raise EdgeError("MESHES_ABSENT", f"{folder} is not a folder", hints=(_ADVICE,))
    return sorted(path for path in folder.rglob("*") if path.suffix.lower() in SUFFIXES)


def fingerprint(things: Sequence[RealThing]) -> str:
    """SHA-256 of all points, by which a training knows its meshes."""
    digest = hashlib.sha256()
    for thing in things:
        digest.update(f"{thing.name} {len(thing.xyz)}".encode() + thing.xyz.numpy().tobytes())
    return digest.hexdigest()


def draw_shapes(things: Sequence[RealThing], seed: int, count: int, *, samples: int = SAMPLES) -> Shapes:
    """Draw `count` of the things, stretched a little and rotated about the vertical. The same seed draws the same."""
    generator = torch.Generator().manual_seed(seed)
    chosen = torch.randint(len(things), (count,), generator=generator).tolist()
    drawn = [_draw(things[number], samples, generator) for number in chosen]
    xyz, normals, rgb = (torch.stack(parts) for parts in zip(*drawn, strict=True))
    yaw = 2 * math.pi * torch.rand(count, generator=generator)
    xyz, normals = about_vertical(normalise(xyz), yaw), about_vertical(normals, yaw)
    return Shapes(xyz, normals, rgb, torch.full((count,), UNKNOWN), yaw)


def _draw(thing: RealThing, samples: int, generator: torch.Generator) -> tuple[Tensor, Tensor, Tensor]:
    """Some points of a stretched thing: xyz, normals, rgb (samples,3)."""
    some = torch.randint(len(thing.xyz), (samples,), generator=generator)
    stretch = 1 + _STRETCH * (2 * torch.rand(3, generator=generator) - 1)
    normals = functional.normalize(thing.normals[some] / stretch, dim=1)
    plain = torch.rand(1, 3, generator=generator)  # drawn for every thing, so that a seed's numbers stay in step
    rgb = plain.expand(samples, 3) if thing.rgb is None else thing.rgb[some]
    return thing.xyz[some] * stretch, normals, rgb
