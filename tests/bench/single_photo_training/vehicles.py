"""Generate vehicles: y up, nose towards +z. Each returns the parts of n shapes."""

from __future__ import annotations

import torch
from torch import Tensor

from tests.bench.single_photo_training.lofts import Dice, both_sides, box, pipe, rod, spindle, where


def car(d: Dice) -> list[Tensor]:
    """Wheels, a body, and a cabin: in the middle, along a whole bus or at a truck's front."""
    length, width, low, body = d(0.8, 1.1), d(0.17, 0.23), d(0.06, 0.12), d(0.1, 0.2)
    nose, tail = d(0.6, 1), d(0.7, 1)
    z = length / 2 * torch.tensor([-1.0, -1.0, -0.85, 0.4, 0.9, 1.0, 1.0])
    tall = torch.cat([0 * tail, tail * 0.9, tail, 1 + 0 * tail, nose, nose * 0.8, 0 * nose], dim=1) * body / 2
    wide = width * torch.tensor([0.0, 0.9, 1.0, 1.0, 0.97, 0.85, 0.0])
    parts = [spindle("z", z, wide, tall, at=(0.0, low + body / 2), n=d.n, square=d(0.6, 0.95))]
    front, back, high = length * d(0.0, 0.3), -length * d(0.15, 0.48), d(0.1, 0.3)
    middle, half = (front + back) / 2, (front - back) / 2
    slope = d(0.6, 1)
    foot = torch.cat([half, half * (1 + slope) / 2, half * slope, 0 * half], dim=1)
    side = width * torch.tensor([0.95, 0.92, 0.8, 0.0])
    roof = low + body * 0.9 + high * torch.tensor([0.0, 0.6, 1.0, 1.0])
    parts.append(spindle("y", roof, side, foot, at=(0.0, middle), n=d.n, square=d(0.6, 1)))
    cargo = box(d.n, (0.0, low + body + 0.12, -length * 0.12), (width * 2, d(0.15, 0.35), length * 0.72))
    parts.append(where(cargo, d.often(0.2)))
    wheel = d(0.07, 0.11)
    for z_wheel in (length * d(0.26, 0.36), -length * d(0.26, 0.36)):
        parts += both_sides(rod((width * 0.75, wheel, z_wheel), (width * 1.04, wheel, z_wheel), wheel, n=d.n))
    return parts


def plane(d: Dice) -> list[Tensor]:
    length, r, span, sweep = d(0.45, 0.55), d(0.035, 0.075), d(0.3, 0.6), d(-0.05, 0.35)
    t = torch.tensor([-1.0, -0.7, -0.2, 0.5, 0.8, 0.95, 1.0])
    hull = r * torch.tensor([0.15, 0.6, 1.0, 1.0, 0.85, 0.5, 0.0])
    parts = [spindle("z", length * t, hull, hull, at=(0.0, r * 0.5 * torch.tensor([1.0, 0.6, 0, 0, 0, 0, 0])), n=d.n)]
    root, high = d(0.08, 0.16), r * d(-0.8, 0.9)
    parts += both_sides(_wing(d, 0.0, span, root, root * d(0.25, 0.9), d(-0.1, 0.15), sweep, high))
    tail = root * d(0.4, 0.65)
    parts += both_sides(
        _wing(d, -0.92, span * d(0.25, 0.45), tail, tail * 0.6, -length * 0.85, sweep * 0.4, r * d(0.3, 3))
    )
    fin = torch.stack(
        [
            torch.zeros(d.n, 2),
            torch.cat([r * 0.5, r + d(0.1, 0.2)], 1),
            -length * torch.cat([d(0.8, 0.88), d(0.92, 1.05)], 1),
        ],
        dim=-1,
    )
    parts.append(pipe(fin, 0.008, torch.cat([tail, tail * 0.5], 1)))
    out = span * d(0.25, 0.55)
    engine = d(0.02, 0.035)
    z = d(0.0, 0.1) - sweep * 0.4
    jets = rod((out, high - engine, z - 0.08), (out, high - engine, z + 0.06), engine, n=d.n)
    return parts + [where(each, d_jets) for d_jets in [d.often(0.6)] for each in both_sides(jets)]


def _wing(d: Dice, _: float, span: Tensor, root: Tensor, tip: Tensor, z: Tensor, sweep: Tensor, y: Tensor) -> Tensor:
    """A wing, from the middle outward along +x; its tip lies `sweep` farther back."""
    t = torch.tensor([0.0, 1.0, 1.0])
    chord = torch.cat([root, tip, 0 * tip], dim=1)
    thick = 0.012 * torch.tensor([1.0, 0.5, 0.0])
    return spindle("x", span * t, chord, thick, at=(z - sweep * t, y + d(-0.02, 0.1) * t), n=d.n)


def vessel(d: Dice) -> list[Tensor]:
    """A hull with an open or covered deck; cabins, a funnel, a mast with a sail."""
    width, deep, flat = d(0.1, 0.22), d(0.08, 0.2), d(0.0, 0.7)
    z = torch.tensor([-0.5, -0.45, -0.2, 0.1, 0.35, 0.47, 0.5])
    stern = d(0.2, 0.95)
    beam = width * torch.cat(
        [stern * 0.8, stern, stern * 0 + 0.97, stern * 0 + 1, stern * 0 + 0.7, stern * 0 + 0.2, stern * 0], 1
    )
    keel = deep * torch.tensor([0.7, 0.9, 1.0, 1.0, 0.9, 0.5, 0.05])
    sheer = d(0.0, 0.12) * z.abs() ** 2 * 4
    parts = [spindle("z", z, beam, keel, at=(0.0, sheer), n=d.n, square=flat, arc=(0.5, 1.0))]
    covered = d.often(0.6)
    deck = spindle("z", z, beam, 0.002, at=(0.0, sheer - d(0.0, 0.03)), n=d.n)
    parts.append(where(deck, covered))
    for share in (0.7, 0.4):
        cabin = (width * d(0.7, 1.5), d(0.06, 0.2), d(0.1, 0.45))
        place = (0.0, cabin[1] / 2 + (0.12 if share < 0.5 else 0.0), d(-0.25, 0.12))
        parts.append(where(box(d.n, place, cabin, taper=d(0.75, 1)), covered * d.often(share)))
    funnel = rod((0.0, 0.05, -0.1), (0.0, d(0.25, 0.4), -0.13), d(0.02, 0.05), n=d.n)
    parts.append(where(funnel, covered * d.often(0.4)))
    mast, sailing = d(0.4, 1.0), d.often(0.4)
    parts.append(where(rod((0.0, 0.0, 0.05), (0.0, mast, 0.05), 0.008, n=d.n), sailing))
    sail = spindle(
        "y",
        mast * torch.tensor([0.12, 0.95]),
        0.03,
        torch.cat([d(0.12, 0.25), 0.02 + 0 * mast], 1),
        at=(0.0, torch.cat([d(-0.2, -0.1), 0.03 + 0 * mast], 1)),
        n=d.n,
        arc=(0.25, 0.75),
    )
    return [*parts, where(sail, sailing * d.often(0.8))]
