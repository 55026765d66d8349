"""One picture to points, on shapes that training never saw: our heads, the mean shape, the nearest training shape.

Chamfer distance: mean squared distance to the nearest point, both ways added, in thousandths; F: within 0.05, 1,024
points against 1,024 of the surface. Things reach 1 from the middle of their bounding box. The floor is what a second
sample of the very surface gets. Pictures are spoilt as in training, unless `--clean` is given.
"""

from __future__ import annotations

import argparse
import dataclasses
import time
from collections.abc import Callable
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import cv2
import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from capture2vr.edge.arrays import Floats
from capture2vr.edge.field.denoise import denoise
from capture2vr.edge.field.folds import noise_of
from capture2vr.edge.field.local import local_field
from capture2vr.edge.mesh.clean import clean
from capture2vr.edge.mesh.extract import extract
from capture2vr.edge.mesh.sampling import sample
from capture2vr.edge.mesh.spacing import auto_resolution
from capture2vr.edge.points.denoise_stereo import smooth_stereo_points
from capture2vr.edge.points.unit import unit_frame
from capture2vr.edge.single_photo.membrane import closed_mesh, inflate
from capture2vr.edge.single_photo.outline_kind import inflation_of
from tests.bench.peers.peer_image import MINUTES, peer
from tests.bench.single_photo_network.camera import about_vertical
from tests.bench.single_photo_network.combine import combine
from tests.bench.single_photo_network.densify import densify
from tests.bench.single_photo_network.network import POINTS, Pixels
from tests.bench.single_photo_network.prediction_views import VIEWS, predict_from_views
from tests.bench.single_photo_network.weights import load_pixels
from tests.bench.single_photo_training.batches import BATCH, Batch, held_out_batch, real_batch, training_batches
from tests.bench.single_photo_training.evaluate import head_points
from tests.bench.single_photo_training.field_heads import anchors
from tests.bench.single_photo_training.losses import chamfer, f_score
from tests.bench.single_photo_training.real_things import read_things
from tests.bench.single_photo_training.shapes import CLASSES, PAPER_CLASSES
from tests.bench.single_photo_training.weight_files import load_field, training_of
from tests.conftest import data_folder

_EACH = 10  # held-out shapes of every class
_TRAINING = 3000  # pictures of training shapes to choose the nearest from, as many as the proof of concept had
_SEED = 1  # of the shipped weights' training
_COARSE = 128  # points of both by which the truly nearest are looked for
_FINALISTS = 12
_FINEST = 192  # cells of a mesh
_RELIEF_PX = 160  # sides of the masks that are inflated
_HALF = 0.5  # covered, from which on a pixel is the thing's
REAL_PICTURES = 12  # of every real thing, from all sides
REAL_THINGS = {
    "milk truck": "milktruck/CesiumMilkTruck.gltf",
    "car": "car/vehicle_example.gltf",
    "dress": "dress/dress-v17k-f34k.obj",
    "T-shirt, folded": "tshirt_folded/tshirt1900-folding-triFolded.obj",
}
LOADERS: dict[str, Callable[[], nn.Module]] = {
    "pixels": load_pixels,
    "anchor-udf": lambda: load_field("anchor-udf"),
    "implicit": lambda: load_field("implicit"),
}


@dataclass(frozen=True, slots=True)
class Row:
    """What one way of guessing made of every picture.

    points (n,1024,3); seconds for one picture; short: its name in the table of the classes, "" where it is left out
    """

    name: str
    points: Tensor
    seconds: float = 0.0
    short: str = ""


def main(arguments: list[str]) -> None:
    """Print one table of all ways, and one of the classes."""
    parser = argparse.ArgumentParser(prog="python -m tests.bench single-image")
    parser.add_argument("--clean", action="store_true", help="perfect masks, no noise")
    parser.add_argument("--peer", type=Path, help="folder of the proof of concept's network, trained there if absent")
    parser.add_argument("--minutes", type=float, default=MINUTES, help="of its training, on one core")
    parser.add_argument(
        "--meshes", type=int, default=0, metavar="N", help="also N meshes of the points, densified or not"
    )
    given = parser.parse_args(arguments)
    torch.set_num_threads(1)
    test = held_out_batch(1, _EACH, clean=given.clean)
    truth = test.surface[:, :POINTS]
    rows = [
        *_baselines(test),
        _relief(test),
        *(_peer(test, given.peer, given.minutes) if given.peer else []),
        *_heads(test),
    ]
    of_the_paper = torch.isin(test.label, torch.arange(len(PAPER_CLASSES)))
    print(
        f"{len(truth)} pictures of {len(CLASSES)} classes; of the proof of concept's {len(PAPER_CLASSES)} in brackets\n"
    )
    print("| guess | Chamfer, 1e-3 | F@.05 | ms a picture |\n|---|---|---|---|")
    for row in rows:
        distance, score = 1e3 * chamfer(row.points, truth), f_score(row.points, truth)
        figures = f"{distance.mean():.1f} ({distance[of_the_paper].mean():.1f}) | {score.mean():.2f} "
        figures += f"({score[of_the_paper].mean():.2f}) | {1e3 * row.seconds:.0f}"
        print(f"| {row.name} | {figures} |", flush=True)
    _print_classes(test.label, truth, rows)
    _print_real_things(given.clean)
    if given.meshes:
        _print_meshes(test, given.meshes)


def _baselines(test: Batch) -> list[Row]:
    known = _known()
    small = [functional.avg_pool2d(each.picture, 2).flatten(1) for each in (test, known)]
    masks = [each.picture[:, 3].flatten(1) for each in (known, test)]
    both = masks[1] @ masks[0].T
    overlap = both / (masks[0].sum(dim=1)[None] + masks[1].sum(dim=1)[:, None] - both)
    mean = anchors(known.surface[:, :64].reshape(1, -1, 3), POINTS).expand(len(test.label), -1, -1)
    points = known.surface[:, :POINTS]
    return [
        Row("floor: the surface sampled again", test.surface[:, POINTS : 2 * POINTS], short="floor"),
        Row("mean shape: k-means of all training points", mean),
        Row("nearest training shape by silhouette", points[overlap.argmax(dim=1)], short="by silhouette"),
        Row("nearest training shape by picture", points[torch.cdist(*small).argmin(dim=1)]),
        Row(
            "truly nearest training shape (needs the answer)", points[_truly_nearest(test.surface[:, :POINTS], points)]
        ),
    ]


@torch.no_grad()
def _peer(test: Batch, folder: Path, minutes: float) -> list[Row]:
    with torch.enable_grad():
        head, steps = peer(folder, minutes)
    began = time.perf_counter()
    points = torch.cat([head(picture[None]) for picture in test.picture])
    seconds = (time.perf_counter() - began) / len(points)
    return [Row(f"proof of concept's network, {steps} steps in {minutes:g} min", points, seconds, "its network")]


def _heads(test: Batch) -> list[Row]:
    rows = []
    for name, load in LOADERS.items():
        head, how = load(), training_of(name)
        began = time.perf_counter()
        points = torch.cat([head_points(head, picture[None]) for picture in test.picture])
        seconds = (time.perf_counter() - began) / len(points)
        rows.append(Row(f"{name}, {how.steps} steps in {how.seconds / 60:.0f} min", points, seconds, name))
        if isinstance(head, Pixels):
            rows += [Row(f"{name} if it were told the yaw", _told(head, test)), _looks(head, test)]
    return rows


def _relief(test: Batch) -> Row:
    """The inflated outline of each picture, as a photo becomes one; it stands as the picture shows the thing."""
    began, points = time.perf_counter(), []
    for picture in test.picture:
        mask = np.zeros((_RELIEF_PX,) * 2, bool)
        inner = slice(_RELIEF_PX // 8, -(_RELIEF_PX // 8))
        side = _RELIEF_PX - 2 * (_RELIEF_PX // 8)
        mask[inner, inner] = cv2.resize(picture[3].numpy(), (side, side)) > _HALF
        mesh = closed_mesh(inflate(mask, inflation_of(mask)[1]))
        xyz = sample(mesh, POINTS, np.random.default_rng(0)).xyz
        xyz -= (xyz.min(axis=0) + xyz.max(axis=0)) / 2
        points.append(torch.from_numpy(xyz / np.linalg.norm(xyz, axis=1).max()).float())
    seconds = (time.perf_counter() - began) / len(points)
    return Row("printed relief: the outline inflated", torch.stack(points), seconds, "relief")


def _looks(head: Pixels, test: Batch) -> Row:
    """As a photo's points are made; every other of them."""
    began = time.perf_counter()
    points = torch.cat([predict_from_views(head, picture[None]).points for picture in test.picture])
    seconds = (time.perf_counter() - began) / len(points)
    return Row(
        "pixels, looks with and without a mirror, and the outline",
        points[:, :, ::VIEWS].flatten(1, 2),
        seconds,
        "looks",
    )


@torch.no_grad()
def _told(head: Pixels, test: Batch) -> Tensor:
    """Turned as the thing is: what is wrong with the shape alone."""
    return about_vertical(torch.cat([head(part).own for part in test.picture.split(100)]), test.yaw)


def _known() -> Batch:
    """Pictures and shapes of training, as many different ones as a bag has."""
    batches = list(islice(training_batches(_SEED, 0), _TRAINING // BATCH))
    fields = (each.name for each in dataclasses.fields(Batch))
    return Batch(*(torch.cat([getattr(batch, field) for batch in batches]) for field in fields))


def _truly_nearest(truth: Tensor, known: Tensor) -> Tensor:
    """(n,) by Chamfer distance: all by a few points, the best of them by all points."""
    best = []
    few = known[:, :_COARSE]
    for one in truth:
        coarse = chamfer(few, one[None, :_COARSE].expand(len(few), -1, -1))
        last = coarse.topk(_FINALISTS, largest=False).indices
        best.append(last[chamfer(known[last], one.expand(_FINALISTS, -1, -1)).argmin()])
    return torch.stack(best)


def _print_classes(label: Tensor, truth: Tensor, rows: list[Row]) -> None:
    chosen = [row for row in rows if row.short]
    print(f"\n| Chamfer, F of | {' | '.join(row.short for row in chosen)} |")
    print(f"|{'---|' * (len(chosen) + 1)}")
    for number, name in enumerate(CLASSES):
        of = label == number
        figures = [
            f"{1e3 * chamfer(row.points[of], truth[of]).mean():.1f}, {f_score(row.points[of], truth[of]).mean():.2f}"
            for row in chosen
        ]
        print(f"| {name} | {' | '.join(figures)} |")


def _print_real_things(clean: bool) -> None:
    """A table of the heads on pictures of real meshes, of which none was trained on."""
    data = data_folder()
    if not data.is_dir():
        print(f"\nReal meshes: not measured, there is no folder {data} (CAPTURE2VR_DATA names it).")
        return
    heads = {name: load() for name, load in LOADERS.items()}
    mean = anchors(_known().surface[:, :64].reshape(1, -1, 3), POINTS)
    print("\n| Chamfer, F of | mean shape |", " | ".join(heads), "|")
    print(f"|{'---|' * (len(heads) + 2)}")
    for name, file in REAL_THINGS.items():
        batch = real_batch(read_things([data / file]), 0, REAL_PICTURES, clean=clean)
        truth = batch.surface[:, :POINTS]
        guesses = [mean.expand(REAL_PICTURES, -1, -1)]
        guesses += [torch.cat([head_points(head, each[None]) for each in batch.picture]) for head in heads.values()]
        figures = [
            f"{1e3 * chamfer(points, truth).mean():.1f}, {f_score(points, truth).mean():.2f}" for points in guesses
        ]
        print(f"| {name}, {REAL_PICTURES} pictures | {' | '.join(figures)} |", flush=True)


def _print_meshes(test: Batch, count: int) -> None:
    """A table of meshes through the points as the network gives them, and densified: 4,096 samples of each."""
    head, figures = load_pixels(), []
    some = torch.linspace(0, len(test.label) - 1, count).long()
    for number in some:
        views = predict_from_views(head, test.picture[number][None]).points[0].numpy().astype(float)
        ways = (views, (48, 32)), ([densify(each) for each in views], (96, 64))
        figures.append([_mesh_figures(list(parts), near, test.surface[number]) for parts, near in ways])
    distance, score, triangles = torch.tensor(figures).mean(dim=0).unbind(dim=1)
    print(f"\n| {count} meshes of | Chamfer, 1e-3 | F@.05 | triangles |\n|---|---|---|---|")
    for way, name in enumerate(("the network's points", "the same, densified")):
        print(f"| {name} | {1e3 * distance[way]:.1f} | {score[way]:.3f} | {triangles[way]:,.0f} |")


def _mesh_figures(views: list[Floats], neighbours: tuple[int, int], truth: Tensor) -> tuple[float, float, float]:
    """Chamfer distance and F-score of a mesh through points of two views, and its number of triangles."""
    xyz, _, keep = combine(views)
    xyz = smooth_stereo_points(xyz[keep], np.ones(int(keep.sum())), neighbours=neighbours)
    unit = unit_frame(xyz)
    near = denoise(unit.to_unit(xyz), noise_of(unit.to_unit(xyz)))
    mesh = clean(extract(local_field(near), near, resolution=auto_resolution(near, high=_FINEST)), near)
    sampled = unit.to_world(sample(mesh, len(truth), np.random.default_rng(0)).xyz)
    points = torch.from_numpy(sampled).float()[None]
    return chamfer(points, truth[None]).item(), f_score(points, truth[None]).item(), float(len(mesh.faces))
