"""Generate household things and fruit: y up. Each returns the parts of n shapes."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from tests.bench.single_photo_training.lofts import Dice, both_sides, box, loft, pipe, pleats, rod, spindle, where


def mug(d: Dice) -> list[Tensor]:
    height, r, flare = d(0.7, 1.3), d(0.35, 0.5), d(0.75, 1.1)
    t = torch.tensor([0.0, 0.0, 0.3, 0.7, 1.0, 1.0, 0.6, 0.12])
    wide = torch.cat(
        [0 * r, r * flare, r * (0.6 * flare + 0.4), r, r * 1.0, r * 0.92, r * 0.92, r * flare * 0.85], dim=1
    )
    parts = [spindle("y", height * t, wide, wide, n=d.n, square=d.often(0.1))]
    turn = torch.linspace(-math.pi / 2, math.pi / 2, 8)
    out, tall, middle = d(0.2, 0.4), height * d(0.2, 0.36), height * d(0.45, 0.6)
    path = torch.stack([r * 0.9 + out * turn.cos(), middle + tall * turn.sin(), torch.zeros(d.n, 8)], dim=-1)
    return [*parts, where(pipe(path, d(0.03, 0.07)), d.often(0.85))]


def bottle(d: Dice) -> list[Tensor]:
    r, neck, shoulder, bend = d(0.12, 0.3), d(0.04, 0.09), d(0.45, 0.8), d(0.05, 0.3)
    y = torch.cat(
        [
            0 * r,
            0 * r,
            0.04 + 0 * r,
            shoulder * 0.5,
            shoulder,
            shoulder + bend * 0.5,
            shoulder + bend,
            shoulder * 0 + 1.12,
            shoulder * 0 + 1.12,
        ],
        1,
    )
    wide = torch.cat([0 * r, r * 0.92, r, r * d(0.8, 1.05), r, (r + neck) * d(0.4, 0.6), neck, neck, neck * 0], dim=1)
    return [spindle("y", y, wide, wide * d(0.6, 1).clamp(max=1), n=d.n, square=d.often(0.2) * 0.8)]


def bowl(d: Dice) -> list[Tensor]:
    """A bowl, plate or cup, open above."""
    t = torch.linspace(0, 1, 8)
    deep, foot, bend = d(0.08, 0.6), d(0.2, 0.5), d(0.3, 1)
    wide = 0.5 * (foot + (1 - foot) * t**bend)
    wide = torch.cat([0 * foot, wide], dim=1)
    y = deep * torch.cat([torch.zeros(1), t])
    folds = pleats(d.n, 9, d(3, 9), d.often(0.3) * d(0, 0.1), d(0, 6.28))
    return [spindle("y", y, wide, wide * d(0.8, 1), n=d.n, folds=folds, square=d.often(0.15) * 0.8)]


def banana(d: Dice) -> list[Tensor]:
    """Bent fruit, or two or three of them side by side; they lie, or stand on their back."""
    bend, r, lie = d(0.5, 1.9), d(0.06, 0.13), d.often(0.7) * math.pi / 2 + d(-0.3, 0.3)
    t = torch.linspace(-0.5, 0.5, 9)
    turn = bend * t
    x, y = turn.sin() / bend, (1 - turn.cos()) / bend
    thick = r * torch.tensor([0.3, 0.55, 0.85, 1.0, 1.0, 1.0, 0.85, 0.5, 0.15])
    parts = []
    several = torch.ones(d.n, 1)
    for number in range(3):
        fan = (number - 1 + d(-0.2, 0.2)) * 0.35 * (number > 0)
        side = number * r * 1.5 - x * fan
        path = torch.stack([x, y * lie.cos() - side * lie.sin(), y * lie.sin() + side * lie.cos()], dim=-1)
        parts.append(where(pipe(path, thick, square=0.15), several))
        several = several * d.often(0.4)
    return parts


def apple(d: Dice) -> list[Tensor]:
    """Round fruit: apples, oranges, pears, lemons, melons."""
    turn = torch.linspace(-math.pi / 2, math.pi / 2, 11)
    dip, tall, pear = d(0.0, 0.25), d(0.75, 1.3), d.often(0.25) * d(0.2, 0.5)
    wide = turn.cos().clamp(min=0) * (1 - pear * (turn.sin() * 0.5 + 0.5))
    y = tall * (turn.sin() - dip * turn.sin() ** 9)
    parts = [spindle("y", y, wide, wide * d(0.9, 1), n=d.n)]
    stem = rod((0.0, tall * 0.8, 0.0), (d(-0.2, 0.2), tall * (1 + d(0.0, 0.25)), d(-0.1, 0.1)), d(0.02, 0.05), n=d.n)
    return [*parts, where(stem, d.often(0.6))]


def shoe(d: Dice) -> list[Tensor]:
    """A sole, an upper open at the ankle; low, or a boot."""
    length, width, toe, ankle = d(0.9, 1.1), d(0.15, 0.22), d(0.14, 0.25), d(0.22, 0.8)
    z = length * torch.tensor([-0.5, -0.5, -0.4, -0.1, 0.2, 0.4, 0.48, 0.5])
    wide = width * torch.tensor([0.0, 0.6, 0.8, 0.75, 1.0, 0.85, 0.5, 0.0])
    tall = torch.cat([0 * toe, toe, toe * 1.2, toe * 1.3, toe, toe * 0.7, toe * 0.4, 0 * toe], dim=1) / 2
    heel = d.often(0.25) * d(0.05, 0.35) * (0.3 - z / length).clamp(min=0)
    parts = [spindle("z", z, wide, tall, at=(0.0, tall + heel), n=d.n, square=d(0.2, 0.7))]
    lift = torch.tensor([0.3, 0.6, 1.0])
    mouth = width * torch.tensor([0.85, 0.75, 0.7]) * d(0.9, 1.1)
    parts.append(
        spindle(
            "y",
            toe * 0.4 + ankle * lift,
            mouth,
            length * torch.tensor([0.3, 0.2, 0.16]),
            at=(0.0, -length * torch.tensor([0.2, 0.27, 0.3])),
            n=d.n,
        )
    )
    parts.append(box(d.n, (0.0, 0.0, 0.02), (width * 1.9, d(0.03, 0.1), length * 1.02), square=0.4))
    return parts


def leaf(d: Dice) -> list[Tensor]:
    """A curled, bent sheet with a stalk."""
    t = torch.linspace(0, 1, 9)
    wide = d(0.15, 0.4) * (t * math.pi).sin().clamp(min=0) ** d(0.5, 1.2)
    droop, rise = d(-0.5, 0.7), d(-0.2, 1.2)
    y, z = t * rise.sin() - droop * t * t, t * rise.cos()
    centre = torch.stack([d(-0.2, 0.2) * t * t, y, z], dim=-1)
    side = torch.stack([wide, 0 * wide, 0 * wide], dim=-1)
    front = torch.stack([0 * wide, wide * d(-0.6, 0.6), 0 * wide], dim=-1)
    stalk = pipe(
        torch.stack(
            [torch.zeros(d.n, 2), torch.cat([d(-0.1, 0.1), 0 * rise], 1), torch.cat([d(-0.4, -0.1), 0 * rise], 1)],
            dim=-1,
        ),
        0.012,
    )
    return [loft(centre, side, front, arc=(0.0, 0.5)), stalk]


def vase(d: Dice) -> list[Tensor]:
    """A vase or any other body of revolution, open above; some have two handles."""
    n, t = d.n, torch.linspace(0, 1, 9)
    wide = d(0.2, 0.4) * (1 + d(-0.5, 0.6) * (t * d(2, 7) + d(0, 6.28)).sin())
    wide = torch.cat([torch.zeros(n, 1), wide], dim=1)
    body = spindle("y", d(0.6, 1.2) * torch.cat([torch.zeros(1), t]), wide, wide, n=n)
    turn = torch.linspace(-math.pi / 2, math.pi / 2, 8)
    path = torch.stack([0.2 + d(0.1, 0.3) * turn.cos(), 0.5 + d(0.1, 0.25) * turn.sin(), torch.zeros(n, 8)], dim=-1)
    handled = d.often(0.3)
    return [body, *(where(each, handled) for each in both_sides(pipe(path, d(0.02, 0.04))))]
