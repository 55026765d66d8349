"""A walk with a depth camera through a simulated flat: through every room, twice around in each, and back to the start.

Depth has the faults of a phone's sensor (`scenes.Sensor`), pictures have the flat's paint, and the poses those of a
device's tracking. The folders are what Open3D writes: depth and colour images, a log of poses, a camera.json.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import trimesh

from capture2vr.edge.arrays import Bytes, Floats, Ints
from capture2vr.edge.capture.nouns import Frame, Intrinsics
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.render.rays import RaycastingScene
from tests.support.flats import ROOM, WALL_M, Flat, Patch, flat, paint
from tests.support.scenes import KINECT, Sensor, look_at, spoil_depth, spoil_pose

SENSOR = Sensor(noise_m=0.0025, jitter_m=0.002, jitter_deg=0.1, flying=0.3)
"""A phone's depth camera, whose noise is 1 cm at 2 m, and its tracking."""
_EYE_M = 1.45
_BEHIND_M = 0.4  # from the middle of a room to the person, who looks across it
_TURNS = 2  # around each room: looking down, and then up
_AHEAD, _DOWN, _UP = (
    -0.5,
    -0.85,
    0.35,
)  # slopes of looks: a floor or a ceiling is in view, a bare wall alone tells nothing
_SHARES = (0.0, 0.1, 0.4, 0.55, 0.62, 0.93, 1.0)  # of the turns, at which the slopes are
_SLOPES = (_AHEAD, _DOWN, _DOWN, _AHEAD, _UP, _UP, _AHEAD)
_THROUGH = 0.2  # share of the frames on the way from one room to the next
_WALLS = (2, 3, 4)  # paints
_PICTURE_M, _MOSAIC_M, _HUNG = 0.5, 0.06, 0.35  # pictures on the walls: their side, that of their stones, their share
_PRIMES = np.array([73_856_093, 19_349_663, 83_492_791])  # of a spatial hash (M. Teschner et al., 2003)
_STEPS_PER_M = 1000.0
_JPEG_QUALITY = 92


@dataclass(frozen=True, slots=True)
class FlatWalk:
    """A flat with a camera's way through it: poses (N,4,4) camera-to-world, OpenCV axes, metres, Y up."""

    truth: Flat
    poses: Floats
    camera: Intrinsics = KINECT
    sensor: Sensor = SENSOR

    def frames(self, seed: int = 0) -> Iterator[Frame]:
        """Render the frames one by one; the poses are as measured, with the jitter of tracking."""
        scene, numbers = _scene(self.truth)
        rng = np.random.default_rng(seed)
        for number, pose in enumerate(self.poses):
            depth_m, rgb = _render(scene, numbers, pose, self.camera)
            noisy = spoil_depth(depth_m, self.sensor, rng)
            measured = spoil_pose(pose, self.sensor, rng)
            yield Frame(f"{number:04d}", self.camera, measured, noisy.copy, None, rgb.copy)

    def write(self, folder: Path, *, posed: bool = True) -> Path:
        """Write the walk as a folder that `read_capture` reads; without the log of poses where not `posed`."""
        for room in ("depth", "color"):
            (folder / room).mkdir(parents=True, exist_ok=True)
        log = []
        for number, frame in enumerate(self.frames()):
            assert frame.load_rgb is not None
            steps = np.rint(frame.load_depth_m() * _STEPS_PER_M).astype(np.uint16)
            cv2.imwrite(str(folder / "depth" / f"{number:05d}.png"), steps, [cv2.IMWRITE_PNG_COMPRESSION, 1])
            bgr = cv2.cvtColor(frame.load_rgb(), cv2.COLOR_RGB2BGR)
            cv2.imwrite(str(folder / "color" / f"{number:05d}.jpg"), bgr, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
            rows = "\n".join(" ".join(f"{value:.9f}" for value in row) for row in np.asarray(frame.camera_to_world))
            log.append(f"{number} {number} {number + 1}\n{rows}\n")
        c = self.camera
        matrix = [c.fx, 0, 0, 0, c.fy, 0, c.cx, c.cy, 1]
        camera = {"width": c.width, "height": c.height, "intrinsic_matrix": matrix, "depth_scale": _STEPS_PER_M}
        (folder / "camera.json").write_text(json.dumps(camera))
        if posed:
            (folder / "trajectory.log").write_text("".join(log))
        return folder


def flat_walk(rooms: int, frames: int, camera: Intrinsics = KINECT, sensor: Sensor = SENSOR) -> FlatWalk:
    """A walk of so many frames through all rooms of a flat; it ends where it began."""
    way = _rooms_in_turn(round(rooms**0.5))
    each = np.array_split(np.arange(frames), len(way))
    poses: list[Floats] = []
    for number, share in enumerate(each):
        here, there = way[number], way[(number + 1) % len(way)]
        came = np.subtract(here, way[number - 1]) if len(way) > 1 else np.array([1, 0])
        poses += _through_room(here, came, np.subtract(there, here), len(share))
    return FlatWalk(flat(rooms), np.stack(poses), camera, sensor)


def _rooms_in_turn(side: int) -> list[tuple[int, int]]:
    """The rooms of a square, each beside the one before it; a round where the side is even, else there and back."""
    if side == 1:
        return [(0, 0)]
    if side % 2:
        snake = [(x, z if x % 2 == 0 else side - 1 - z) for x in range(side) for z in range(side)]
        return snake + snake[-2:0:-1]
    ahead = [(x, z if x % 2 == 0 else side - z) for x in range(side) for z in range(1, side)]
    return [(0, 0), *ahead, *((x, 0) for x in range(side - 1, 0, -1))]


def _through_room(room: tuple[int, int], came: Floats, goes: Floats, frames: int) -> list[Floats]:
    """Poses of turning around in a room, from the direction (x, z) that one came in, and of going on to the next."""
    step = ROOM + WALL_M
    middle = np.array([room[0] * step[0] + ROOM[0] / 2, _EYE_M, room[1] * step[2] + ROOM[2] / 2])
    first, last = np.arctan2(came[1], came[0]), np.arctan2(goes[1], goes[0])
    last += 2 * np.pi * _TURNS + (2 * np.pi if last < first else 0)
    around = frames - round(_THROUGH * frames) if goes.any() else frames
    poses = []
    for share in np.arange(around) / max(around, 1):
        angle = first + (last - first) * share
        poses.append(_look(middle, angle, float(np.interp(share, _SHARES, _SLOPES)), 0.0))
    length = float(np.abs(goes * step[[0, 2]]).sum())
    for share in np.arange(frames - around) / max(frames - around, 1):
        poses.append(_look(middle, last, _AHEAD, share * length))
    return poses


def _look(middle: Floats, angle: float, slope: float, ahead_m: float) -> Floats:
    """The pose of one who looks across a room, or has gone on from there."""
    ahead = np.array([np.cos(angle), 0.0, np.sin(angle)])
    eye = middle + (ahead_m - _BEHIND_M) * ahead
    return look_at(eye.tolist(), (eye + ahead + [0, slope, 0]).tolist(), (0, 1, 0))


def mesh_of(truth: Flat) -> tuple[Mesh, Ints]:
    """The surfaces of a flat as triangles, and the paint (F,) of each."""
    vertices, faces, numbers, first = [], [], [], 0
    for patch in truth.patches:
        corners, triangles = _triangles(patch)
        vertices.append(corners)
        faces.append(triangles + first)
        numbers.append(np.full(len(triangles), patch.paint))
        first += len(corners)
    return Mesh(np.concatenate(vertices), np.concatenate(faces)), np.concatenate(numbers)


def _triangles(patch: Patch) -> tuple[Floats, Ints]:
    if patch.radius:
        ball = trimesh.creation.icosphere(subdivisions=4, radius=patch.radius)
        return np.asarray(ball.vertices) + patch.corner, np.asarray(ball.faces)
    low, u, v = patch.corner, patch.u, patch.v
    return np.stack([low, low + u, low + u + v, low + v]), np.array([[0, 1, 2], [0, 2, 3]])


def _scene(truth: Flat) -> tuple[RaycastingScene, Ints]:
    mesh, numbers = mesh_of(truth)
    return RaycastingScene(mesh), numbers


def _render(scene: RaycastingScene, numbers: Ints, pose: Floats, camera: Intrinsics) -> tuple[Floats, Bytes]:
    """Depth (H,W) in metres and colours (H,W,3) as seen from a pose."""
    v, u = np.mgrid[: camera.height, : camera.width].astype(np.float32)
    local = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones_like(u)], axis=-1)
    rays = local.reshape(-1, 3) @ pose[:3, :3].T.astype(np.float32)
    hits = scene.cast(pose[None, :3, 3].astype(np.float32), rays)
    depth_m = np.where(hits.face >= 0, hits.along, 0).astype(np.float32)
    places = pose[:3, 3] + depth_m[:, None] * rays
    rgb = np.zeros((len(rays), 3), np.uint8)
    seen = np.where(hits.face >= 0, numbers[hits.face], -1)
    for number in np.unique(seen[seen >= 0]):
        own = np.flatnonzero(seen == number)
        rgb[own] = paint(int(number), places[own])
        if number in _WALLS:
            _hang_pictures(rgb, own, places[own])
    shape = (camera.height, camera.width)
    return depth_m.reshape(shape), rgb.reshape(*shape, 3)


def _hang_pictures(rgb: Bytes, own: Ints, places: Floats) -> None:
    """Paint mosaics on walls here and there, each unlike all others: what a tracked camera holds on to."""
    hung = _hash(places, _PICTURE_M) % 1000 < 1000 * _HUNG
    stones = _hash(places[hung], _MOSAIC_M)
    rgb[own[hung]] = np.stack([40 + stones // shift % 180 for shift in (1, 180, 32_400)], axis=1).astype(np.uint8)


def _hash(places: Floats, side: float) -> Ints:
    """A number (N,) of the cube of that side that a place (N,3) lies in; walls do not lie between two."""
    cells = np.floor(places / side + 0.123).astype(np.int64)
    mixed: Ints = np.bitwise_xor.reduce(cells * _PRIMES, axis=1) * 2_654_435_761 % (1 << 31) // 7
    return mixed
