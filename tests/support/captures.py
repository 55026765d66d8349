"""Tiny captures in every format that is read, of one closed-form scene: a sphere seen from a ring of cameras.

The writers know the formats from their descriptions, not from the readers: a reader that mixes up axes, units or the
order of a matrix puts the sphere's points elsewhere.
"""

from __future__ import annotations

import io
import json
import struct
import zipfile
from collections.abc import Callable, Container
from pathlib import Path

import av
import cv2
import lzfse
import numpy as np
import trimesh

from capture2vr.edge.capture.nouns import Frame

CENTRE = np.array([0.4, -0.3, 1.2])  # metres, off the origin so that a mirrored world shows
RADIUS_M = 0.25
WIDTH, HEIGHT = 64, 48  # pixels of the depth images
FOCAL, CX, CY = 60.0, 30.5, 25.0  # off centre, so that a transposed matrix shows
COLOUR_SCALE = 4  # colour images are this much larger
FLIP = np.diag([1.0, -1.0, -1.0, 1.0])  # OpenCV camera axes <-> OpenGL camera axes


def poses(count: int = 4, up: str = "y") -> list[np.ndarray]:
    """(4,4) camera-to-world in OpenCV axes, on a ring a metre from the sphere and above it, looking at it, upright."""
    axis = {"y": np.array([0.0, 1.0, 0.0]), "z": np.array([0.0, 0.0, 1.0])}[up]
    side, ahead = np.roll(axis, 1), np.roll(axis, 2)
    found = []
    for angle in np.linspace(0.3, 2.0, count):
        eye = CENTRE + np.cos(angle) * side + np.sin(angle) * ahead + 0.4 * axis
        forward = (CENTRE - eye) / np.linalg.norm(CENTRE - eye)
        right = np.cross(forward, axis)
        right /= np.linalg.norm(right)
        pose = np.eye(4)
        pose[:3] = np.column_stack([right, np.cross(forward, right), forward, eye])
        found.append(pose)
    return found


def depth_m(pose: np.ndarray) -> np.ndarray:
    """(H,W) metres along the optical axis to the sphere, 0 beside it: the smaller root of |o + z d - c| = r."""
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    rays = np.stack([(u - CX) / FOCAL, (v - CY) / FOCAL, np.ones(u.shape)], axis=-1) @ pose[:3, :3].T
    to_eye = pose[:3, 3] - CENTRE
    a, b, c = (rays**2).sum(-1), rays @ to_eye, to_eye @ to_eye - RADIUS_M**2
    inside = b * b - a * c
    return np.where(inside > 0, (-b - np.sqrt(np.maximum(inside, 0))) / a, 0.0)


def steps(metres: np.ndarray, per_metre: float = 1000.0) -> np.ndarray:
    return np.rint(metres * per_metre).astype(np.uint16)


def picture(index: int) -> np.ndarray:
    """(h,w,3) uint8 RGB: red grows to the right, green is the frame's number, blue grows downward."""
    v, u = np.mgrid[: HEIGHT * COLOUR_SCALE, : WIDTH * COLOUR_SCALE]
    return np.stack([u, np.full(u.shape, 40 * index), v], axis=-1).astype(np.uint8)


def colour_camera() -> tuple[float, float, float, float]:
    """fx, fy, cx, cy for `picture`, pixel centres at integers."""
    s = COLOUR_SCALE
    return FOCAL * s, FOCAL * s, (CX + 0.5) * s - 0.5, (CY + 0.5) * s - 0.5


def save_png(path: Path, pixels: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(cv2.imencode(".png", pixels)[1].tobytes())


def save_jpg(path: Path, rgb: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(jpg_bytes(rgb))


def jpg_bytes(rgb: np.ndarray) -> bytes:
    return cv2.imencode(".jpg", rgb[..., ::-1])[1].tobytes()


def quaternion(rotation: np.ndarray) -> np.ndarray:
    """(4,) x, y, z, w: the eigenvector of the matrix of Bar-Itzhack (2000) with the largest eigenvalue."""
    r = rotation
    k = np.array(
        [
            [r[0, 0] - r[1, 1] - r[2, 2], 0, 0, 0],
            [r[1, 0] + r[0, 1], r[1, 1] - r[0, 0] - r[2, 2], 0, 0],
            [r[2, 0] + r[0, 2], r[2, 1] + r[1, 2], r[2, 2] - r[0, 0] - r[1, 1], 0],
            [r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1], r.trace()],
        ]
    )
    return np.linalg.eigh(k)[1][:, -1]


def confidence(metres: np.ndarray) -> np.ndarray:
    """(H,W) uint8: 2 on the sphere, 0 beside it."""
    return np.where(metres > 0, 2, 0).astype(np.uint8)


def _row_major_k() -> list[float]:
    fx, fy, cx, cy = colour_camera()
    return [fx, 0, cx, 0, fy, cy, 0, 0, 1]


def write_open3d(folder: Path, count: int = 4) -> Path:
    lines = []
    for index, pose in enumerate(poses(count)):
        save_png(folder / f"depth/{index:05}.png", steps(depth_m(pose)))
        save_jpg(folder / f"color/{index:05}.jpg", picture(index))
        lines += [f"{index} {index} {index + 1}", *(" ".join(map(repr, row)) for row in pose.tolist())]
    (folder / "trajectory.log").write_text("\n".join(lines) + "\n")
    camera = {"width": WIDTH, "height": HEIGHT, "intrinsic_matrix": [FOCAL, 0, 0, 0, FOCAL, 0, CX, CY, 1]}
    (folder / "camera.json").write_text(json.dumps(camera))
    return folder


def write_tum(folder: Path) -> Path:
    """Depth, colour and pose come at different times, as from a motion capture system of 100 Hz."""
    truth, depths, colours = ["# ground truth"], ["# depth maps"], ["# color images"]
    for index, pose in enumerate(poses(up="z")):
        stamp = 1305031102.0 + index / 30
        save_png(folder / f"depth/{stamp:.6f}.png", steps(depth_m(pose), 5000.0))
        save_png(folder / f"rgb/{stamp + 0.011:.6f}.png", picture(index)[..., ::-1])
        depths.append(f"{stamp:.6f} depth/{stamp:.6f}.png")
        colours.append(f"{stamp + 0.011:.6f} rgb/{stamp + 0.011:.6f}.png")
        words = [*pose[:3, 3], *quaternion(pose[:3, :3])]
        truth.append(" ".join([f"{stamp + 0.004:.4f}", *(f"{word:.9f}" for word in words)]))
    for name, lines in (("groundtruth.txt", truth), ("depth.txt", depths), ("rgb.txt", colours)):
        (folder / name).write_text("\n".join(lines) + "\n")
    camera = {"width": WIDTH, "height": HEIGHT, "intrinsic_matrix": [FOCAL, 0, 0, 0, FOCAL, 0, CX, CY, 1]}
    (folder / "camera.json").write_text(json.dumps(camera))
    return folder


def write_nerfstudio(folder: Path) -> Path:
    """Pixels have their corners at integers there: half a pixel more on cx and cy."""
    fx, fy, cx, cy = colour_camera()
    frames = []
    for index, pose in enumerate(poses()):
        save_png(folder / f"depth/{index}.png", steps(depth_m(pose)))
        save_jpg(folder / f"images/{index}.jpg", picture(index))
        frame = {"file_path": f"./images/{index}.jpg", "depth_file_path": f"depth/{index}.png"}
        frames.append(frame | {"transform_matrix": (pose @ FLIP).tolist()})
    size = {"w": WIDTH * COLOUR_SCALE, "h": HEIGHT * COLOUR_SCALE}
    tree = size | {"fl_x": fx, "fl_y": fy, "cx": cx + 0.5, "cy": cy + 0.5, "frames": frames}
    (folder / "transforms.json").write_text(json.dumps(tree))
    return folder


def write_record3d(folder: Path) -> Path:
    """Poses relative to the first, and the first beside them."""
    fx, fy, cx, cy = colour_camera()
    world = [pose @ FLIP for pose in poses()]
    relative = [np.linalg.inv(world[0]) @ pose for pose in world]
    meta = {
        "w": WIDTH * COLOUR_SCALE, "h": HEIGHT * COLOUR_SCALE, "dw": WIDTH, "dh": HEIGHT, "fps": 60,
        "K": [fx, 0, 0, 0, fy, 0, cx, cy, 1],
        "poses": [[*quaternion(pose[:3, :3]), *pose[:3, 3]] for pose in relative],
        "initPose": [*quaternion(world[0][:3, :3]), *world[0][:3, 3]],
    }  # fmt: skip
    (folder / "rgbd").mkdir(parents=True)
    (folder / "metadata").write_text(json.dumps(meta))
    for index, pose in enumerate(poses()):
        metres = depth_m(pose)
        unknown = np.where(metres > 0, metres, np.nan).astype("<f4")
        (folder / f"rgbd/{index}.depth").write_bytes(lzfse.compress(unknown.tobytes()))
        (folder / f"rgbd/{index}.conf").write_bytes(lzfse.compress(confidence(metres).tobytes()))
        save_jpg(folder / f"rgbd/{index}.jpg", picture(index))
    return folder


def write_r3d(folder: Path) -> Path:
    """The same as one zip."""
    inside = write_record3d(folder / "inside")
    archive = folder / "capture.r3d"
    with zipfile.ZipFile(archive, "w") as target:
        for path in sorted(inside.rglob("*")):
            if path.is_file():
                target.write(path, path.relative_to(inside))
    return archive


def write_stray(folder: Path) -> Path:
    """The video has a frame before the first with depth; poses are in OpenCV axes."""
    rows = ["timestamp, frame, x, y, z, qx, qy, qz, qw"]
    for index, pose in enumerate(poses(), start=1):
        metres = depth_m(pose)
        save_png(folder / f"depth/{index:06}.png", steps(metres))
        save_png(folder / f"confidence/{index:06}.png", confidence(metres))
        words = [f"{word:.9f}" for word in (*pose[:3, 3], *quaternion(pose[:3, :3]))]
        rows.append(", ".join([f"{index / 60:.4f}", f"{index:06}", *words]))
    (folder / "odometry.csv").write_text("\n".join(rows) + "\n")
    k = np.reshape(_row_major_k(), (3, 3))
    (folder / "camera_matrix.csv").write_text("\n".join(",".join(map(str, row)) for row in k))
    write_video(folder / "rgb.mp4", [picture(index) for index in range(len(poses()) + 1)])
    return folder


def write_video(path: Path, pictures: list[np.ndarray]) -> None:
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mpeg4", rate=30)
        stream.height, stream.width = pictures[0].shape[:2]
        stream.pix_fmt, stream.bit_rate = "yuv420p", 8_000_000
        for rgb in pictures:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(rgb, format="rgb24")))
        container.mux(stream.encode())


_UPRIGHT = ((1, 0, 0, 1), (0, 1, -1, 0), (-1, 0, 0, -1), (0, -1, 1, 0))


def turn_film(path: Path, turns: int) -> Path:
    """Have an MP4 say by how many clockwise quarter turns its pictures are upright, as phones do.

    The matrix of the track's header: x' = a x + c y, y' = b x + d y, x right and y down (ISO/IEC 14496-12).
    """
    data = bytearray(path.read_bytes())
    a, b, c, d = _UPRIGHT[turns]
    struct.pack_into(">9i", data, data.index(b"tkhd") + 44, a << 16, b << 16, 0, c << 16, d << 16, 0, 0, 0, 1 << 30)
    path.write_bytes(data)
    return path


def write_kitti(folder: Path) -> Path:
    """KITTI's odometry: camera 2 stands half a metre beside camera 0, whose poses are told."""
    fx, fy, cx, cy = colour_camera()
    aside = np.eye(4)
    aside[0, 3] = 0.5
    rows = []
    for index, pose in enumerate(poses(12)):
        save_png(folder / f"image_2/{index:06}.png", picture(index)[..., ::-1])
        rows.append(" ".join(f"{value:.9e}" for value in (pose @ np.linalg.inv(aside))[:3].ravel()))
    matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    lines = [f"P{number}: " + " ".join(map(str, (matrix @ np.eye(3, 4)).ravel())) for number in (0, 1)]
    lines.append("P2: " + " ".join(map(str, (matrix @ np.linalg.inv(aside)[:3]).ravel())))
    (folder / "calib.txt").write_text("\n".join([*lines, "Tr: " + " ".join(["0.1"] * 12)]) + "\n")
    (folder / "poses.txt").write_text("\n".join(rows) + "\n")
    (folder / "times.txt").write_text("\n".join(f"{index / 10:e}" for index in range(12)) + "\n")
    return folder


def write_polycam(folder: Path) -> Path:
    fx, fy, cx, cy = colour_camera()
    for index, pose in enumerate(poses()):
        metres, stamp = depth_m(pose), 1_700_000_000 + index
        save_png(folder / f"keyframes/depth/{stamp}.png", steps(metres))
        save_png(folder / f"keyframes/confidence/{stamp}.png", (confidence(metres) * 127.5).astype(np.uint8))
        save_jpg(folder / f"keyframes/corrected_images/{stamp}.jpg", picture(index))
        matrix = pose @ FLIP
        camera = {f"t_{row}{column}": matrix[row, column] for row in range(3) for column in range(4)}
        camera |= {
            "fx": fx,
            "fy": fy,
            "cx": cx,
            "cy": cy,
            "width": WIDTH * COLOUR_SCALE,
            "height": HEIGHT * COLOUR_SCALE,
        }
        path = folder / f"keyframes/corrected_cameras/{stamp}.json"
        path.parent.mkdir(exist_ok=True)
        path.write_text(json.dumps(camera))
    (folder / "mesh_info.json").write_text("{}")
    return folder


def write_scanner3d(folder: Path) -> Path:
    """Intrinsics for 1920 x 1440; only every other frame has a picture."""
    scale = 1920 / WIDTH
    k = [FOCAL * scale, 0, (CX + 0.5) * scale - 0.5, 0, FOCAL * scale, (CY + 0.5) * scale - 0.5, 0, 0, 1]
    folder.mkdir(parents=True, exist_ok=True)
    for index, pose in enumerate(poses()):
        metres = depth_m(pose)
        save_png(folder / f"depth_{index:05}.png", steps(metres))
        save_png(folder / f"conf_{index:05}.png", confidence(metres))
        record = {"cameraPoseARFrame": (pose @ FLIP).reshape(-1).tolist(), "intrinsics": k, "frame_index": index}
        (folder / f"frame_{index:05}.json").write_text(json.dumps(record))
        if index % 2 == 0:
            save_jpg(folder / f"frame_{index:05}.jpg", picture(index))
    return folder


def write_depth16(folder: Path) -> Path:
    """A phone held level, with a screen twice as long as it is high: it crops the picture's height."""
    folder.mkdir(parents=True, exist_ok=True)
    screen_height = WIDTH / 2
    projection = np.zeros((4, 4))
    projection[0, 0], projection[1, 1] = 2 * FOCAL / WIDTH, 2 * FOCAL / screen_height
    projection[0, 2] = 1 - 2 * (CX + 0.5) / WIDTH
    projection[1, 2] = (2 * (CY + 0.5) - HEIGHT) / screen_height
    projection[2:, 2:] = [[-1.002, -0.2], [-1, 0]]
    rows = ["frame,tx,ty,tz,qx,qy,qz,qw,yaw,pitch,roll,projection"]
    for index, pose in enumerate(poses()):
        metres, name = depth_m(pose), f"{12 * index:08}"
        level = np.where(metres > 0, 0, 1).astype(np.uint16)  # Android: 0 is certain, 1 is none
        (folder / f"{name}_depth16.bin").write_bytes((steps(metres) | level << 13).astype("<u2").tobytes())
        save_jpg(folder / f"{name}_image.jpg", picture(index))
        words = [*pose[:3, 3], *quaternion((pose @ FLIP)[:3, :3])]
        rows.append(",".join([name, *map(repr, map(float, words)), "0,0,0", " ".join(map(str, projection.T.flat))]))
    (folder / "poses.csv").write_text("\n".join(rows) + "\n")
    return folder


def _matrix(values: np.ndarray) -> str:
    """A matrix as C's printf writes it, row by row."""
    return "".join("\t".join(f"{value: .9e}" for value in row) + "\n" for row in values)


def _unknown_beside(metres: np.ndarray) -> np.ndarray:
    """(H,W) uint16 millimetres, 65535 beside the sphere, as these data sets mark what is unknown."""
    return np.where(metres > 0, steps(metres), 65535).astype(np.uint16)


def write_7scenes(folder: Path) -> Path:
    """In two sequences, with the camera matrix of 3DMatch above them."""
    for index, pose in enumerate(poses()):
        stem = f"seq-{1 + index // 2:02}/frame-{index % 2:06}"
        save_png(folder / f"{stem}.depth.png", _unknown_beside(depth_m(pose)))
        save_png(folder / f"{stem}.color.png", picture(index)[..., ::-1])
        (folder / f"{stem}.pose.txt").write_text(_matrix(pose))
    camera = np.array([[FOCAL, 0, CX], [0, FOCAL, CY], [0, 0, 1]])
    (folder / "camera-intrinsics.txt").write_text(_matrix(camera))
    return folder


def write_scannet(folder: Path) -> Path:
    """Of the colour camera, which comes first by its name, the depth is not."""
    for index, pose in enumerate(poses()):
        save_png(folder / f"depth/{10 * index}.png", steps(depth_m(pose)))
        save_jpg(folder / f"color/{10 * index}.jpg", picture(index))
        (folder / "pose").mkdir(exist_ok=True)
        (folder / f"pose/{10 * index}.txt").write_text(_matrix(pose))
    (folder / "intrinsic").mkdir()
    for name, scale in (("color", COLOUR_SCALE), ("depth", 1)):
        camera = np.diag([scale * FOCAL, scale * FOCAL, 1.0, 1.0])
        camera[:2, 2] = scale * CX, scale * CY
        (folder / f"intrinsic/intrinsic_{name}.txt").write_text(_matrix(camera))
    return folder


def write_arkitscenes(folder: Path) -> Path:
    """Depth at 60 Hz, and poses at 10: every other depth image has none."""
    lines = []
    for index, pose in enumerate(poses()):
        for half in range(2):
            name = f"41069021_{100.0 + index / 10 + half / 20:.3f}"
            save_png(folder / f"lowres_depth/{name}.png", steps(depth_m(pose)))
            save_png(folder / f"lowres_wide/{name}.png", picture(index)[..., ::-1])
            save_png(folder / f"confidence/{name}.png", confidence(depth_m(pose)))
            camera = folder / f"lowres_wide_intrinsics/{name}.pincam"
            camera.parent.mkdir(exist_ok=True)
            camera.write_text(f"{WIDTH} {HEIGHT} {FOCAL} {FOCAL} {CX} {CY}")
        to_camera = np.linalg.inv(pose)
        words = [100.0 + index / 10 + 0.001, *cv2.Rodrigues(to_camera[:3, :3])[0].ravel(), *to_camera[:3, 3]]
        lines.append(" ".join(f"{word:.12f}" for word in words))
    (folder / "lowres_wide.traj").write_text("\n".join(lines) + "\n")
    return folder


def write_replica(folder: Path) -> Path:
    for index, pose in enumerate(poses()):
        save_png(folder / f"results/depth{index:06}.png", steps(depth_m(pose), 6553.5))
        save_jpg(folder / f"results/frame{index:06}.jpg", picture(index))
    lines = [" ".join(f"{value:.18e}" for value in pose.flat) for pose in poses()]
    (folder / "traj.txt").write_text("\n".join(lines) + "\n")
    camera = {"w": WIDTH, "h": HEIGHT, "fx": FOCAL, "fy": FOCAL, "cx": CX, "cy": CY, "scale": 6553.5}
    (folder / "cam_params.json").write_text(json.dumps({"camera": camera}))
    return folder


RGBD: dict[str, Callable[[Path], Path]] = {
    "open3d": write_open3d,
    "tum": write_tum,
    "nerfstudio": write_nerfstudio,
    "record3d": write_record3d,
    "r3d": write_r3d,
    "stray": write_stray,
    "polycam": write_polycam,
    "3dscannerapp": write_scanner3d,
    "depth16": write_depth16,
    "7scenes": write_7scenes,
    "scannet": write_scannet,
    "arkitscenes": write_arkitscenes,
    "replica": write_replica,
}


def sphere(count: int = 500, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points on the sphere (N,3) float32, colours (N,3) uint8, normals (N,3) float32."""
    rng = np.random.default_rng(seed)
    normals = rng.normal(size=(count, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    xyz = CENTRE + RADIUS_M * normals
    return xyz.astype(np.float32), rng.integers(0, 256, (count, 3), np.uint8), normals.astype(np.float32)


def ply_bytes(
    xyz: np.ndarray, rgb: np.ndarray | None = None, normals: np.ndarray | None = None, *, form: str = "little"
) -> bytes:
    """PLY as "ascii", "little" or "big" endian."""
    order = {"ascii": "=", "little": "<", "big": ">"}[form]
    fields = [(name, order + "f4") for name in "xyz"]
    columns = [xyz]
    if normals is not None:
        fields += [(name, order + "f4") for name in ("nx", "ny", "nz")]
        columns.append(normals)
    if rgb is not None:
        fields += [(name, "u1") for name in ("red", "green", "blue")]
        columns.append(rgb)
    table = np.empty(len(xyz), fields)
    for name, values in zip(table.dtype.names, np.hstack(columns).T, strict=True):
        table[name] = values
    kinds = "".join(f"property {'uchar' if kind == 'u1' else 'float'} {name}\n" for name, kind in fields)
    style = "ascii" if form == "ascii" else f"binary_{form}_endian"
    head = f"ply\nformat {style} 1.0\ncomment a test\nelement vertex {len(xyz)}\n{kinds}end_header\n".encode()
    if form != "ascii":
        return head + table.tobytes()
    return head + "\n".join(" ".join(map(str, row)) for row in table.tolist()).encode() + b"\n"


def splat_ply_bytes(xyz: np.ndarray, rgb: np.ndarray, opacity: np.ndarray, *, form: str = "little") -> bytes:
    """PLY of Gaussian splats as their trainers write them, "ascii" or "little" endian; opacity (N,) in (0,1)."""
    names = ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", "f_rest_0", "opacity"]
    names += ["scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"]
    table = np.zeros((len(xyz), len(names)), "<f4")
    table[:, :3], table[:, 14] = xyz, 1
    table[:, 6:9] = (rgb / 255 - 0.5) * 2 * np.sqrt(np.pi)
    table[:, 10] = np.log(opacity / (1 - opacity))
    style = "ascii" if form == "ascii" else "binary_little_endian"
    head = f"ply\nformat {style} 1.0\nelement vertex {len(xyz)}\n" + "".join(
        f"property float {name}\n" for name in names
    )
    rows = "\n".join(" ".join(map(repr, row)) for row in table.tolist()) + "\n"
    return (head + "end_header\n").encode() + (rows.encode() if form == "ascii" else table.tobytes())


def pcd_bytes(xyz: np.ndarray, rgb: np.ndarray, normals: np.ndarray, *, form: str = "binary", height: int = 1) -> bytes:
    """PCD as "ascii", "binary" or "binary_compressed", colours packed into the bits of a float."""
    packed = (rgb.astype(np.uint32) << [16, 8, 0]).sum(1).astype(np.uint32)
    table = np.zeros(len(xyz), [(name, "<f4") for name in ("x", "y", "z", "rgb", "nx", "ny", "nz")])
    for name, values in zip(("x", "y", "z", "nx", "ny", "nz"), np.hstack([xyz, normals]).T, strict=True):
        table[name] = values
    table["rgb"] = packed.view(np.float32)
    head = (
        "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS x y z rgb normal_x normal_y normal_z\n"
        "SIZE 4 4 4 4 4 4 4\nTYPE F F F F F F F\nCOUNT 1 1 1 1 1 1 1\n"
        f"WIDTH {len(xyz) // height}\nHEIGHT {height}\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {len(xyz)}\nDATA {form}\n"
    ).encode()
    if form == "ascii":
        return head + "\n".join(" ".join(f"{value!r}" for value in row) for row in table.tolist()).encode()
    if form == "binary":
        return head + table.tobytes()
    plain = b"".join(table[name].tobytes() for name in table.dtype.names)
    squeezed = lzf_compress(plain)
    return head + struct.pack("<II", len(squeezed), len(plain)) + squeezed


def lzf_compress(data: bytes) -> bytes:
    """LibLZF's format, by a greedy search of the last place where three bytes stood."""
    out, literals, seen, at = bytearray(), bytearray(), {}, 0

    def flush() -> None:
        for start in range(0, len(literals), 32):
            run = literals[start : start + 32]
            out.append(len(run) - 1)
            out.extend(run)
        literals.clear()

    while at < len(data):
        key = data[at : at + 3]
        start = seen.get(key, -1)
        seen[key] = at
        back = at - start - 1
        if len(key) < 3 or start < 0 or back >= 8192:
            literals.append(data[at])
            at += 1
            continue
        length = 3
        while length < 264 and at + length < len(data) and data[start + length] == data[at + length]:
            length += 1
        flush()
        short = min(length - 2, 7)
        out.append(short << 5 | back >> 8)
        if short == 7:
            out.append(length - 9)
        out.append(back & 0xFF)
        at += length
    flush()
    return bytes(out)


def save_las(path: Path, xyz: np.ndarray, rgb: np.ndarray) -> None:
    """LAS 1.2 or, by the suffix, LAZ; colours in the upper byte of 16 bits, as the standard asks."""
    import laspy

    header = laspy.LasHeader(point_format=2, version="1.2")
    header.scales, header.offsets = np.full(3, 1e-4), np.floor(xyz.min(axis=0))
    las = laspy.LasData(header)
    las.x, las.y, las.z = xyz.astype(np.float64).T
    las.red, las.green, las.blue = rgb.astype(np.uint16).T * 257
    las.write(str(path))


def save_e57(path: Path, scans: list[dict[str, np.ndarray]], poses: list[np.ndarray] | None = None) -> None:
    """E57 of scans whose columns have the standard's names; poses (4,4) scan-to-file, or the identity."""
    import pye57

    with pye57.E57(str(path), mode="w") as writer:
        for number, scan in enumerate(scans):
            pose = np.eye(4) if poses is None else poses[number]
            turned = np.roll(quaternion(pose[:3, :3]), 1)  # w first
            writer.write_scan_raw(scan, name=f"Scan {number}", rotation=turned, translation=pose[:3, 3])


def e57_scan(xyz: np.ndarray, rgb: np.ndarray | None = None) -> dict[str, np.ndarray]:
    """The columns of a scan."""
    columns = dict(zip(("cartesianX", "cartesianY", "cartesianZ"), xyz.astype(np.float64).T, strict=True))
    if rgb is not None:
        columns |= dict(zip(("colorRed", "colorGreen", "colorBlue"), np.ascontiguousarray(rgb.T), strict=True))
    return columns


def npy_bytes(array: np.ndarray) -> bytes:
    buffer = io.BytesIO()
    np.save(buffer, array)
    return buffer.getvalue()


def hemisphere() -> trimesh.Trimesh:
    """An open surface: 642 vertices of the unit sphere's upper half, in metres, Y up."""
    ball = trimesh.creation.icosphere(subdivisions=3)
    keep = ball.triangles_center[:, 1] > 0
    return trimesh.Trimesh(ball.vertices, ball.faces[keep], process=False)


_GLTF_KINDS = {"int8": 5120, "uint8": 5121, "int16": 5122, "uint16": 5123, "uint32": 5125, "float32": 5126}


def glb_bytes(
    attributes: dict[str, np.ndarray],
    faces: np.ndarray,
    *,
    normalised: Container[str] = (),
    material: dict[str, object] | None = None,
    picture: np.ndarray | None = None,
    node: dict[str, object] | None = None,
    required: tuple[str, ...] = (),
) -> bytes:
    """A GLB of one primitive, as the format's text says: rows begin at multiples of four bytes.

    normalised: the attributes whose integers are fractions; picture (H,W,3): texture 0
    """
    data, views, accessors = bytearray(), [], []

    def add_view(content: bytes, **more: int) -> int:
        data.extend(b"\0" * (-len(data) % 4))
        views.append({"buffer": 0, "byteOffset": len(data), "byteLength": len(content), **more})
        data.extend(content)
        return len(views) - 1

    def add(name: str, rows: np.ndarray) -> int:
        width = rows.shape[1] * rows.itemsize
        step = width + -width % 4
        content = np.zeros((len(rows), step), np.uint8)
        content[:, :width] = np.ascontiguousarray(rows).view(np.uint8)
        accessor = {"bufferView": add_view(content.tobytes(), byteStride=step), "count": len(rows)}
        accessor |= {"componentType": _GLTF_KINDS[rows.dtype.name], "type": f"VEC{rows.shape[1]}"}
        accessors.append(accessor | ({"normalized": True} if name in normalised else {}))
        return len(accessors) - 1

    primitive: dict[str, object] = {"attributes": {name: add(name, rows) for name, rows in attributes.items()}}
    indices = faces.astype("<u4").tobytes()
    accessors.append({"bufferView": add_view(indices), "count": faces.size, "componentType": 5125, "type": "SCALAR"})
    primitive["indices"] = len(accessors) - 1
    tree: dict[str, object] = {"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}]}
    if material is not None:
        primitive["material"], tree["materials"] = 0, [material]
    if picture is not None:
        image = {"bufferView": add_view(cv2.imencode(".png", picture[..., ::-1])[1].tobytes()), "mimeType": "image/png"}
        tree |= {"images": [image], "textures": [{"source": 0}]}
    if required:
        tree |= {"extensionsUsed": required, "extensionsRequired": required}
    tree |= {"meshes": [{"primitives": [primitive]}], "nodes": [{"mesh": 0} | (node or {})]}
    tree |= {"accessors": accessors, "bufferViews": views, "buffers": [{"byteLength": len(data)}]}
    return glb_of(tree, bytes(data))


def glb_of(tree: dict[str, object], chunk: bytes) -> bytes:
    """A GLB of its JSON and its binary chunk."""
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    chunk += b"\0" * (-len(chunk) % 4)
    head = struct.pack("<4sII", b"glTF", 2, 28 + len(text) + len(chunk))
    return head + struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(chunk), b"BIN\0") + chunk


def as_bytes(exported: str | bytes) -> bytes:
    return exported.encode() if isinstance(exported, str) else exported


def back_project(frame: Frame) -> np.ndarray:
    """(N,3) world points of the known depth."""
    depth_m, camera = frame.load_depth_m(), frame.intrinsics
    v, u = np.nonzero(depth_m)
    z = depth_m[v, u]
    points = np.stack([(u - camera.cx) / camera.fx * z, (v - camera.cy) / camera.fy * z, z], axis=1)
    return points @ frame.camera_to_world[:3, :3].T + frame.camera_to_world[:3, 3]
