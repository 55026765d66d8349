"""Sets of photos for the benches: real ones with another program's cameras and surface, and rendered ones."""

from __future__ import annotations

import json
import re
import shutil
import tempfile
import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import av
import numpy as np
import trimesh
from PIL import Image

from capture2vr.edge.arrays import Floats, Ints
from capture2vr.edge.capture.nouns import Intrinsics
from capture2vr.edge.fusion.orbit import meeting_point
from capture2vr.edge.render.posed_picture import PosedPicture
from tests.bench.data_files import data_file
from tests.support.photos.rendered.photos import SEED, RenderedPhotos, arrange_photos, render_photos
from tests.support.photos.walkaround import render_walkaround

OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])
"""From a camera's OpenGL axes, and Bundler's, to OpenCV's and back."""
_FRAMES_A_SECOND, _FILM_S = 15, 12
_AGREES = 0.005  # relative difference of two depths of one place: the depth maps' noise is 0.15 %
_AGREEING = 3  # least depth maps that have to agree with a depth; what stereo fattens a silhouette by, fewer do
_REACH = 0.5  # of the cameras' distance: the statue with its boulder lies within, the lawn around it beyond
_LEVEL = 0.01  # of the reach: how exactly the ground's height is found
_LOWEST = 1 / 3  # share of the heights, from below, that the ground is looked for in
_ABOVE = 0.04  # of the reach, above the ground: twice the pavement's unevenness
_CELL = 0.0025  # of the points' longest side: they are thinned to one in a cell


@dataclass(frozen=True, slots=True)
class PhotoSet:
    """Photos with what is known about them.

    source      folder of the capture
    cameras     camera-to-world (4,4) in OpenCV axes by file name; of a film by the number of the frame
    truth       the surface in the frame of the cameras; None where none is known
    intrinsics  of the cameras, where they have no distortion; None where that is not known
    """

    source: Path
    cameras: Mapping[str, Floats]
    truth: trimesh.Trimesh | None = None
    intrinsics: Intrinsics | None = None

    def camera(self, name: str) -> Floats:
        """The camera of a photo by its name in the capture: a file, or "walk.mp4 at 3.27 s"."""
        at = re.search(r" at ([\d.]+) s$", name)
        return self.cameras[str(round(float(at[1]) * _FRAMES_A_SECOND)) if at else name]


# Real photos


def fruit(given: Path | None = None) -> PhotoSet:
    """The photos of fruit, with the cameras and the mesh that another program made from them at full size.

    given  a folder for the photos with these cameras as a `transforms.json` beside them; None: the photos alone
    """
    data = data_file("photos_fruit")
    root = ElementTree.parse(data / "camera.xml").getroot()
    poses = {
        f"{camera.get('label')}.JPG": np.array((camera.findtext("transform") or "").split(), float).reshape(4, 4)
        for camera in root.iter("camera")
    }
    if given:
        write_transforms(given, data / "images", metashape_lens(root, data / "images"), poses)
    return PhotoSet(given or data / "images", poses, trimesh.load_mesh(data / "foo.obj", process=False))


def statue(given: Path | None = None) -> PhotoSet:
    """The photos of the statue, with the cameras of another program; `given` as for `fruit`."""
    data = data_file("photos_statue")
    lens, poses = _statue_cameras()
    if given:
        write_transforms(given, data / "images", lens, poses)
    return PhotoSet(given or data / "images", poses)


def _statue_cameras() -> tuple[dict[str, float], dict[str, Floats]]:
    data = data_file("photos_statue")
    names = (data / "ordered_filenames.txt").read_text().split()[1:]
    return bundler_cameras((data / "cameras.out").read_text(), names, _size(data / "images"))


def statue_points() -> Floats:
    """Points (N,3) of statue and boulder from the other program's depth maps, in the frame of `statue`'s cameras.

    Those that at least three other depth maps agree with, within half the cameras' distance of where their axes meet,
    and above the pavement. The photos lie on their side: up is to their right. The depth maps' cameras have no
    distortion: so taken, they agree better with each other and with the points of cameras.out.
    """
    data = data_file("photos_statue")
    lens, poses = _statue_cameras()
    focal = np.array([lens["fl_x"] / lens["w"], lens["fl_y"] / lens["h"]])
    maps = [
        _depth_map(data / "depth" / f"{Path(name).stem}.exr", np.linalg.inv(pose), focal)
        for name, pose in poses.items()
    ]
    cameras = np.stack(list(poses.values()))
    eyes = cameras[:, :3, 3]
    middle = meeting_point(eyes, cameras[:, :3, 2])
    reach = _REACH * float(np.median(np.linalg.norm(eyes - middle, axis=1)))
    up = cameras[:, :3, 0].mean(axis=0)
    return thinned(above_the_ground(agreed_points(maps), middle, reach, up / np.linalg.norm(up)))


def _depth_map(file: Path, to_camera: Floats, focal: Floats) -> PosedPicture:
    with av.open(str(file)) as stream:  # OpenCV's wheels read no OpenEXR
        depth = next(stream.decode(video=0)).to_ndarray()

    def no_picture() -> Any:
        raise NotImplementedError(f"{file.name} has depth alone")

    return PosedPicture(to_camera, focal, np.full(2, 0.5), no_picture, lambda: depth)


def agreed_points(maps: Sequence[PosedPicture], least: int = _AGREEING) -> Floats:
    """The points (N,3) of depth maps that at least so many of the other maps have at the same depth."""
    depths = [each.depth() for each in maps]
    found = []
    for number, picture in enumerate(maps):
        xyz = _points(picture, depths[number])
        others = [(each, depths[other]) for other, each in enumerate(maps) if other != number]
        found.append(xyz[sum(_agrees(xyz, *other) for other in others) >= least])
    return np.concatenate(found)


def _points(picture: PosedPicture, depth: Floats) -> Floats:
    """The points (N,3) of a depth map, in the world."""
    row, column = np.nonzero(depth > 0)
    at = (np.stack([column, row], axis=1) + 0.5) / depth.shape[::-1]
    z = depth[row, column].astype(np.float64)
    local = np.column_stack([(at - picture.middle) / picture.focal * z[:, None], z])
    to_world = np.linalg.inv(picture.to_camera)
    xyz: Floats = local @ to_world[:3, :3].T + to_world[:3, 3]
    return xyz


def _agrees(xyz: Floats, picture: PosedPicture, depth: Floats) -> Ints:
    """(N,) 1 where a depth map has the point's depth in the point's pixel."""
    at, z = picture.project(xyz)
    pixel = np.floor(np.where(z[:, None] > 0, at, -1) * depth.shape[::-1]).astype(int)
    inside = ((pixel >= 0) & (pixel < depth.shape[::-1])).all(axis=1)
    known = np.zeros(len(xyz))
    known[inside] = depth[pixel[inside, 1], pixel[inside, 0]]
    return (np.abs(known - z) < _AGREES * z).astype(int)


def above_the_ground(xyz: Floats, middle: Floats, reach: float, up: Floats) -> Floats:
    """The points (N,3) within `reach` of `middle` and above the ground, which is where most of the lowest are."""
    near = xyz[np.linalg.norm(xyz - middle, axis=1) < reach]
    height = near @ up
    low, high = np.percentile(height, [0.1, 99.9])
    step = _LEVEL * reach
    edges = np.arange(low - step, low + _LOWEST * (high - low), step)
    count, _ = np.histogram(height, edges)
    ground = edges[count.argmax()] + step / 2
    return near[height > ground + _ABOVE * reach]


def thinned(xyz: Floats) -> Floats:
    """One of the points (N,3) in each cell of a grid, so that what many photos show does not count more."""
    cell = np.floor(xyz / (_CELL * np.ptp(xyz, axis=0).max())).astype(int)
    _, first = np.unique(cell, axis=0, return_index=True)
    return xyz[first]


def bundler_cameras(
    text: str, names: Sequence[str], size: tuple[int, int]
) -> tuple[dict[str, float], dict[str, Floats]]:
    """Read cameras of one lens from a file of Bundler 0.3: lens as nerfstudio has it, and camera-to-world by file name.

    A camera is five lines: f, k1, k2; the rotation's rows; the translation, from the world to axes of which z points
    backwards and y upwards. Pixels are f·(1 + k1·r² + k2·r⁴)·(x, y) from the picture's middle: OpenCV's k1 and k2, for
    the axes that are turned leave r as it is. size: (width, height) of the pictures.
    """
    lines = [line for line in text.splitlines() if not line.startswith("#")]
    count = int(lines[0].split()[0])
    table = np.array(" ".join(lines[1 : 1 + 5 * count]).split(), float).reshape(count, 15)
    if len(names) != count or np.ptp(table[:, :3], axis=0).any():
        raise ValueError(f"{len(names)} names for {count} cameras, which should have one lens")
    to_camera = np.tile(np.eye(4), (count, 1, 1))
    to_camera[:, :3, :3], to_camera[:, :3, 3] = table[:, 3:12].reshape(count, 3, 3), table[:, 12:]
    (focal, k1, k2), (width, height) = table[0, :3].tolist(), size
    lens = {"w": width, "h": height, "fl_x": focal, "fl_y": focal, "cx": width / 2, "cy": height / 2}
    return {**lens, "k1": k1, "k2": k2}, dict(zip(names, np.linalg.inv(to_camera) @ OPENGL, strict=True))


def metashape_lens(root: ElementTree.Element, images: Path) -> dict[str, float]:
    """Metashape's lens as nerfstudio's, for pictures of another size: its centre counts from the middle."""
    lens = root.find(".//calibration")
    assert lens is not None
    told = {each: float(lens.findtext(each) or 0) for each in ("f", "cx", "cy", "k1", "k2", "k3", "p1", "p2")}
    size = lens.find("resolution")
    assert size is not None
    width, height = _size(images)
    by = width / int(size.get("width") or 0)
    return {
        "w": width,
        "h": height,
        "fl_x": by * told["f"],
        "fl_y": by * told["f"],
        "cx": width / 2 + by * told["cx"],
        "cy": height / 2 + by * told["cy"],
        **{each: told[each] for each in ("k1", "k2", "k3", "p1", "p2")},
    }


def write_transforms(folder: Path, images: Path, lens: Mapping[str, float], poses: Mapping[str, Floats]) -> None:
    """Copy images into a folder, with a nerfstudio `transforms.json` of their camera-to-world poses beside them."""
    frames = []
    for image in sorted(images.iterdir()):
        shutil.copy(image, folder)
        frames.append({"file_path": image.name, "transform_matrix": (poses[image.name] @ OPENGL).tolist()})
    (folder / "transforms.json").write_text(json.dumps({**lens, "frames": frames}))


def _size(images: Path) -> tuple[int, int]:
    """Width and height of the first picture of a folder."""
    with Image.open(min(images.iterdir())) as picture:
        return picture.size


# Rendered photos


def shell(folder: Path, views: int, size: tuple[int, int] = (1280, 960), **faults: Any) -> PhotoSet:
    """A walk around the shell; `faults` of the phone as of `render_walkaround`."""
    walk = render_walkaround(folder, views=views, size=size, **faults)
    poses = {photo.name: pose for photo, pose in zip(walk.photos, walk.camera_to_world, strict=True)}
    return PhotoSet(
        folder, poses, trimesh.Trimesh(walk.thing.vertices, walk.thing.faces, process=False), walk.intrinsics
    )


def posed_shell(folder: Path, views: int, **faults: Any) -> PhotoSet:
    """The walk around the shell, with its cameras as a `transforms.json` beside the photos."""
    known = shell(folder / "photos", views, **faults)
    assert known.intrinsics is not None
    _write_cameras(folder / "given", known.source, known.intrinsics, known.cameras)
    return replace(known, source=folder / "given")


def rendered(name: str, folder: Path, *, render: bool = True) -> tuple[PhotoSet, RenderedPhotos]:
    """The photos of a subject of `SUBJECTS` with their cameras, and all that is known of its shape.

    render  whether the photos are to be made, and not in `folder` yet
    """
    if render:
        with tempfile.TemporaryDirectory() as photos:
            made = render_photos(name, Path(photos))
            _write_cameras(folder, Path(photos), made.intrinsics, made.cameras)
    else:
        made = arrange_photos(name, np.random.default_rng(SEED))
    truth = trimesh.Trimesh(made.shape.mesh.vertices, made.shape.mesh.faces, process=False)
    return PhotoSet(folder, made.cameras, truth, made.intrinsics), made


def _write_cameras(folder: Path, photos: Path, lens: Intrinsics, cameras: Mapping[str, Floats]) -> None:
    """Copy photos into a folder, with their cameras, which have no distortion, as a `transforms.json`."""
    folder.mkdir(parents=True, exist_ok=True)
    # nerfstudio's principal point has the first pixel's centre at 0.5.
    named = {"w": lens.width, "h": lens.height, "fl_x": lens.fx, "fl_y": lens.fy, "cx": lens.cx + 0.5}
    write_transforms(folder, photos, {**named, "cy": lens.cy + 0.5}, cameras)


def exposure_steps(views: int, seed: int = 0) -> Floats:
    """(views,3) gains as of a phone's automatic exposure and white balance: a step of up to 2/3 of a stop every few
    photos, and a drift from cold to warm light and back. None is over 1, so that nothing is clipped."""
    rng = np.random.default_rng(seed)
    stops = np.repeat(rng.uniform(-1.0, -0.33, views), rng.integers(2, 6, views))[:views]
    warmth = 0.12 * np.sin(2 * np.pi * np.arange(views) / views)  # of the red light, and as much of the blue one
    return np.exp2(stops)[:, None] * np.exp(np.stack([warmth, 0 * warmth, -warmth], axis=1))


def film(folder: Path, size: tuple[int, int] = (1280, 720), **faults: Any) -> PhotoSet:
    """A film of the same walk, of 12 s."""
    taken = shell(folder / "frames", _FILM_S * _FRAMES_A_SECOND, size, **faults)
    (folder / "film").mkdir()
    with av.open(str(folder / "film" / "walk.mp4"), "w") as container:
        stream = container.add_stream("libx264", rate=_FRAMES_A_SECOND, options={"preset": "veryfast"})
        (stream.width, stream.height), stream.pix_fmt, stream.bit_rate = size, "yuv420p", 12_000_000
        for name in taken.cameras:
            with Image.open(taken.source / name) as picture:
                container.mux(stream.encode(av.VideoFrame.from_image(picture)))
        container.mux(stream.encode())
    poses = {str(number): pose for number, pose in enumerate(taken.cameras.values())}
    return replace(taken, source=folder / "film", cameras=poses)
