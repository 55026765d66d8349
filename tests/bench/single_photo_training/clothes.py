"""Generate clothes without a wearer: open surfaces, y up, front towards +z. Each returns the parts of n shapes."""

from __future__ import annotations

import torch
from torch import Tensor

from tests.bench.single_photo_training.lofts import Dice, both_sides, pipe, pleats, spindle, where


def skirt(d: Dice) -> list[Tensor]:
    waist, flare, bell = d(0.18, 0.4), d(1.1, 3.2), d(0.5, 1.6)
    t = torch.linspace(0, 1, 8)
    width = waist * (1 + (flare - 1) * t**bell)
    folds = pleats(d.n, 8, d(3, 12), d(0.0, 0.2), d(0, 6.28))
    return [spindle("y", -t, width, width * d(0.55, 1), at=(0.0, t * d(-0.1, 0.1)), n=d.n, folds=folds)]


def tshirt(d: Dice) -> list[Tensor]:
    shoulder = d(0.3, 0.42)
    return [*_bodice(d, shoulder, d(0.6, 1.0)), *_sleeves(d, shoulder)]


def dress(d: Dice) -> list[Tensor]:
    shoulder = d(0.17, 0.26)
    waist, hem, bell = shoulder * d(0.65, 1.0), d(0.2, 0.65), d(0.6, 1.8)
    t = torch.linspace(0, 1, 8)
    width = waist + (hem - waist).clamp(min=0) * t**bell
    folds = pleats(d.n, 8, d(3, 12), d(0.0, 0.2), d(0, 6.28))
    depth = d(0.5, 0.95)
    skirts = spindle("y", -0.42 - t * d(0.5, 1.1), width, width * depth, n=d.n, folds=folds)
    chest = [shoulder * d(0.45, 0.85), shoulder, shoulder * d(0.85, 1.1), waist]
    top = torch.cat(chest, dim=1)
    bodice = spindle("y", [0.0, -0.06, -0.2, -0.42], top, top * depth * 0.9, n=d.n)
    sleeved = d.often(0.5)
    return [skirts, bodice, *(where(part, sleeved) for part in _sleeves(d, shoulder))]


def trousers(d: Dice) -> list[Tensor]:
    hip, depth, leg = d(0.17, 0.25), d(0.55, 0.8), d(0.4, 1.0)
    pelvis = spindle("y", [0.0, -0.12, -0.28], torch.cat([hip * d(0.8, 0.95), hip, hip], dim=1), hip * depth, n=d.n)
    t = torch.linspace(0, 1, 6)
    apart = hip * 0.5 + t * d(0.0, 0.12)
    width = hip * 0.5 * (1 + t * (d(0.45, 1.4) - 1))
    legs = spindle(
        "y", -0.26 - t * leg, width, width + (hip * depth - width) * (1 - t) ** 2, at=(apart, t * d(-0.05, 0.05)), n=d.n
    )
    return [pelvis, *both_sides(legs)]


def _bodice(d: Dice, shoulder: Tensor, length: Tensor) -> list[Tensor]:
    """Torso from the open hem to the open neck."""
    neck = shoulder * d(0.3, 0.5)
    width = torch.cat([shoulder * d(0.7, 1.1), shoulder * d(0.7, 1.0), shoulder * 0.92, shoulder * 0.95, neck], dim=1)
    height = torch.cat([-length, -length * 0.55, -length * 0.3, 0 * length - 0.05, 0 * length + 0.03], dim=1)
    thick = shoulder * d(0.2, 0.6) * torch.tensor([1.0, 1.0, 1.0, 0.8, 0.5])
    return [spindle("y", height, width, thick, n=d.n)]


def _sleeves(d: Dice, shoulder: Tensor) -> list[Tensor]:
    """Both sleeves, from the shoulder outward and down at any angle, open at the wrist."""
    droop, length = d(0.1, 1.4), d(0.15, 0.75)
    t = torch.linspace(0, 1, 5)
    path = torch.stack(
        [shoulder * 0.88 + length * droop.cos() * t, -0.1 - length * droop.sin() * t, d(-0.2, 0.3) * length * t * t],
        dim=-1,
    )
    radius = d(0.06, 0.12) * (1 - t * d(-0.2, 0.45))
    return both_sides(pipe(path, radius, closed=False))
