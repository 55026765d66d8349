"""A simulated flat: rooms with doors, furniture and painted walls, as points with colours, and as the true surface.

Every room is 2.6 x 2.8 m and 2.4 m high and has about 42 square metres of surface, so a flat of n rooms has n times as
many. All surfaces are rectangles or spheres that are known exactly; points are drawn part by part, never all at once.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from capture2vr.edge.arrays import Bytes, Floats
from capture2vr.edge.capture.nouns import Cloud

ROOM = np.array([2.6, 2.4, 2.8])
"""Metres of a room: width, height, depth, with Y up."""
_DOOR_M, _DOOR_HIGH_M, WALL_M = 0.8, 2.0, 0.1
_NOISE_M = 0.002  # of a laser scanner, along each axis


@dataclass(frozen=True, slots=True)
class Patch:
    """A rectangle corner + s·u + t·v with s, t in [0,1], or a sphere around `corner`; paint: number of its colours."""

    corner: Floats
    u: Floats
    v: Floats
    paint: int
    radius: float = 0.0

    @property
    def area(self) -> float:
        """Square metres."""
        if self.radius:
            return float(4 * np.pi * self.radius**2)
        return float(np.linalg.norm(np.cross(self.u, self.v)))

    def sample(self, count: int, rng: np.random.Generator) -> tuple[Floats, Bytes]:
        """Uniformly random points (N,3) and their colours (N,3)."""
        s, t = rng.random(count), rng.random(count)
        if self.radius:
            outward = rng.normal(size=(count, 3))
            xyz = self.corner + self.radius * outward / np.linalg.norm(outward, axis=1, keepdims=True)
        else:
            xyz = self.corner + s[:, None] * self.u + t[:, None] * self.v
        return xyz, paint(self.paint, xyz)


@dataclass(frozen=True, slots=True)
class Flat:
    """The surfaces of a flat of `rooms` rooms in a square, metres, Y up."""

    patches: tuple[Patch, ...]

    @property
    def area(self) -> float:
        """Square metres of all surfaces."""
        return sum(patch.area for patch in self.patches)

    def parts(self, count: int, *, seed: int = 0, noise_m: float = _NOISE_M, most: int = 500_000) -> Iterator[Cloud]:
        """Draw about `count` points, evenly spread, in parts of at most `most`: the same whenever asked."""
        rng = np.random.default_rng(seed)
        waiting: list[tuple[Floats, Bytes]] = []
        for patch in self.patches:
            left = round(count * patch.area / self.area)
            while left:
                drawn = min(left, most)
                xyz, rgb = patch.sample(drawn, rng)
                waiting.append((xyz + rng.normal(0, noise_m, xyz.shape), rgb))
                left -= drawn
                if sum(len(xyz) for xyz, _ in waiting) >= most:
                    yield _cloud(waiting)
                    waiting.clear()
        if waiting:
            yield _cloud(waiting)

    def cloud(self, count: int, *, seed: int = 0, noise_m: float = _NOISE_M) -> Cloud:
        """All points of a small flat at once."""
        parts = list(self.parts(count, seed=seed, noise_m=noise_m))
        colours = [part.rgb for part in parts if part.rgb is not None]
        return Cloud(np.concatenate([part.xyz for part in parts]), np.concatenate(colours))

    def distance(self, xyz: Floats) -> Floats:
        """Distance (N,) of places (N,3) from the nearest surface."""
        nearest = np.full(len(xyz), np.inf)
        for patch in self.patches:
            low, high = _box(patch)
            near = np.flatnonzero(((xyz > low - 0.2) & (xyz < high + 0.2)).all(axis=1))
            nearest[near] = np.minimum(nearest[near], _distance(patch, xyz[near]))
        return np.asarray(np.minimum(nearest, 0.2))


def flat(rooms: int) -> Flat:
    """A flat of so many rooms, a square number of them."""
    side = round(rooms**0.5)
    if side * side != rooms:
        raise ValueError(f"a flat has a square number of rooms, not {rooms}")
    patches: list[Patch] = []
    for x in range(side):
        for z in range(side):
            patches += _room(x, z, side)
    return Flat(tuple(patches))


def _room(x: int, z: int, side: int) -> list[Patch]:
    """Surfaces of the room at a place of the square: shell with doors to the rooms beside it, and furniture."""
    step = ROOM + WALL_M
    at = np.array([x * step[0], 0.0, z * step[2]])
    width, height, depth = ROOM
    rng = np.random.default_rng(1000 * x + z)
    across, along_z, up = _vector(width, 0, 0), _vector(0, 0, depth), _vector(0, height, 0)
    patches = [Patch(at, across, along_z, 0), Patch(at + up, across, along_z, 1)]
    for axis, length, count in ((0, depth, x), (2, width, z)):
        along = np.array([0.0, 0, 1]) if axis == 0 else np.array([1.0, 0, 0])
        for far in (0, 1):
            corner = at.copy()
            corner[axis] += far * ROOM[axis]
            has_door = (count < side - 1) if far else (count > 0)
            patches += _wall(corner, along, length, height, has_door, paint=2 + (x + z + far + axis // 2) % 3)
            if has_door and far:
                outward = np.zeros(3)
                outward[axis] = WALL_M
                patches += _frame(corner, along, length, outward)
    return patches + _furniture(at, rng)


def _wall(corner: Floats, along: Floats, length: float, height: float, has_door: bool, paint: int) -> list[Patch]:
    up = np.array([0.0, 1, 0])
    if not has_door:
        return [Patch(corner, length * along, height * up, paint)]
    left = (length - _DOOR_M) / 2
    return [
        Patch(corner, left * along, height * up, paint),
        Patch(corner + (left + _DOOR_M) * along, left * along, height * up, paint),
        Patch(corner + left * along + _DOOR_HIGH_M * up, _DOOR_M * along, (height - _DOOR_HIGH_M) * up, paint),
    ]


def _frame(corner: Floats, along: Floats, length: float, outward: Floats) -> list[Patch]:
    """Sides, top and threshold of a door through a wall."""
    up = np.array([0.0, 1, 0])
    left = corner + (length - _DOOR_M) / 2 * along
    return [
        Patch(left, outward, _DOOR_HIGH_M * up, 5),
        Patch(left + _DOOR_M * along, outward, _DOOR_HIGH_M * up, 5),
        Patch(left + _DOOR_HIGH_M * up, outward, _DOOR_M * along, 5),
        Patch(left, outward, _DOOR_M * along, 0),
    ]


def _furniture(at: Floats, rng: np.random.Generator) -> list[Patch]:
    """A table with four legs and a bowl on it, a wardrobe, a sofa and a ball lamp, away from the doors."""
    turn = rng.random() < 0.5
    patches = _box_of(at + _vector(0.0, 0, 0.0), (0.55, 1.9, 0.7), 6, open_sides=(0, 2, 4))
    patches += _box_of(at + _vector(1.7, 0, 0.0), (0.9, 0.42, 0.75) if turn else (0.75, 0.42, 0.9), 7, open_sides=(4,))
    table = at + _vector(1.5, 0.7, 1.7)
    patches += _box_of(table, (0.9, 0.04, 0.7), 5)
    for dx, dz in ((0.05, 0.05), (0.79, 0.05), (0.05, 0.59), (0.79, 0.59)):
        patches += _box_of(table + _vector(dx, -0.7, dz), (0.06, 0.7, 0.06), 5, open_sides=(3, 2))
    patches.append(Patch(table + _vector(0.45, 0.14, 0.35), np.zeros(3), np.zeros(3), 8, radius=0.1))
    patches.append(Patch(at + _vector(1.3, 2.05, 1.4), np.zeros(3), np.zeros(3), 9, radius=0.15))
    return patches


def _box_of(low: Floats, size: tuple[float, float, float], paint: int, open_sides: tuple[int, ...] = ()) -> list[Patch]:
    """Sides of a box: 0, 1 at the least and greatest X, 2, 3 of Y, 4, 5 of Z; without those that touch something."""
    patches = []
    for number in range(6):
        if number not in open_sides:
            axis, far = divmod(number, 2)
            u, v = np.zeros(3), np.zeros(3)
            first, second = (each for each in range(3) if each != axis)
            u[first], v[second] = size[first], size[second]
            corner = np.asarray(low, np.float64).copy()
            corner[axis] += far * size[axis]
            patches.append(Patch(corner, u, v, paint))
    return patches


def _vector(x: float, y: float, z: float) -> Floats:
    return np.array([x, y, z], np.float64)


def paint(number: int, xyz: Floats) -> Bytes:
    """Colours (N,3) of places (N,3): planks, plaster, wallpapers with stripes and dots, wood, cloth, china, glass."""
    x, y, z = xyz.T
    base = np.array(
        [[150, 105, 70], [238, 236, 230], [205, 216, 222], [226, 214, 190], [190, 208, 186],
         [120, 78, 48], [232, 226, 214], [96, 112, 150], [206, 92, 70], [250, 240, 205]],
        np.float64,
    )[number]  # fmt: skip
    shade = np.zeros(len(xyz))
    if number == 0:
        shade = 14 * np.sin(23 * np.floor(x / 0.12)) - 22 * ((x % 0.12) < 0.006)
    elif number == 2:
        shade = 18.0 * ((x + z) % 0.2 < 0.1)
    elif number == 3:
        shade = -40.0 * (np.hypot((x + z) % 0.25 - 0.125, y % 0.25 - 0.125) < 0.05)
    elif number in (5, 6):
        shade = 12 * np.sin(60 * (y + 0.3 * np.sin(5 * (x + z))))
    elif number == 7:
        shade = 10.0 * (((x // 0.03) + (z // 0.03) + (y // 0.03)) % 2)
    colours: Bytes = np.clip(base + shade[:, None], 0, 255).astype(np.uint8)
    return colours


def _cloud(waiting: list[tuple[Floats, Bytes]]) -> Cloud:
    return Cloud(np.concatenate([xyz for xyz, _ in waiting]), np.concatenate([rgb for _, rgb in waiting]))


def _box(patch: Patch) -> tuple[Floats, Floats]:
    if patch.radius:
        return patch.corner - patch.radius, patch.corner + patch.radius
    ends = np.stack([patch.corner, patch.corner + patch.u, patch.corner + patch.v, patch.corner + patch.u + patch.v])
    return ends.min(axis=0), ends.max(axis=0)


def _distance(patch: Patch, xyz: Floats) -> Floats:
    relative = xyz - patch.corner
    if patch.radius:
        return np.asarray(np.abs(np.linalg.norm(relative, axis=1) - patch.radius))
    s, t = (np.clip(relative @ side / (side @ side), 0, 1) for side in (patch.u, patch.v))
    return np.asarray(np.linalg.norm(relative - s[:, None] * patch.u - t[:, None] * patch.v, axis=1))
