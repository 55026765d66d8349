"""Generate furniture on its feet: y up, front towards +z. Each returns the parts of n shapes."""

from __future__ import annotations

import torch
from torch import Tensor

from tests.bench.single_photo_training.lofts import Dice, both_sides, box, pipe, rod, spindle, where


def chair(d: Dice) -> list[Tensor]:
    width, depth, height, back, thick = d(0.35, 0.55), d(0.35, 0.55), d(0.35, 0.55), d(0.3, 0.7), d(0.02, 0.1)
    parts = [box(d.n, (0.0, height, 0.0), (width, thick, depth), square=d(0.3, 1))]
    parts += _feet(d, width, depth, height)
    lean, panel = d(0.0, 0.15), d.often(0.55)
    top = height + back
    post = rod(
        (width * 0.45, height, -depth * 0.45),
        (width * 0.45, top, -depth * 0.45 - lean),
        d(0.012, 0.03),
        n=d.n,
        square=d(0, 1),
    )
    parts += both_sides(where(post, 1 - panel))
    low = height + back * d(0.05, 0.5)
    slab = torch.stack(
        [torch.zeros(d.n, 2), torch.cat([low, top], 1), torch.cat([-depth * 0.46, -depth * 0.46 - lean], 1)], dim=-1
    )
    parts.append(pipe(slab, width * d(0.35, 0.5), d(0.01, 0.04), square=d(0.2, 1)))
    arm = box(d.n, (width * 0.5, height + d(0.15, 0.25), 0.0), (0.05, 0.03, depth * 0.9))
    prop = rod((width * 0.5, height, depth * 0.4), (width * 0.5, height + 0.2, depth * 0.4), 0.02, n=d.n)
    armed = d.often(0.3)
    return parts + [where(each, armed) for part in (arm, prop) for each in both_sides(part)]


def table(d: Dice) -> list[Tensor]:
    width, depth, height = d(0.5, 1.4), d(0.4, 0.8), d(0.3, 0.8)
    square = d.often(0.7) * d(0.7, 1)
    parts = [box(d.n, (0.0, height, 0.0), (width, d(0.02, 0.1), depth), square=square)]
    parts += _feet(d, width * (0.75 + 0.25 * square), depth * (0.75 + 0.25 * square), height)
    shelf = box(d.n, (0.0, height * d(0.2, 0.5), 0.0), (width * 0.85, 0.025, depth * 0.85), square=square)
    return [*parts, where(shelf, d.often(0.2))]


def sofa(d: Dice) -> list[Tensor]:
    width, depth, seat = d(0.7, 1.9), d(0.6, 0.9), d(0.25, 0.45)
    arm, back, soft, foot = d(0.08, 0.25), d(0.3, 0.6), d(0.6, 1), d(0.0, 0.15)
    parts = [box(d.n, (0.0, foot + (seat - foot) / 2, 0.0), (width, seat - foot, depth), square=soft)]
    thick = d(0.1, 0.25)
    parts.append(
        box(
            d.n,
            (0.0, seat + back / 2 - 0.05, -depth / 2 + thick / 2),
            (width, back + 0.1, thick),
            square=soft,
            taper=d(0.8, 1),
        )
    )
    rest = seat + back * d(0.2, 0.8)
    parts += both_sides(box(d.n, (width / 2, (foot + rest) / 2, 0.0), (arm, rest - foot, depth), square=soft))
    parts.append(
        where(box(d.n, (0.0, seat + 0.05, 0.05), (width * 0.9, 0.12, depth * 0.75), square=soft), d.often(0.6))
    )
    for end in (-0.45, 0.45):
        parts += both_sides(rod((width * 0.45, 0.0, depth * end), (width * 0.45, foot, depth * end), 0.025, n=d.n))
    return parts


def lamp(d: Dice) -> list[Tensor]:
    height, base, shade, tall = d(0.3, 1.4), d(0.08, 0.2), d(0.1, 0.3), d(0.12, 0.4)
    parts = [box(d.n, (0.0, 0.015, 0.0), (base * 2, d(0.02, 0.08), base * 2), square=d.often(0.3))]
    belly = d(0.01, 0.02) + d.often(0.5) * d(0.02, 0.12) * torch.tensor([0.6, 1.0, 0.7, 0.3, 0.1, 0.0])
    parts.append(spindle("y", height * torch.tensor([0.0, 0.15, 0.3, 0.5, 0.8, 1.0]), belly, belly, n=d.n))
    width = torch.cat([shade * d(0.3, 1), shade], dim=1)
    parts.append(
        spindle("y", torch.cat([height + tall * 0.5, height - tall * 0.5], 1), width, width, n=d.n, square=d.often(0.2))
    )
    return parts


def case(d: Dice) -> list[Tensor]:
    """A box: shut, or open with or without its lid."""
    width, height, depth, thick = d(0.3, 1), d(0.15, 0.8), d(0.3, 0.8), 0.01
    shut, square = d.often(0.5), d(0.8, 1)
    body = torch.tensor([0.0, 1.0, 1.0])
    parts = [
        spindle("y", height * torch.tensor([0.0, 0.0, 1.0]), width / 2 * body, depth / 2 * body, n=d.n, square=square)
    ]
    parts.append(where(box(d.n, (0.0, height, 0.0), (width * 1.02, thick, depth * 1.02), square=square), shut))
    tilt = d(0.2, 1.9)
    lid = torch.stack(
        [
            torch.zeros(d.n, 2),
            torch.cat([height, height + depth * tilt.sin()], 1),
            torch.cat([-depth / 2, -depth / 2 + depth * tilt.cos()], 1),
        ],
        dim=-1,
    )
    parts.append(where(pipe(lid, width / 2, 0.006, square=1.0), (1 - shut) * d.often(0.6)))
    return parts


def _feet(d: Dice, width: Tensor, depth: Tensor, height: Tensor) -> list[Tensor]:
    """Four legs, or one in the middle on a plate."""
    four, splay, thick, square = d.often(0.8), d(0.0, 0.08), d(0.012, 0.04), d(0, 1)
    parts = []
    for end in (-1, 1):
        foot = (width * 0.44 + splay, 0.0, end * (depth * 0.44 + splay))
        leg = rod(foot, (width * 0.44, height, end * depth * 0.44), thick, n=d.n, square=square)
        parts += both_sides(where(leg, four))
    post = rod((0.0, 0.0, 0.0), (0.0, height, 0.0), thick * 1.5, n=d.n)
    plate = box(d.n, (0.0, 0.015, 0.0), (width * 0.7, 0.03, depth * 0.7), square=d.often(0.4))
    return [*parts, where(post, 1 - four), where(plate, 1 - four)]
