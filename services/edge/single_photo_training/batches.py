"""What the heads learn from: generated shapes and their pictures, a bag at a time; the same seed, the same lessons.

A bag's pictures are used four times, every other time in a mirror: making them costs half of learning from them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice

import torch
from torch import Tensor

from services.edge.guess.pictures import Pictures, mirrored, photographed
from services.edge.guess.shapes import CLASSES, Shapes, shapes, turned

BATCH = 32
_SHEETS = 12  # with one, four uses in a row are learnt by heart: Chamfer 13 on them and 21 on others
_EACH = 8  # shapes of every class in a sheet
_VIEWS = 2  # pictures of every shape
SURFACE = 4096  # points of a surface that a lesson keeps
_USES = 4
STEPS = _USES * _SHEETS * _VIEWS * _EACH * len(CLASSES) // BATCH
"""Batches in a bag."""
HELD_OUT = 1 << 40
"""Seeds from here on are never trained on."""
_CAMERAS = 1 << 50
"""Between the seeds of shapes and of their pictures: equal ones would tie the camera's place to the thing's size."""


@dataclass(frozen=True, slots=True)
class Lesson:
    """picture (n,4,64,64), camera (n,6), surface (n,SURFACE,3) in the frame of `shapes.py`, label, yaw (n,)."""

    picture: Tensor
    camera: Tensor
    surface: Tensor
    label: Tensor
    yaw: Tensor

    def __getitem__(self, index: Tensor | slice) -> Lesson:
        return Lesson(*(each[index] for each in _parts(self)))

    def to(self, device: torch.device) -> Lesson:
        """On another device."""
        return Lesson(*(each.to(device) for each in _parts(self)))


def lessons(seed: int, step: int) -> Iterator[Lesson]:
    """The batches from that step on, for ever."""
    while True:
        bag, done = divmod(step, STEPS)
        for lesson in islice(_batches(seed, bag), done, None):
            yield lesson
            step += 1


def held_out(seed: int, each: int, *, clean: bool = False) -> Lesson:
    """`each` shapes of every class that training never sees, one picture of each."""
    these = shapes(HELD_OUT + seed, each)
    return _lesson(these, photographed(these, HELD_OUT + _CAMERAS + seed, clean=clean))


def _batches(seed: int, bag: int) -> Iterator[Lesson]:
    start = (seed << 24) + bag * _SHEETS * _VIEWS
    sheets = [part for sheet in range(_SHEETS) for part in _sheet(start + sheet * _VIEWS)]
    plain = Lesson(*(torch.cat(parts) for parts in zip(*map(_parts, sheets), strict=True)))
    order = torch.Generator().manual_seed(start)
    for use in range(_USES):
        for index in torch.split(torch.randperm(len(plain.label), generator=order), BATCH):
            yield _mirrored(plain[index]) if use % 2 else plain[index]


def _sheet(start: int) -> Iterator[Lesson]:
    """So many shapes at a time as a core's cache holds."""
    these = shapes(start, _EACH)
    for view in range(_VIEWS):
        seen = turned(these, _CAMERAS // 2 + start + view) if view else these
        yield _lesson(seen, photographed(seen, _CAMERAS + start + view))


def _lesson(these: Shapes, pictures: Pictures) -> Lesson:
    return Lesson(pictures.picture, pictures.camera, these.xyz[:, :SURFACE].clone(), these.label, these.yaw)


def _parts(lesson: Lesson) -> tuple[Tensor, ...]:
    return lesson.picture, lesson.camera, lesson.surface, lesson.label, lesson.yaw


def _mirrored(lesson: Lesson) -> Lesson:
    pictures = mirrored(Pictures(lesson.picture, lesson.camera))
    turn = torch.tensor([-1.0, 1.0, 1.0])
    return Lesson(pictures.picture, pictures.camera, lesson.surface * turn, lesson.label, -lesson.yaw)
