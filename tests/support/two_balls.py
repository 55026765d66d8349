"""A capture of two balls on a table, a red one and a blue one, and a person's line around one of them in a picture."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import trimesh

from capture2vr.edge.arrays import Floats
from capture2vr.edge.capture.nouns import Frame
from tests.support.captures import save_jpg, save_png, steps
from tests.support.scenes import PHONE, Scene, film, orbit, plane, scene

RADIUS_M = 0.1
RED_AT, BLUE_AT = np.array([-0.2, 0.0, RADIUS_M]), np.array([0.2, 0.0, RADIUS_M])
POSES = orbit(12, radius=0.9, height=0.6)
_CORNERS = 24


def two_balls() -> Scene:
    """Parts 0 (table of 1.2 m, its top is z = 0), 1 (red) and 2 (blue)."""
    balls = []
    for centre in (RED_AT, BLUE_AT):
        ball = trimesh.creation.icosphere(subdivisions=4, radius=RADIUS_M)
        ball.apply_translation(centre)
        balls.append(ball)
    table, red, blue = plane(1.2, 1.2), *balls
    return scene((table, (150, 120, 90)), (red, (200, 40, 40)), (blue, (40, 60, 200)))


def film_two_balls() -> tuple[Frame, ...]:
    return film(two_balls(), POSES)


def line_around(centre: Floats, number: int, *, grown: float = 1.15) -> list[tuple[float, float]]:
    """A circle around a ball in the picture `number`, `grown` times as large as the ball, as shares of its sides."""
    pose = POSES[number]
    x, y, z = pose[:3, :3].T @ (centre - pose[:3, 3])
    radius = grown * PHONE.fx * RADIUS_M / np.sqrt(z * z - RADIUS_M**2)
    angles = 2 * np.pi * np.arange(_CORNERS) / _CORNERS
    column = PHONE.fx * x / z + PHONE.cx + radius * np.cos(angles)
    row = PHONE.fy * y / z + PHONE.cy + radius * np.sin(angles)
    shares = np.stack([(column + 0.5) / PHONE.width, (row + 0.5) / PHONE.height], axis=1)
    return [(round(float(u), 4), round(float(v), 4)) for u, v in np.clip(shares, 0, 1)]


def picture_name(number: int) -> str:
    """Name of a picture in the capture that `write_two_balls` writes."""
    return f"color/{number:05}.jpg"


def write_two_balls(folder: Path) -> Path:
    """Write the capture as Open3D does: depth PNGs, colour JPEGs, a trajectory and a camera."""
    lines = []
    for number, frame in enumerate(film_two_balls()):
        assert frame.load_rgb is not None
        save_png(folder / f"depth/{number:05}.png", steps(frame.load_depth_m()))
        save_jpg(folder / picture_name(number), frame.load_rgb())
        lines += [f"{number} {number} {number + 1}", *(" ".join(map(repr, row)) for row in POSES[number].tolist())]
    (folder / "trajectory.log").write_text("\n".join(lines) + "\n")
    k = [PHONE.fx, 0, 0, 0, PHONE.fy, 0, PHONE.cx, PHONE.cy, 1]
    camera = {"width": PHONE.width, "height": PHONE.height, "intrinsic_matrix": k}
    (folder / "camera.json").write_text(json.dumps(camera))
    return folder
