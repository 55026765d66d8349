"""Batches for the training of the heads: shapes and their pictures. The same seed gives the same batches.

Shapes are generated; where real things are given, every other one is one of them. Batches are made a bag at a time. A
bag's pictures are used four times, every other time mirrored: to make a picture costs half as much as to learn from it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from itertools import islice

import torch
from torch import Tensor

from tests.bench.single_photo_training.pictures import RenderedPictures, mirror_pictures, render_pictures
from tests.bench.single_photo_training.real_things import RealThing, draw_shapes
from tests.bench.single_photo_training.shapes import CLASSES, Shapes, generate_shapes, rotate_shapes

BATCH = 32  # pictures per step
_SHEETS = 12  # per bag: with one, the four uses in a row overfit: Chamfer 13 on them and 21 on others
_EACH = 8  # shapes of every class in a sheet
_VIEWS = 2  # pictures of every shape
SURFACE = 4096  # points of a surface that a batch keeps
_USES = 4  # of every picture
STEPS = _USES * _SHEETS * _VIEWS * _EACH * len(CLASSES) // BATCH
"""Batches in a bag."""
HELD_OUT = 1 << 40
"""Seeds from here on are never trained on."""
_REAL = 1 << 48  # distance of real things' seeds from those of the generated ones
_CAMERAS = 1 << 50
"""Distance of pictures' seeds from their shapes': equal seeds would tie the camera's place to the thing's size."""


@dataclass(frozen=True, slots=True)
class Batch:
    """picture (n,4,64,64), camera (n,6), surface (n,SURFACE,3) in the frame of `shapes.py`, label, yaw (n,)."""

    picture: Tensor
    camera: Tensor
    surface: Tensor
    label: Tensor
    yaw: Tensor

    def __getitem__(self, index: Tensor | slice) -> Batch:
        return Batch(*(each[index] for each in _tensors(self)))

    def to(self, device: torch.device) -> Batch:
        """Copy to another device."""
        return Batch(*(each.to(device) for each in _tensors(self)))


def training_batches(seed: int, step: int, things: Sequence[RealThing] = ()) -> Iterator[Batch]:
    """Yield the training batches from that step on, for ever; things: real ones, every other shape is one of them."""
    while True:
        bag, done = divmod(step, STEPS)
        for batch in islice(_batches(seed, bag, things), done, None):
            yield batch
            step += 1


def held_out_batch(seed: int, each: int, *, clean: bool = False) -> Batch:
    """A batch that training never sees: `each` shapes of every class, one picture of each shape."""
    shapes = generate_shapes(HELD_OUT + seed, each)
    return _make_batch(shapes, render_pictures(shapes, HELD_OUT + _CAMERAS + seed, clean=clean))


def real_batch(things: Sequence[RealThing], seed: int, count: int, *, clean: bool = False) -> Batch:
    """A batch of `count` pictures of real things, as training never draws them."""
    shapes = draw_shapes(things, HELD_OUT + seed, count)
    return _make_batch(shapes, render_pictures(shapes, HELD_OUT + _CAMERAS + seed, clean=clean))


def _batches(seed: int, bag: int, things: Sequence[RealThing]) -> Iterator[Batch]:
    """Yield the batches of one bag."""
    start = (seed << 24) + bag * _SHEETS * _VIEWS
    sheets = [part for sheet in range(_SHEETS) for part in _sheet(start + sheet * _VIEWS, things)]
    plain = Batch(*(torch.cat(parts) for parts in zip(*map(_tensors, sheets), strict=True)))
    order = torch.Generator().manual_seed(start)
    for use in range(_USES):
        for index in torch.split(torch.randperm(len(plain.label), generator=order), BATCH):
            yield _mirror(plain[index]) if use % 2 else plain[index]


def _sheet(start: int, things: Sequence[RealThing]) -> Iterator[Batch]:
    """Yield the views of one sheet: as many shapes as fit a core's cache."""
    shapes = generate_shapes(start, _EACH)
    if things:
        shapes = _alternate(shapes, draw_shapes(things, _REAL + start, len(shapes.label[1::2])))
    for view in range(_VIEWS):
        rotated = rotate_shapes(shapes, _CAMERAS // 2 + start + view) if view else shapes
        yield _make_batch(rotated, render_pictures(rotated, _CAMERAS + start + view))


def _make_batch(shapes: Shapes, pictures: RenderedPictures) -> Batch:
    return Batch(pictures.picture, pictures.camera, shapes.xyz[:, :SURFACE].clone(), shapes.label, shapes.yaw)


def _alternate(shapes: Shapes, others: Shapes) -> Shapes:
    """Replace every other shape by one of the others."""
    mixed = [getattr(shapes, each.name).clone() for each in fields(Shapes)]
    for into, each in zip(mixed, fields(Shapes), strict=True):
        into[1::2] = getattr(others, each.name)
    return Shapes(*mixed)


def _tensors(batch: Batch) -> tuple[Tensor, ...]:
    return batch.picture, batch.camera, batch.surface, batch.label, batch.yaw


def _mirror(batch: Batch) -> Batch:
    pictures = mirror_pictures(RenderedPictures(batch.picture, batch.camera))
    turn = torch.tensor([-1.0, 1.0, 1.0])
    return Batch(pictures.picture, pictures.camera, batch.surface * turn, batch.label, -batch.yaw)
