"""Lofts, from which all shapes are made: rings swept along a line. Torch, a batch of n at a time.

A ring is centre + side·c(θ) + front·s(θ); (c, s) runs along a circle (square 0) or a square (square 1). Rings of size 0
close an end, rings at one place make a sharp edge. Numbers of the batch are (n,1), profiles along a loft (n,L) or (L,).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional

SEGMENTS = 24
"""Segments around a ring; a multiple of 8, so that a square's corners are vertices."""
RINGS = 12
"""Rings along a loft; a shorter one repeats its last ring, whose triangles then have no area."""

Profile = Tensor | Sequence[float] | float


@dataclass(frozen=True, slots=True)
class Dice:
    """Random numbers for n shapes at a time, from one seeded generator."""

    n: int
    generator: torch.Generator

    def __call__(self, low: float, high: float) -> Tensor:
        """(n,1) uniform in [low, high]."""
        return low + (high - low) * torch.rand(self.n, 1, generator=self.generator)

    def often(self, share: float) -> Tensor:
        """(n,1): 1 in that share of the shapes, else 0."""
        return (torch.rand(self.n, 1, generator=self.generator) < share).float()


def loft(
    centre: Tensor,
    side: Tensor,
    front: Tensor,
    *,
    square: Profile = 0.0,
    arc: tuple[float, float] = (0.0, 1.0),
    folds: Tensor | None = None,
) -> Tensor:
    """Sweep rings: centre, side and front (n,L,3) -> vertices (n, RINGS, SEGMENTS+1, 3).

    arc    the part of the ring that there is, in turns
    folds  (n,L,SEGMENTS+1): factor on the ring's size, for pleats
    """
    turn = torch.linspace(arc[0], arc[1], SEGMENTS + 1) * 2 * math.pi
    c, s = turn.cos(), turn.sin()
    corner = 1 / torch.maximum(c.abs(), s.abs())
    q = torch.as_tensor(square).reshape(-1, 1, 1)
    stretch = 1 - q + q * corner
    if folds is not None:
        stretch = stretch * folds
    vertices = (
        centre[:, :, None] + side[:, :, None] * (stretch * c)[..., None] + front[:, :, None] * (stretch * s)[..., None]
    )
    missing = RINGS - vertices.shape[1]
    return torch.cat([vertices, vertices[:, -1:].expand(-1, missing, -1, -1)], dim=1)


def spindle(
    axis: str,
    along: Profile,
    r1: Profile,
    r2: Profile,
    *,
    at: Sequence[Profile] = (0.0, 0.0),
    n: int,
    square: Profile = 0.0,
    arc: tuple[float, float] = (0.0, 1.0),
    folds: Tensor | None = None,
) -> Tensor:
    """Rings across an axis. "y": r1 along x, r2 along z. "z": r1 along x, r2 along y. "x": r1 along z, r2 along y.

    `at` moves the rings' centres along those two directions.
    """
    along, r1, r2, o1, o2 = _profiles(n, along, r1, r2, *at)
    zero = torch.zeros_like(along)
    main, first, second = {"x": (0, 2, 1), "y": (1, 0, 2), "z": (2, 0, 1)}[axis]
    place: list[Tensor] = [zero, zero, zero]
    place[main], place[first], place[second] = along, o1, o2
    side = [zero, zero, zero]
    side[first] = r1
    front = [zero, zero, zero]
    front[second] = r2
    stack = [torch.stack(parts, dim=-1) for parts in (place, side, front)]
    return loft(*stack, square=square, arc=arc, folds=folds)


def box(
    n: int, centre: Sequence[Profile], size: Sequence[Profile], *, square: Profile = 1.0, taper: Profile = 1.0
) -> Tensor:
    """A closed box: centre and size along x, y, z; its top is `taper` times as wide as its foot."""
    x, y, z, sx, sy, sz, top = (_profiles(n, each)[0] for each in (*centre, *size, taper))
    grow = torch.cat([torch.zeros_like(top), torch.ones_like(top), top, torch.zeros_like(top)], dim=1)
    up = torch.tensor([-0.5, -0.5, 0.5, 0.5])
    return spindle("y", y + sy * up, sx / 2 * grow, sz / 2 * grow, at=(x, z), n=n, square=square)


def pipe(path: Tensor, r: Profile, r2: Profile | None = None, *, closed: bool = True, square: Profile = 0.0) -> Tensor:
    """A tube along `path` (n,L,3), L at most RINGS-2 where closed; radius r, and r2 in the other direction."""
    n = len(path)
    width, depth = _profiles(n, r, r if r2 is None else r2, length=path.shape[1])
    step = torch.cat([path[:, 1:2] - path[:, :1], path[:, 2:] - path[:, :-2], path[:, -1:] - path[:, -2:-1]], dim=1)
    ahead = functional.normalize(step, dim=2)
    # A reference direction that no path runs along, so that the cross product is never 0.
    reference = torch.tensor([0.05, 0.1, 1.0]).expand_as(ahead)
    side = functional.normalize(torch.linalg.cross(ahead, reference), dim=2)
    front = torch.linalg.cross(side, ahead)
    side, front = side * width[..., None], front * depth[..., None]
    if closed:
        path = torch.cat([path[:, :1], path, path[:, -1:]], dim=1)
        side, front = (functional.pad(each, (0, 0, 1, 1)) for each in (side, front))
    return loft(path, side, front, square=square)


def rod(
    a: Sequence[Profile], b: Sequence[Profile], r: Profile, *, n: int, square: Profile = 0.0, end: float = 1.0
) -> Tensor:
    """A straight closed pipe from point a to point b; its end is `end` times as thick."""
    ends = [torch.cat(_profiles(n, *point), dim=1) for point in (a, b)]
    thick = _profiles(n, r)[0]
    return pipe(torch.stack(ends, dim=1), torch.cat([thick, thick * end], dim=1), square=square)


def both_sides(part: Tensor) -> list[Tensor]:
    """The part, and its mirror image on the other side of x = 0."""
    return [part, part * torch.tensor([-1.0, 1.0, 1.0])]


def where(part: Tensor, there: Tensor) -> Tensor:
    """Keep the part where `there` (n,1) is 1; in the other shapes it shrinks to a point, which has no area."""
    return part * there[..., None, None]


def pleats(n: int, length: int, count: Tensor, depth: Tensor, phase: Tensor) -> Tensor:
    """Factors (n,length,SEGMENTS+1) on the rings' size: folds that deepen from the first ring to the last."""
    turn = torch.linspace(0, 2 * math.pi, SEGMENTS + 1)
    deepen = torch.linspace(0, 1, length)[None, :, None]
    return 1 + depth[..., None] * deepen * torch.cos(count.round()[..., None] * turn + phase[..., None])


def _profiles(n: int, *values: Profile, length: int | None = None) -> list[Tensor]:
    """Expand each value to (n,L), L the longest among them."""
    tensors = [torch.as_tensor(value, dtype=torch.float32) for value in values]
    tensors = [each if each.dim() == 2 else each.reshape(1, -1) for each in tensors]
    longest = length or max(each.shape[1] for each in tensors)
    return [each.expand(n, longest) for each in tensors]
