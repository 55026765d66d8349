"""Captures to assets, compared with the photos that were held out: holes, leaks, likeness, seconds.

Each row in a process of its own, preset `draft`, on the CPU. One photo in eight is held out.
"""

from __future__ import annotations

import argparse
import html
import json
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from io import BytesIO
from pathlib import Path
from shutil import copyfile
from typing import Any

import cv2
import numpy as np
import trimesh
from scipy.spatial import cKDTree

from capture2vr.cli.demonstration.demo_garment import garment_scene
from capture2vr.cli.demonstration.demo_phone import simulate_capture
from capture2vr.edge.arrays import Bools, Floats
from capture2vr.edge.capture.nouns import Capture, Frame
from capture2vr.edge.export.ply import stored_origin
from capture2vr.edge.fusion.texture_views import hold_out_frames, texture_view
from capture2vr.edge.mesh.align_to_reference import align_to_surface
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.mesh.sampling import sample
from capture2vr.edge.origin import MEASURED
from capture2vr.edge.photos.depth_maps import at_texture_resolution
from capture2vr.edge.photos.to_depth import to_depth
from capture2vr.edge.pipeline import reconstruct
from capture2vr.edge.preset import load_preset
from capture2vr.edge.read_capture import read_capture
from capture2vr.edge.render.photo_comparison import LIKENESS_PX, check_surface, mean_figures, relative_sharpness
from capture2vr.edge.render.place_views import posed_picture
from capture2vr.edge.render.posed_picture import PosedPicture
from capture2vr.edge.render.rays import RaycastingScene, pinhole
from capture2vr.edge.render.sample_image import bilinear, shrink_to
from capture2vr.edge.render.silhouette import LONGEST_PX
from capture2vr.storage.bundle import Bundle
from tests.bench.borne_out import likeness_of_patches
from tests.bench.cell import ROOT
from tests.bench.data_files import data_file
from tests.bench.outlines import depths_under, votes_of_outlines
from tests.bench.photo_sets import (
    PhotoSet,
    exposure_steps,
    film,
    fruit,
    posed_shell,
    shell,
    statue,
    statue_points,
)
from tests.bench.photos import SEEN_BY, is_seen
from tests.bench.seam import seam_figures
from tests.support import scenes

_ONE_IN = 8  # photos is held out
_PHONE = {"noise": 4.0, "blur": 1.0, "jpeg": 85}
"""Of the rendered photos: a phone's indoors, twice as noisy as the other benches' and less sharp."""
_GLOSS = 0.5  # where white is 1: glazed clay in the sun
_SENSOR = scenes.Sensor(noise_m=0.004, jitter_m=0.003, jitter_deg=0.15, flying=0.5)
"""Of a phone with LiDAR, as `services/cli/demonstration/demo_phone.py` has it."""
_SAMPLES = 1_000_000  # of the mesh: 0.15 % of the statue's size apart
_WITHIN = (0.005, 0.01, 0.02)  # of the thing's size
_REFERENCE = 200_000  # samples of the fruit's reference
_BORNE_OUT = 0.01  # of the thing's size: from this distance on it is asked which of two surfaces the photos bear out
_BESIDE = 0.03  # the same: farther from each other they are not two forms of one surface
_MOVES = 16  # by random parts of a pixel: how much of its sharpness a photo keeps differs with them
_CLEARER = 0.05  # how much more alike the photos must be on one of them

SHARES = {
    "cover": "cover %",
    "lace": "lace %",
    "worst_lace": "worst lace %",
    "inside_out": "inside-out %",
    "leak": "leak %",
    "depth": "depth %",
}
LIKENESS = {"psnr": "psnr", "ssim": "ssim", "sharp": "sharp"}


@dataclass(frozen=True, slots=True)
class Row:
    """A capture of the table.

    capture   of photos or of RGB-D frames
    hold_out  number of pictures to compare with; None: one in eight
    known     what is known of its photos, where they are a set of its own
    points    points (N,3) in the frame of `known`'s cameras that the result should have
    normals   (N,3) theirs, where they are of a surface. Then only points that three photos see count
    """

    capture: Capture
    hold_out: int | None = None
    known: PhotoSet | None = None
    points: Floats | None = None
    normals: Floats | None = None


def _of(known: PhotoSet, points: Floats | None = None) -> Row:
    return Row(read_capture(known.source), known=known, points=points)


def _fruit(folder: Path | None = None) -> Row:
    known = fruit(folder)
    assert known.truth is not None
    points, face = trimesh.sample.sample_surface(known.truth, _REFERENCE, seed=0)
    return replace(_of(known, np.asarray(points)), normals=known.truth.face_normals[face])


def _garment(folder: Path, *, depth: bool) -> Row:
    simulate_capture(garment_scene(), folder / "walk")
    return Row(read_capture(folder / "walk" if depth else folder / "walk" / "images"))


def _living_room(_: Path) -> Row:
    return Row(read_capture(data_file("rgbd_livingroom")), hold_out=1)


def _few_fruit(folder: Path) -> Row:
    """Twelve of the twenty photos."""
    folder.mkdir(exist_ok=True)
    for number, photo in enumerate(sorted(data_file("photos_fruit").joinpath("images").iterdir())):
        if number % 5 < 3:
            copyfile(photo, folder / photo.name)
    return Row(read_capture(folder), hold_out=1)


def _still(_: Path) -> Row:
    """A single frame cannot be spared: it is there twice, and the second one is held out."""
    capture = read_capture(data_file("phone_tof"))
    (frame,) = capture.frames
    again = replace(frame, name=f"{frame.name} again")
    return Row(replace(capture, frames=(frame, again)), hold_out=1)


def _room(_: Path) -> Row:
    frames = scenes.film(scenes.furnished_room(), scenes.look_around(30), scenes.PHONE, _SENSOR)
    up = np.array([0.0, 0.0, 1.0])
    return Row(Capture("rgbd", "simulated", frames=frames, scale_confidence="metric", up=up))


ROWS: dict[str, Callable[[Path], Row]] = {
    "fruit, 20 photos": lambda _: _fruit(),
    "fruit, cameras given": _fruit,
    "fruit, 12 of the photos": lambda folder: _few_fruit(folder / "photos"),
    "bananas, 16 photos": lambda _: Row(read_capture(data_file("photos_banana") / "images")),
    "glass bottle, film": lambda _: Row(read_capture(data_file("film_perfume") / "perfume_quick.mp4")),
    "statue, 32 photos": lambda folder: _of(statue(), statue_points()),
    "statue, cameras given": lambda folder: _of(statue(folder), statue_points()),
    "shell, 25 photos": lambda folder: _of(shell(folder, 25, **_PHONE)),
    "shell, 50 photos, cameras given": lambda folder: _of(posed_shell(folder, 50, **_PHONE)),
    "shell, exposure steps": lambda folder: _of(shell(folder, 25, gains=exposure_steps(25), **_PHONE)),
    "shell, glossy": lambda folder: _of(shell(folder, 25, gloss=_GLOSS, **_PHONE)),
    "shell, film": lambda folder: _of(film(folder, **_PHONE)),
    "garment, 40 photos": lambda folder: _garment(folder, depth=False),
    "garment, RGB-D, 40 frames": lambda folder: _garment(folder, depth=True),
    "living room, RGB-D, 5 frames": _living_room,
    "ToF still (own view)": _still,
    "room, RGB-D, 30 frames": _room,
}


@dataclass(frozen=True, slots=True)
class Made:
    """The last bundle of a row, the frames that it is made from and compared with, and how long it took."""

    bundle: Bundle
    frames: tuple[Frame, ...]
    held_out: tuple[Frame, ...]
    seconds: float


def make(row: Row) -> Made:
    """Make the asset of a row's capture, without the photos that are held out."""
    began = time.perf_counter()
    capture = to_depth(row.capture) if row.capture.kind == "photos" else row.capture
    spared = row.hold_out or -(-len(capture.frames) // _ONE_IN)
    steps = reconstruct(capture, load_preset("draft"), hold_out=spared)
    bundle = [step for step in steps if isinstance(step, Bundle)][-1]
    seconds = time.perf_counter() - began
    return Made(bundle, capture.frames, hold_out_frames(capture.frames, spared)[1], seconds)


def one(name: str, out: Path | None = None) -> dict[str, Any]:
    """The figures of a row, measured in this process; None where there is none. out: folder for its pictures."""
    with tempfile.TemporaryDirectory() as folder:
        row = ROWS[name](Path(folder))
        made = make(row)
        bundle = made.bundle
        if out:
            write_pictures(out, bundle)
        return {
            "placed": f"{len(made.frames)} of {len(row.capture.photos or row.capture.frames)}",
            "seconds": round(made.seconds, 1),
            "texturing": round(bundle.manifest["seconds"]["TEXTURING"], 1),
            "triangles": bundle.manifest["quality"]["triangles"],
            "pieces": bundle.manifest["quality"]["components"],
            **closing_figures(bundle.manifest["quality"]),
            **seam_figures(full_mesh(bundle), filled_vertices(bundle)),
            **photo_figures(bundle.manifest["quality"].get("photos") or {}),
            "moved": _sharpness_when_moved(made.held_out),
            **_figures_of_truth(row, bundle, made.held_out),
            **_shares_of_points(row, bundle, made.frames),
        }


def closing_figures(quality: Mapping[str, Any]) -> dict[str, Any]:
    grade = quality.get("grade")
    return {
        "border": round(quality["border_over_root"], 2),
        "fringe": round(quality["fringe"], 2),
        "largest hole %": percent(quality["largest_hole"]),
        "filled %": percent(quality["origins"]["filled"]),
        "grade": grade and grade["level"],
    }


def photo_figures(photos: Mapping[str, Any]) -> dict[str, Any]:
    shares = {title: percent(photos.get(key)) for key, title in SHARES.items()}
    likeness = {title: None if photos.get(key) is None else round(photos[key], 3) for key, title in LIKENESS.items()}
    return {"held out": photos.get("photos"), **shares, **likeness}


def _sharpness_when_moved(frames: Sequence[Frame]) -> float:
    """Sharpness that photos keep of their own when they are moved twice by a part of a pixel: the mean over moves."""
    rng = np.random.default_rng(0)
    kept = []
    for frame in frames:
        assert frame.load_rgb is not None
        photo = shrink_to(at_texture_resolution(frame.load_rgb)(), LIKENESS_PX)
        height, width = photo.shape[:2]
        grey = cv2.cvtColor(photo, cv2.COLOR_RGB2GRAY).astype(np.float32)
        pixels = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1).reshape(-1, 2) + 0.5
        for offsets in rng.uniform(0, 1, (_MOVES, 2, 2)):
            moved = grey
            for offset in offsets:
                moved = bilinear(moved[..., None], (pixels + offset) / (width, height)).reshape(grey.shape)
            kept.append(relative_sharpness(moved, grey, np.ones(grey.shape, bool)))
    return round(float(np.mean(kept)), 3)


def percent(share: float | None) -> float | None:
    return None if share is None else round(100 * share, 2)


def write_pictures(out: Path, bundle: Bundle) -> None:
    out.mkdir(parents=True, exist_ok=True)
    for name, content in {**bundle.private, "preview.png": bundle.files["preview.png"]}.items():
        (out / name).write_bytes(content)


def full_mesh(bundle: Bundle) -> Mesh:
    """The full mesh, in the capture's frame."""
    loaded = _loaded(bundle)
    return Mesh(np.asarray(loaded.vertices, np.float64), np.asarray(loaded.faces, np.int64))


def filled_vertices(bundle: Bundle) -> Bools:
    """(V,) the vertices of the full mesh that nobody measured."""
    loaded = _loaded(bundle)
    origin = stored_origin(loaded)
    return np.zeros(len(loaded.vertices), bool) if origin is None else origin != MEASURED


def _loaded(bundle: Bundle) -> Any:
    return trimesh.load_mesh(BytesIO(bundle.files["mesh.ply"]), file_type="ply", process=False)


def _figures_of_truth(row: Row, bundle: Bundle, held_out: Sequence[Frame]) -> dict[str, Any]:
    """Cover and leak where the thing's outline in the held-out photos is known, because they were rendered."""
    figures = None
    if row.known and row.known.truth is not None and row.known.intrinsics:
        photos = [posed_picture(texture_view(frame), np.eye(4)) for frame in held_out]
        outline = _Outline(row.known)
        photos = [replace(photo, load_mask=partial(outline, photo)) for photo in photos]
        figures = mean_figures(check_surface(full_mesh(bundle), photos, ()))
    return {
        "true cover %": percent(figures and figures.cover),
        "true leak %": percent(figures and figures.leak),
    }


class _Outline:
    """Renders the mask (h,w) of the true thing in a photo."""

    def __init__(self, known: PhotoSet) -> None:
        assert known.truth is not None
        self._known = known
        self._scene = RaycastingScene(Mesh(np.asarray(known.truth.vertices), np.asarray(known.truth.faces)))

    def __call__(self, photo: PosedPicture) -> Bools:
        camera = self._known.intrinsics
        assert camera is not None
        camera = camera.scaled_to(LONGEST_PX, round(LONGEST_PX * camera.height / camera.width))
        pose = self._known.camera(photo.name)
        x = (np.arange(camera.width) - camera.cx) / camera.fx
        y = (np.arange(camera.height) - camera.cy) / camera.fy
        hits = self._scene.cast(pose[None, :3, 3], pinhole(x, y, *pose[:3, :3].T))
        return (hits.face >= 0).reshape(camera.height, camera.width)


def _shares_of_points(row: Row, bundle: Bundle, frames: Sequence[Frame]) -> dict[str, Any]:
    """Shares of the row's points that the mesh is near to, after the best similarity.

    The cameras bring the points to the mesh; where they were computed, not given, the points' own distances move them
    once more, because a few cameras' centres do not tell how the things lie to within half a percent.
    """
    titles = [f"reference within {100 * within:g} %" for within in _WITHIN]
    borne_out, outlines = "borne out", "deeper, by outlines"
    if row.points is None or row.known is None:
        return dict.fromkeys([*titles, borne_out, outlines])
    ours = np.stack([frame.camera_to_world[:3, 3] for frame in frames])
    theirs = np.stack([row.known.camera(frame.name)[:3, 3] for frame in frames])
    laid, _, _ = trimesh.registration.procrustes(theirs, ours, reflection=False)
    mesh = full_mesh(bundle)
    made = sample(mesh, _SAMPLES, np.random.default_rng(0))
    points = row.points @ laid[:3, :3].T + laid[:3, 3]
    if row.capture.photos[0].camera_to_world is None:
        points = align_to_surface(row.points, made.xyz, made.normals, laid)
    size = float(np.ptp(points, axis=0).max())
    normals = row.normals
    if normals is not None:
        seen = sum(is_seen(frame.camera_to_world, frame.intrinsics, points) for frame in frames) >= SEEN_BY
        turn = trimesh.registration.procrustes(row.points, points, reflection=False, scale=False)[0]
        points, normals = points[seen], (normals @ turn[:3, :3].T)[seen]
    gap, nearest = cKDTree(made.xyz).query(points, workers=-1)
    shares = {
        title: percent(float((gap < within * size).mean())) for title, within in zip(titles, _WITHIN, strict=True)
    }
    if normals is None:
        return {**shares, borne_out: None, outlines: None}
    apart = np.flatnonzero((gap > _BORNE_OUT * size) & (gap < _BESIDE * size))
    pictures = [posed_picture(texture_view(frame), np.eye(4)) for frame in frames]
    scene = RaycastingScene(mesh)
    theirs_alike = likeness_of_patches(points[apart], normals[apart], pictures, scene)
    facing = made.normals[nearest[apart]]
    facing *= np.sign(np.einsum("nx,nx->n", facing, normals[apart]))[:, None]
    ours_alike = likeness_of_patches(made.xyz[nearest[apart]], facing, pictures, scene)
    refuted = ours_alike > theirs_alike + _CLEARER  # False where either is unknown
    depth = depths_under(mesh, points, normals, size)
    ours_there, background = votes_of_outlines(mesh, np.where(depth > _BORNE_OUT * size, depth, 0), pictures)
    return {
        **shares,
        borne_out: percent(float((gap < _BORNE_OUT * size).sum() / (len(gap) - refuted.sum()))),
        outlines: percent(ours_there / max(ours_there + background, 1)),
    }


def main(arguments: list[str]) -> None:
    """Print the table, and write its pictures where a folder is given for them."""
    options = _parser().parse_args(arguments)
    print_rows([name for name in ROWS if all(word in name for word in options.words)], options.out)


def print_rows(names: Sequence[str], out: Path | None, *more: str, module: str = "tests.bench.captures") -> None:
    """Print the table of rows that a module measures; it is called with a row's name, its folder or "", and `more`."""
    measured: dict[str, dict[str, Any]] = {}
    for name, figures in _measured(names, out, *more, module=module):
        if not measured:
            print(f"| capture | {' | '.join(figures)} |\n|{'---|' * (len(figures) + 1)}")
        measured[name] = figures
        print(f"| {name} | {' | '.join(map(_shown, figures.values()))} |", flush=True)
        if out:
            (out / "index.html").write_text(page(measured, out), encoding="utf-8")


def _measured(
    names: Sequence[str], out: Path | None, *more: str, module: str = "tests.bench.captures"
) -> Iterator[tuple[str, dict[str, Any]]]:
    """Each row's figures, in the order of the names; a row that fails is named on the standard error output."""
    for name in names:
        command = [sys.executable, "-m", module, name, str((out / slug(name)).resolve()) if out else "", *more]
        done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, check=False)
        if done.returncode:
            last = (done.stderr.strip() or f"ended with {done.returncode}").splitlines()[-1]
            print(f"{name}: {last}", file=sys.stderr, flush=True)
            continue
        yield name, json.loads(done.stdout.splitlines()[-1])


def slug(name: str) -> str:
    """Name of a row's folder: "fruit, 20 photos" -> "fruit-20-photos"."""
    return re.sub(r"[^a-z0-9]+", "-", name.lower()).strip("-")


def page(measured: Mapping[str, Mapping[str, Any]], out: Path) -> str:
    """HTML of each row's figures beside its pictures, which lie in a folder of `out` each."""
    parts = ["<!doctype html><meta charset=utf-8><title>captures</title>"]
    parts.append("<style>body { font: 14px sans-serif } td { padding: 0 1em 0 0 } img { max-width: 48% }</style>")
    parts.append("<p>Left the photo, right the mesh from its camera: holes magenta, insides yellow, leaks blue.</p>")
    for name, figures in measured.items():
        rows = "".join(f"<tr><td>{html.escape(key)}<td>{_shown(value)}" for key, value in figures.items())
        parts.append(f"<h2>{html.escape(name)}</h2><table>{rows}</table>")
        folder = out / slug(name)
        parts += [f'<img src="{folder.name}/{each.name}" alt="{each.stem}">' for each in sorted(folder.glob("*.*g"))]
    return "\n".join(parts)


def _shown(value: Any) -> str:
    if value is None:
        return ""
    return f"{value:,}" if isinstance(value, int) else str(value)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m tests.bench captures", description=__doc__)
    parser.add_argument("words", nargs="*", help=f"only rows that contain all of these words; all: {'; '.join(ROWS)}")
    parser.add_argument("--out", type=Path, help="folder for each row's pictures and an index.html that shows them")
    return parser


if __name__ == "__main__":
    print(json.dumps(one(sys.argv[1], Path(sys.argv[2]) if sys.argv[2] else None)))
