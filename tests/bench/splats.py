"""Splats beside the mesh, covering it and trained: likeness to photos that were held out, bytes, seconds.

Each row in a process of its own, preset `draft` with the splats of preset `splats`, on the CPU. One photo in eight is
held out. Mesh (the finest level, with its texture) and splats are compared in the same pixels: where the photo shows
the thing and all draw it.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import astuple, dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
import trimesh

from capture2vr.cli.demonstration.demo_phone import simulate_capture
from capture2vr.edge.arrays import Bools, Floats
from capture2vr.edge.capture.nouns import Capture
from capture2vr.edge.convert.read_glb import read_glb
from capture2vr.edge.fusion.texture_views import hold_out_frames, texture_view
from capture2vr.edge.mesh.concatenate import concatenate
from capture2vr.edge.mesh.nouns import Mesh, TexturedMesh
from capture2vr.edge.photos.to_depth import to_depth
from capture2vr.edge.pipeline import reconstruct
from capture2vr.edge.preset import load_preset
from capture2vr.edge.read_capture import read_capture
from capture2vr.edge.render.photo_comparison import LikenessCheck, check_likeness, check_surface, compare_colours
from capture2vr.edge.render.place_views import posed_picture
from capture2vr.edge.render.posed_picture import PosedPicture
from capture2vr.edge.splat_training.splat_rendering import PinholeView, SplatTensors, draw_splats
from capture2vr.edge.splats.spz import from_spz, to_spz
from capture2vr.edge.splats.surface_splats import Splats, cover_with_splats
from capture2vr.storage.bundle import Bundle
from tests.bench import captures
from tests.bench.cell import ROOT

TRAINERS_PLY_BYTES = 248  # of a splat as trainers write it: 62 floats, of which 45 are harmonics
_OPAQUE = 0.9
_ONE_IN = 8  # photos is held out
_HAIRS, _HAIR_M, _BALL_M = 6_000, 0.03, 0.12


@dataclass(frozen=True, slots=True)
class Likeness:
    """Mean figures over the held-out photos: PSNR in dB, structural similarity, sharpness over the photo's."""

    psnr: float
    ssim: float
    sharp: float

    @classmethod
    def of(cls, checks: Sequence[LikenessCheck]) -> Likeness:
        return cls(*(round(float(np.mean([getattr(each, name) for each in checks])), 3) for name in cls.__slots__))


def furry_ball() -> Mesh:
    """A ball with hairs of 3 cm, each a triangle of 1.5 mm at its root, on a floor."""
    rng = np.random.default_rng(0)
    root = rng.normal(size=(_HAIRS, 3))
    root /= np.linalg.norm(root, axis=1, keepdims=True)
    side = np.cross(root, rng.normal(size=(_HAIRS, 3)))
    side *= 0.75e-3 / np.linalg.norm(side, axis=1, keepdims=True)
    middle = np.array([0, _BALL_M + _HAIR_M, 0])
    tip = root * (_BALL_M + _HAIR_M) + rng.normal(scale=0.006, size=(_HAIRS, 3))
    corners = np.stack([root * _BALL_M - side, root * _BALL_M + side, tip], axis=1) + middle
    shade = np.repeat(rng.integers(90, 230, (_HAIRS, 1)) * [1, 0.75, 0.5], 3, axis=0)
    ball = trimesh.creation.icosphere(subdivisions=5, radius=_BALL_M)
    floor = trimesh.creation.box((1.2, 0.002, 1.2)).subdivide_to_size(0.02)
    patch = np.floor(floor.vertices / 0.08).astype(int)
    lit = np.random.default_rng(1).uniform(60, 220, (32, 32, 32))[tuple((patch % 32).T)]
    parts = [
        (np.asarray(ball.vertices) + middle, ball.faces, np.tile([70, 45, 30], (len(ball.vertices), 1))),
        (corners.reshape(-1, 3), np.arange(3 * _HAIRS).reshape(-1, 3), shade),
        (np.asarray(floor.vertices), floor.faces, np.repeat(lit[:, None], 3, axis=1)),
    ]
    return concatenate([Mesh(xyz, np.asarray(faces), rgb.clip(0, 255).astype(np.uint8)) for xyz, faces, rgb in parts])


def _furry(folder: Path) -> Capture:
    simulate_capture(furry_ball(), folder / "walk")
    return read_capture(folder / "walk")


_OF_CAPTURES = (
    "fruit, cameras given",
    "statue, 32 photos",
    "garment, RGB-D, 40 frames",
    "living room, RGB-D, 5 frames",
)
ROWS: dict[str, Callable[[Path], Capture]] = {
    **{name: lambda folder, name=name: captures.ROWS[name](folder).capture for name in _OF_CAPTURES},  # type: ignore[misc]
    "furry ball, RGB-D, 40 frames": _furry,
}


def one(name: str, out: Path | None = None) -> dict[str, Any]:
    """The figures of a row, measured in this process; out: folder for its pictures."""
    preset = replace(load_preset("draft"), splat_steps=load_preset("splats").splat_steps)
    with tempfile.TemporaryDirectory() as folder:
        capture = ROWS[name](Path(folder))
        capture = to_depth(capture) if capture.kind == "photos" else capture
        spared = max(1, len(capture.frames) // _ONE_IN)
        frames = hold_out_frames(capture.frames, spared)[1]
        began = time.perf_counter()
        made = [step for step in reconstruct(capture, preset, hold_out=spared) if isinstance(step, Bundle)]
        seconds = time.perf_counter() - began
        bundle = made[-1]
        level = read_glb(bundle.files["lod0.glb"]).mesh
        to_asset = np.array(bundle.manifest["capture_to_asset"], np.float64).reshape(4, 4)
        photos = [posed_picture(texture_view(frame), to_asset) for frame in frames]
        surface = level.mesh if isinstance(level, TexturedMesh) else level
        checks = check_surface(surface, photos, ())
        photos, things = [each.picture for each in checks], [each.thing for each in checks]
        covering = cover_with_splats(level)
        files = {"mesh": bundle.files["lod0.glb"], "covering": to_spz(covering), "trained": bundle.files["splats.spz"]}
        both = covering, from_spz(files["trained"])
        drawn = [
            _drawn(both, *each) for each in zip(photos, things, check_likeness(level, photos, things), strict=True)
        ]
        if out:
            _write_pictures(out / f"{name.split(',')[0]}.jpg", drawn[0])
        return {
            "photos": len(photos),
            "seconds": round(seconds),
            "splats": [len(each) for each in both],
            "likeness": [astuple(Likeness.of(each)) for each in zip(*drawn, strict=True)],
            "bytes": [len(each) for each in files.values()],
        }


def _drawn(
    splats: Sequence[Splats], photo: PosedPicture, thing: Bools, mesh: LikenessCheck
) -> tuple[LikenessCheck, ...]:
    """Compare mesh and splats with a photo in the same pixels: on the thing, a pixel or two within what is opaque."""
    height, width = mesh.photo.shape[:2]
    device = torch.device("cpu")
    view = PinholeView.of(photo, width, height, device)
    both = cv2.resize(thing.astype(np.uint8), (width, height), interpolation=cv2.INTER_NEAREST) > 0
    over = []
    for each in splats:
        with torch.no_grad():
            rgb, opacity = (found.numpy() for found in draw_splats(SplatTensors.of(each, device), view))
        both &= opacity > _OPAQUE
        over.append(255 * rgb / np.maximum(opacity, 1e-3)[..., None])
    both = cv2.erode(both.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    pictures = (mesh.rendering.astype(np.float32), *over)
    return tuple(compare_colours(mesh.photo, each, both) for each in pictures)


def _write_pictures(file: Path, drawn: Sequence[LikenessCheck]) -> None:
    """The first held-out photo, the mesh, the splats that cover it, and the trained ones, side by side."""
    row: Floats = np.concatenate([drawn[0].photo, *(each.rendering for each in drawn)], axis=1)
    file.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(file), np.ascontiguousarray(row[..., ::-1]), [cv2.IMWRITE_JPEG_QUALITY, 85])


def line_of(name: str, figures: Mapping[str, Any]) -> str:
    """The line of the table for a capture."""
    likeness = (" | ".join(f"{each[place]:.2f}" for each in figures["likeness"]) for place in range(3))
    sizes = " | ".join(f"{size / 1e6:.2f}" for size in figures["bytes"])
    share = figures["bytes"][-1] / (figures["splats"][-1] * TRAINERS_PLY_BYTES)
    return f"| {name} | {figures['photos']} | {' | '.join(likeness)} | {sizes} | {share:.1%} | {figures['seconds']} |"


def main(arguments: Sequence[str]) -> None:
    """Print the table, row by row."""
    parser = argparse.ArgumentParser(prog="python -m tests.bench splats", description=__doc__)
    parser.add_argument("words", nargs="*", help=f"only rows that contain all of these words; all: {'; '.join(ROWS)}")
    parser.add_argument("--out", type=Path, help="folder for pictures: photo, mesh, splats")
    options = parser.parse_args(arguments)
    print("| capture | photos | PSNR mesh | covering | trained | SSIM mesh | covering | trained "
          "| sharp mesh | covering | trained | MB mesh | covering | trained | of a PLY | seconds |")  # fmt: skip
    print(f"|{'---|' * 16}")
    for name in (name for name in ROWS if all(word in name for word in options.words)):
        command = [sys.executable, "-m", "tests.bench.splats", name, *([str(options.out)] if options.out else [])]
        done = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True, cwd=ROOT)
        print(line_of(name, json.loads(done.stdout.splitlines()[-1])), flush=True)


if __name__ == "__main__":
    print(json.dumps(one(sys.argv[1], Path(sys.argv[2]) if len(sys.argv) > 2 else None)))
