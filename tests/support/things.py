"""Small assets of one colour, published without a reconstruction: quick to make, and told apart on a screenshot."""

from __future__ import annotations

import io
from collections.abc import Mapping

import numpy as np
import trimesh
from PIL import Image
from trimesh.visual import TextureVisuals
from trimesh.visual.material import PBRMaterial

from capture2vr.edge.export.glb import to_glb
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.storage.bundle import Bundle, Json, State

RED, GREEN, BLUE = (220, 30, 30), (30, 180, 40), (40, 60, 230)
Colour = tuple[int, int, int]


def box(
    label: str,
    colour: Colour,
    *,
    size: tuple[float, float, float] = (0.4, 0.4, 0.4),
    state: State = "refined",
    files: Mapping[str, bytes] | None = None,
    **manifest: Json,
) -> Bundle:
    """A box on the floor, in three levels of 768, 192 and 48 triangles, packed as the product packs them."""
    levels = [_box(size, 3 - level) for level in range(3)]
    glbs = {f"lod{level}.glb": to_glb(_painted(mesh, colour), "meshopt") for level, mesh in enumerate(levels)}
    return bundle_of(label, glbs, [len(mesh.faces) for mesh in levels], size, state, files or {}, **manifest)


def graded(level: str) -> dict[str, Json]:
    """The field of a manifest with a grade of this level."""
    return {"quality": {"grade": {"level": level, "because": "the surface is in shreds", "advice": "Make it matt."}}}


def bundle_of(
    label: str,
    glbs: Mapping[str, bytes],
    triangles: list[int],
    size: tuple[float, float, float],
    state: State = "refined",
    files: Mapping[str, bytes] | None = None,
    **manifest: Json,
) -> Bundle:
    """A bundle as the pipeline makes it, of these levels, finest first."""
    lods = [
        {"file": name, "level": level, "triangles": count, "vertices": count}
        for level, (name, count) in enumerate(zip(glbs, triangles, strict=True))
    ]
    facts = {"lods": lods, "label": label, "size_m": list(size), "scale_confidence": "metric"}
    return Bundle(state, {**glbs, **(files or {})}, {**facts, **manifest})


def textured_glb(colour: Colour, size: tuple[float, float, float] = (0.4, 0.4, 0.4)) -> bytes:
    """A box whose colour is a picture in the file and nothing else."""
    mesh = _box(size, 0)
    uv = np.random.default_rng(0).uniform(size=(len(mesh.vertices), 2))
    picture = Image.open(io.BytesIO(picture_of(colour, 64, "JPEG")))
    material = PBRMaterial(baseColorTexture=picture, metallicFactor=0.0, roughnessFactor=0.9, doubleSided=True)
    mesh.visual = TextureVisuals(uv=uv, material=material)
    glb: bytes = trimesh.Scene(mesh).export(file_type="glb")
    return glb


def picture_of(colour: Colour, side: int = 32, kind: str = "WEBP") -> bytes:
    buffer = io.BytesIO()
    Image.new("RGB", (side, side), colour).save(buffer, kind)
    return buffer.getvalue()


def moving_picture(colours: list[Colour]) -> bytes:
    """An animated WebP of one frame for each colour."""
    frames = [Image.new("RGB", (32, 32), colour) for colour in colours]
    buffer = io.BytesIO()
    frames[0].save(buffer, "WEBP", save_all=True, append_images=frames[1:], duration=200, loop=0)
    return buffer.getvalue()


def _box(size: tuple[float, float, float], subdivided: int) -> trimesh.Trimesh:
    mesh = trimesh.creation.box(size)
    mesh.apply_translation((0, size[1] / 2, 0))
    for _ in range(subdivided):
        mesh = mesh.subdivide()
    return mesh


def _painted(mesh: trimesh.Trimesh, colour: Colour) -> Mesh:
    rgb = np.tile(np.array(colour, np.uint8), (len(mesh.vertices), 1))
    return Mesh(np.asarray(mesh.vertices), np.asarray(mesh.faces), rgb)
