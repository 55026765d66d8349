"""Simulated phone capture of a mesh: noisy depth images, photos and poses, written as a scanner app exports them.

Simulates the sensor errors that break reconstructions: noise that grows with distance and is correlated across pixels,
flying pixels between front and back at edges, holes where the surface is seen at a grazing angle, and poses with errors
of a few millimetres and tenths of a degree.
"""

from __future__ import annotations

import json
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from capture2vr.edge.arrays import Bytes, Floats
from capture2vr.edge.capture.nouns import Intrinsics
from capture2vr.edge.mesh.normals import face_normals, split_flips, vertex_normals
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.render.rays import Hits, RaycastingScene, open_sky, pinhole
from capture2vr.edge.srgb import to_linear, to_srgb
from capture2vr.process.archives import pack

DEPTH = Intrinsics(fx=212.0, fy=212.0, cx=127.5, cy=95.5, width=256, height=192)  # of a LiDAR phone: 62° × 49°
PHOTO = DEPTH.scaled_to(960, 720)

_AWAY = 1.6  # distance / the subject's height: it fills three quarters of the frame
_HEIGHTS = (0.55, 1.25)  # height / the subject's height: the camera rises from the waist to over the head and back
_NOISE = (0.002, 0.003)  # standard deviations / distance: of each pixel, and of patches of `_PATCH` pixels
_PATCH = 12  # pixels of depth: about the correlation that a phone's own smoothing leaves
_EDGE_M = 0.04  # a larger step in depth between neighbours means that a pixel sees two surfaces
_FLYING = 0.5  # fraction of the pixels at edges that report a depth in between
_GRAZING = 0.30  # cosine of the angle of incidence below which more and more pixels are lost
_RANGE_M = 5.0  # beyond it a LiDAR phone reports nothing
_JITTER_M, _JITTER_DEG = 0.003, 0.15  # standard deviations of a tracked pose
_JPEG_QUALITY = 88
_SKY_RAYS = 16  # per vertex and side, for ambient light as in a room
_ROOM = (206, 203, 198)  # sRGB of the background
_SUN = np.array([-0.45, 0.75, 0.48]) / np.linalg.norm([-0.45, 0.75, 0.48])
_THREADS = 2


def simulate_capture(mesh: Mesh, folder: Path, *, frames: int = 40, seed: int = 0) -> Path:
    """Simulate a phone's walk around the mesh (metres, Y up), write its capture in nerfstudio's layout; return its zip.

    folder/transforms.json  poses (camera-to-world, OpenGL axes, metres), intrinsics, the names of the frames' files
    folder/images/*.jpg     960 × 720 sRGB
    folder/depth/*.png      256 × 192 uint16 millimetres, 0 unknown
    The zip is next to the folder. The camera circles the part of the mesh above the floor.
    """
    for name in ("images", "depth"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    lit_scene = _LitScene.of(mesh)
    poses = _walk(lit_scene.subject, frames)
    seeds = np.random.SeedSequence(seed).spawn(frames + 1)

    def shoot(number: int) -> None:
        rng = np.random.default_rng(seeds[number])
        _write_photo(folder / _photo(number), _take_photo(lit_scene, poses[number], rng))
        _write_depth(folder / _depth(number), _measure_depth(lit_scene, poses[number], rng))

    with ThreadPoolExecutor(_THREADS) as pool:
        list(pool.map(shoot, range(frames)))
    reported = _add_pose_noise(poses, np.random.default_rng(seeds[frames]))
    (folder / "transforms.json").write_text(json.dumps(_transforms(reported), indent=1) + "\n")
    archive = folder.with_name(folder.name + ".zip")
    pack(folder, archive)
    return archive


@dataclass(frozen=True, slots=True)
class _LitScene:
    """The mesh with its lighting.

    flat     (F,3) unit normals of the faces
    light    (V,2,3) linear colour of the front and the back of each vertex
    subject  (2,3) corners of the bounding box that the camera circles
    """

    mesh: Mesh
    scene: RaycastingScene
    flat: Floats
    light: Floats
    subject: Floats

    @classmethod
    def of(cls, mesh: Mesh) -> _LitScene:
        mesh = split_flips(mesh)
        scene = RaycastingScene(mesh)
        flat = face_normals(mesh.vertices, mesh.faces)
        flat /= np.maximum(np.linalg.norm(flat, axis=1, keepdims=True), 1e-300)
        normals = vertex_normals(mesh).astype(np.float32)
        vertices = mesh.vertices.astype(np.float32)
        with ThreadPoolExecutor(_THREADS) as pool:
            sides = pool.map(lambda side: _light_of(scene, vertices, side * normals), (1.0, -1.0))
            both_sides = np.stack(list(sides), axis=1)
        colour = np.full((len(vertices), 3), 0.5, np.float32) if mesh.rgb is None else to_linear(mesh.rgb)
        light = (both_sides[:, :, None] * colour[:, None, :]).astype(np.float32)
        return cls(mesh, scene, flat.astype(np.float32), light, _subject(mesh.vertices))


def _subject(vertices: Floats) -> Floats:
    """(2,3) corners of the bounding box of the part above the floor; of the whole mesh where there is no floor."""
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    standing = vertices[vertices[:, 1] > low[1] + 0.01 * (high[1] - low[1])]
    return np.stack([standing.min(axis=0), standing.max(axis=0)])


def _light_of(scene: RaycastingScene, vertices: Floats, normals: Floats) -> Floats:
    """(V,) light on one side of the surface: a distant window, and ambient light of the room."""
    window = np.maximum(normals @ _SUN.astype(np.float32), 0.0)
    room = open_sky(scene, vertices, normals, rays=_SKY_RAYS) * (0.75 + 0.25 * normals[:, 1])
    light: Floats = 0.55 * window + 0.60 * room
    return light


def _walk(subject: Floats, frames: int) -> list[Floats]:
    """Camera-to-world poses (4,4), OpenCV axes: one circle around the subject, with varying height and distance."""
    middle, height = subject.mean(axis=0), float(np.ptp(subject, axis=0).max())
    poses = []
    for share in np.arange(frames) / frames:
        turn = 2 * np.pi * share
        rise = _HEIGHTS[0] + (_HEIGHTS[1] - _HEIGHTS[0]) * (0.5 - 0.5 * np.cos(3 * turn))
        distance = _AWAY * height * (1 + 0.05 * np.sin(5 * turn))
        eye = middle + distance * np.array([np.sin(turn), 0.0, np.cos(turn)])
        eye[1] = subject[0, 1] + rise * height
        poses.append(_look_at(eye, middle + 0.03 * height * np.array([np.sin(7 * turn), np.cos(4 * turn), 0.0])))
    return poses


def _look_at(eye: Floats, at: Floats) -> Floats:
    ahead = (at - eye) / np.linalg.norm(at - eye)
    right = np.cross(ahead, [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3] = np.stack([right, np.cross(ahead, right), ahead, eye], axis=1)
    return pose


def _cast_pixels(lit_scene: _LitScene, camera: Intrinsics, pose: Floats) -> tuple[Hits, Floats]:
    """Cast a ray through every pixel. Returns the hits and the rays (H·W,3), one metre deep: `Hits.along` is depth."""
    x = (np.arange(camera.width) - camera.cx) / camera.fx
    y = (np.arange(camera.height) - camera.cy) / camera.fy
    rays = pinhole(x, y, *pose[:3, :3].T)
    return lit_scene.scene.cast(pose[None, :3, 3], rays), rays


def _take_photo(lit_scene: _LitScene, pose: Floats, rng: np.random.Generator) -> Bytes:
    """Render a photo (720,960,3) uint8 sRGB, with the grain of a small sensor."""
    hits, rays = _cast_pixels(lit_scene, PHOTO, pose)
    light = np.empty((len(rays), 3), np.float32)
    light[:] = to_linear(np.array(_ROOM, dtype=np.uint8))
    hit = np.flatnonzero(hits.face >= 0)
    face, bary = hits.face.take(hit), hits.bary.take(hit, axis=0)
    behind = (np.einsum("nx,nx->n", lit_scene.flat.take(face, axis=0), rays.take(hit, axis=0)) > 0).astype(np.intp)
    corners, sides = lit_scene.mesh.faces.take(face, axis=0), lit_scene.light.reshape(-1, 3)
    light[hit] = sum(bary[:, c, None] * sides.take(2 * corners[:, c] + behind, axis=0) for c in range(3))
    grain = rng.integers(-5, 6, (PHOTO.height, PHOTO.width, 1), dtype=np.int16)
    photo = to_srgb(light).reshape(PHOTO.height, PHOTO.width, 3) + grain
    pixels: Bytes = np.clip(photo, 0, 255).astype(np.uint8)
    return pixels


def _measure_depth(lit_scene: _LitScene, pose: Floats, rng: np.random.Generator) -> Floats:
    """Render a depth image (192,256) in metres with the sensor's errors; 0 where it measures nothing."""
    shape = (DEPTH.height, DEPTH.width)
    hits, rays = _cast_pixels(lit_scene, DEPTH, pose)
    hit = hits.face >= 0
    depth_m = np.where(hit, hits.along, 0.0).reshape(shape)
    facing = np.abs(np.einsum("nx,nx->n", lit_scene.flat[hits.face], rays)) / np.linalg.norm(rays, axis=1)
    measured = hit & (facing > _GRAZING * rng.random(len(facing)))
    noisy_depth_m = _add_flying_pixels(depth_m, rng) * (1 + _relative_noise(shape, rng))
    return np.where(measured.reshape(shape) & (depth_m < _RANGE_M), noisy_depth_m, 0.0)


def _add_flying_pixels(depth_m: Floats, rng: np.random.Generator) -> Floats:
    """Add flying pixels: some pixels at edges get a depth between the two surfaces in their 3 × 3 neighbourhood."""
    from scipy.ndimage import maximum_filter, minimum_filter

    far = maximum_filter(depth_m, 3)
    near = minimum_filter(np.where(depth_m > 0, depth_m, _RANGE_M), 3)
    edge = (depth_m > 0) & (far - near > _EDGE_M) & (rng.random(depth_m.shape) < _FLYING)
    return np.where(edge, near + (far - near) * rng.random(depth_m.shape), depth_m)


def _relative_noise(shape: tuple[int, int], rng: np.random.Generator) -> Floats:
    """(H,W) errors as fractions of the distance: independent noise of each pixel, plus noise shared by neighbours."""
    from scipy.ndimage import zoom

    coarse = rng.normal(0, _NOISE[1], (shape[0] // _PATCH + 2, shape[1] // _PATCH + 2))
    common = zoom(coarse, _PATCH, order=1)[: shape[0], : shape[1]]
    noise: Floats = common + rng.normal(0, _NOISE[0], shape)
    return noise


def _add_pose_noise(poses: list[Floats], rng: np.random.Generator) -> list[Floats]:
    """Add a phone's tracking errors to the poses."""
    from scipy.spatial.transform import Rotation

    noisy = []
    for pose in poses:
        reported = pose.copy()
        turn = Rotation.from_rotvec(rng.normal(0, np.radians(_JITTER_DEG), 3)).as_matrix()
        reported[:3, :3] = turn @ pose[:3, :3]
        reported[:3, 3] += rng.normal(0, _JITTER_M, 3)
        noisy.append(reported)
    return noisy


def _transforms(poses: list[Floats]) -> dict[str, object]:
    """Content of nerfstudio's transforms.json.

    Its pixels have their corners at integers, hence + 0.5. OpenGL cameras look along −Z, Y up.
    """
    opengl = np.diag([1.0, -1.0, -1.0, 1.0])
    return {
        "camera_model": "OPENCV",
        "w": PHOTO.width,
        "h": PHOTO.height,
        "fl_x": PHOTO.fx,
        "fl_y": PHOTO.fy,
        "cx": PHOTO.cx + 0.5,
        "cy": PHOTO.cy + 0.5,
        "frames": [
            {
                "file_path": _photo(number),
                "depth_file_path": _depth(number),
                "transform_matrix": (pose @ opengl).tolist(),
            }
            for number, pose in enumerate(poses)
        ],
    }


def _photo(number: int) -> str:
    return f"images/{number:04d}.jpg"


def _depth(number: int) -> str:
    return f"depth/{number:04d}.png"


def _write_photo(path: Path, rgb: Bytes) -> None:
    from PIL import Image

    Image.fromarray(rgb).save(path, quality=_JPEG_QUALITY)


def _write_depth(path: Path, depth_m: Floats) -> None:
    from PIL import Image

    Image.fromarray(np.rint(depth_m * 1000).astype(np.uint16)).save(path)
