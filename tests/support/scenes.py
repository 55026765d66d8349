"""Synthetic RGB-D captures with known truth: triangles rendered by ray casting, with the faults of a phone's sensor."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import trimesh

from capture2vr.edge.arrays import Bytes, Floats, Ints
from capture2vr.edge.capture.nouns import Frame, Intrinsics

PHONE = Intrinsics(fx=212.0, fy=212.0, cx=127.5, cy=95.5, width=256, height=192)
"""The depth camera of a phone with LiDAR."""
KINECT = Intrinsics(fx=525.0, fy=525.0, cx=319.5, cy=239.5, width=640, height=480)


@dataclass(frozen=True)
class Scene:
    """World-frame triangles (metres, Z up): vertices (V,3), faces (F,3), face_rgb (F,3), face_part (F,) part number."""

    vertices: Floats
    faces: Ints
    face_rgb: Bytes
    face_part: Ints

    def part(self, number: int) -> trimesh.Trimesh:
        """One part as a trimesh, in the order of `scene(...)`'s arguments."""
        return trimesh.Trimesh(self.vertices, self.faces[self.face_part == number], process=False)


@dataclass(frozen=True)
class Sensor:
    """Faults: depth noise (1σ, metres at 1 m, growing with z²), pose jitter (1σ metres and degrees), and the share of
    silhouette pixels that report a depth between the two surfaces."""

    noise_m: float = 0.0
    jitter_m: float = 0.0
    jitter_deg: float = 0.0
    flying: float = 0.0


def scene(*parts: tuple[trimesh.Trimesh, tuple[int, int, int]]) -> Scene:
    """Parts of one colour each."""
    joined = trimesh.util.concatenate([mesh for mesh, _ in parts])
    counts = [len(mesh.faces) for mesh, _ in parts]
    rgb = np.repeat(np.array([colour for _, colour in parts], np.uint8), counts, axis=0)
    return Scene(np.asarray(joined.vertices), np.asarray(joined.faces), rgb, np.repeat(np.arange(len(parts)), counts))


def plane(size_x: float, size_y: float, *, z: float = 0.0) -> trimesh.Trimesh:
    """A horizontal rectangle, of one pair of triangles."""
    x, y = size_x / 2, size_y / 2
    vertices = np.array([[-x, -y, z], [x, -y, z], [x, y, z], [-x, y, z]])
    return trimesh.Trimesh(vertices, [[0, 1, 2], [0, 2, 3]], process=False)


def table_with_sphere() -> Scene:
    """A sphere of radius 0.15 m on a table of 1.2 m whose top is z = 0: parts 0 (table) and 1 (sphere)."""
    ball = trimesh.creation.icosphere(subdivisions=5, radius=0.15)
    ball.apply_translation([0, 0, 0.15])
    return scene((plane(1.2, 1.2), (150, 120, 90)), (ball, (200, 40, 40)))


def furnished_room() -> Scene:
    """A room of 5 x 4 x 2.6 m, seen from within, with a sofa, a table and a cupboard, in patches of several shades."""
    shapes = [((0.0, 0.0, 0.0), (5.0, 4.0, 2.6))]
    shapes += [
        ((0.3, 0.3, 0.0), (2.0, 0.9, 0.8)),
        ((3.0, 2.5, 0.0), (1.6, 1.0, 0.74)),
        ((4.2, 0.0, 0.0), (0.8, 0.5, 2.0)),
    ]
    parts = []
    for corner, size in shapes:
        box = trimesh.creation.box(size)
        box.apply_translation(np.add(corner, np.divide(size, 2)))
        parts.append(box.subdivide_to_size(0.05))
    colours = [(190, 185, 170), (150, 70, 60), (120, 90, 50), (60, 110, 140)]
    bare = scene(*zip(parts, colours, strict=True))
    patch = np.floor(bare.vertices[bare.faces].mean(axis=1) / 0.23).astype(int)
    shade = np.random.default_rng(0).uniform(0.5, 1.25, (32, 32, 32))[tuple(patch.T % 32)]
    rgb = np.clip(bare.face_rgb * shade[:, None], 0, 255).astype(np.uint8)
    return Scene(bare.vertices, bare.faces, rgb, bare.face_part)


def look_around(count: int) -> Floats:
    """(count,4,4) poses of a person who turns once in the middle of the furnished room, and looks up and down."""
    turns = np.arange(count) * 2 * np.pi / count
    poses = []
    for number, turn in enumerate(turns):
        ahead = np.array([np.cos(turn), np.sin(turn), (-0.35, 0.0, 0.3)[number % 3]])
        eye = np.array([2.5, 1.9, 1.5]) - 0.5 * ahead * [1, 1, 0]
        poses.append(look_at(eye, eye + ahead))
    return np.stack(poses)


def look_at(eye: Sequence[float], target: Sequence[float], up: Sequence[float] = (0, 0, 1)) -> Floats:
    """(4,4) camera-to-world with OpenCV axes."""
    forward = np.subtract(target, eye)
    forward = forward / np.linalg.norm(forward)
    right = np.cross(forward, up)
    right = right / np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, np.cross(forward, right), forward], axis=1)
    pose[:3, 3] = eye
    return pose


def orbit(
    count: int, *, radius: float, height: float, target: Sequence[float] = (0, 0, 0.1), turn: float = 1.0
) -> Floats:
    """(count,4,4) poses on a circle (`turn` of it), looking at the target."""
    angles = np.arange(count) * 2 * np.pi * turn / count
    eyes = [(radius * np.cos(a), radius * np.sin(a), height) for a in angles]
    return np.stack([look_at(eye, target) for eye in eyes])


def film(
    world: Scene, poses: Floats, camera: Intrinsics = PHONE, sensor: Sensor = Sensor(), *, seed: int = 0
) -> tuple[Frame, ...]:
    """Render the scene from every pose; the frames' poses carry the jitter, the pictures are from the true ones."""
    rng = np.random.default_rng(seed)
    caster = _caster(world)
    frames = []
    for number, pose in enumerate(poses):
        depth_m, rgb = _render(world, caster, pose, camera)
        depth_m = spoil_depth(depth_m, sensor, rng)
        frames.append(_frame(f"{number:04d}", camera, spoil_pose(pose, sensor, rng), depth_m, rgb))
    return tuple(frames)


def _frame(name: str, camera: Intrinsics, pose: Floats, depth_m: Floats, rgb: Bytes) -> Frame:
    return Frame(name, camera, pose, load_depth_m=lambda: depth_m.copy(), load_rgb=lambda: rgb.copy())


def _caster(world: Scene) -> object:
    from embreex.mesh_construction import TriangleMesh
    from embreex.rtcore_scene import EmbreeScene

    caster = EmbreeScene()
    TriangleMesh(caster, world.vertices.astype(np.float32), world.faces.astype(np.int32))
    return caster


def _render(world: Scene, caster: object, pose: Floats, camera: Intrinsics) -> tuple[Floats, Bytes]:
    v, u = np.mgrid[: camera.height, : camera.width].astype(np.float64)
    local = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones_like(u)], axis=-1).reshape(
        -1, 3
    )
    rays = (local @ pose[:3, :3].T).astype(np.float32)
    eyes = np.broadcast_to(pose[:3, 3].astype(np.float32), rays.shape).copy()
    hit = caster.run(eyes, rays, output=True)  # type: ignore[attr-defined]
    face = hit["primID"]
    # The rays have depth 1, so the distance along them in their own length is the depth.
    depth_m = np.where(face >= 0, hit["tfar"], 0).astype(np.float32)
    rgb = np.where(face[:, None] >= 0, world.face_rgb[np.maximum(face, 0)], 0).astype(np.uint8)
    return depth_m.reshape(camera.height, camera.width), rgb.reshape(camera.height, camera.width, 3)


def spoil_depth(depth_m: Floats, sensor: Sensor, rng: np.random.Generator) -> Floats:
    noisy = depth_m + sensor.noise_m * depth_m**2 * rng.standard_normal(depth_m.shape)
    if sensor.flying:
        beside = np.roll(depth_m, 1, axis=1)
        silhouette = (np.abs(beside - depth_m) > 0.05 * depth_m) & (beside > 0) & (depth_m > 0)
        silhouette &= rng.random(depth_m.shape) < sensor.flying
        share = rng.random(depth_m.shape)
        noisy = np.where(silhouette, share * depth_m + (1 - share) * beside, noisy)
    return np.where(depth_m > 0, noisy, 0).astype(np.float32)


def spoil_pose(pose: Floats, sensor: Sensor, rng: np.random.Generator) -> Floats:
    from scipy.spatial.transform import Rotation

    turned = pose.copy()
    turn = Rotation.from_rotvec(np.radians(sensor.jitter_deg) * rng.standard_normal(3)).as_matrix()
    turned[:3, :3] = turn @ pose[:3, :3]
    turned[:3, 3] += sensor.jitter_m * rng.standard_normal(3)
    return turned
