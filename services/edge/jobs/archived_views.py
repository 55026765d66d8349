"""Pictures in the archive of prepared points: a JPEG, a depth image and perhaps a mask each, with the camera in the
archive's head."""

from __future__ import annotations

import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import ConfigDict, Field

from capture2vr.edge.arrays import Bools, Bytes
from capture2vr.edge.capture.images import header_size
from capture2vr.edge.capture.nouns import Intrinsics
from capture2vr.edge.capture.photo_copy import COPY_PX, encode_copy
from capture2vr.edge.capture.picture import PhotoPixels
from capture2vr.edge.fusion.texture_views import MAX_TEXTURE_VIEWS
from capture2vr.edge.jobs.archived_arrays import invalid, read_array, write_array
from capture2vr.edge.parallel import in_threads
from capture2vr.edge.points.nouns import Points, TextureView

MOST_VIEWS = 48
"""Most pictures: those for the textures, and those that are held out."""
_MOST_PICTURE_BYTES = 8 << 20  # 1,920 x 1,920 pixels of noise take 6 MB
_DEPTH_SIDE = 2048
_DEPTH_STEPS = np.iinfo(np.uint16).max
_LEAST_DEPTH = 1e-30  # for an image without any
VIEW_BYTES = _MOST_PICTURE_BYTES + 2 * _DEPTH_SIDE**2 + _DEPTH_SIDE**2 // 8 + 2 * 1024
VIEW_FILES = 3
"""Most files of a picture."""
_UNIT = 0.01  # tolerance of a rotation
_JPEG_HEAD_BYTES = 4096  # holds the size of what `encode_copy` writes

_Positive = Annotated[float, Field(gt=0)]
_Row = tuple[float, float, float, float]
_Shape = tuple[Annotated[int, Field(gt=0, le=_DEPTH_SIDE)], Annotated[int, Field(gt=0, le=_DEPTH_SIDE)]]


@dataclass(frozen=True, slots=True)
class ArchivedView:
    """What the head of the archive has of a picture.

    camera           fx, fy, cx, cy of images of `size` (w,h)
    camera_to_world  the first three rows of the pose
    depth_shape      (h,w) of its depth image, in which 1 is `depth_step`, in units of the capture
    mask_shape       (h,w) of its mask; None without one
    """

    name: str
    camera: tuple[_Positive, _Positive, float, float]
    size: tuple[Annotated[int, Field(gt=0)], Annotated[int, Field(gt=0)]]
    camera_to_world: tuple[_Row, _Row, _Row]
    tracked: bool
    held_out: bool
    depth_shape: _Shape
    depth_step: _Positive
    mask_shape: _Shape | None

    __pydantic_config__ = ConfigDict(extra="forbid", allow_inf_nan=False)


@dataclass(frozen=True, slots=True)
class EncodedView:
    """A picture as the archive has it: its JPEG, its depth (H,W) uint16, the rows of its mask (h,⌈w/8⌉) uint8 in bits,
    and what the head tells of it."""

    jpeg: bytes
    depth: Any
    mask: Bytes | None
    head: ArchivedView


def encode_views(points: Points) -> list[EncodedView]:
    """Encode the pictures for the textures, and behind them the held-out ones. Raises CaptureError for a broken one."""
    textures = points.texture_views[:MAX_TEXTURE_VIEWS]
    views = [*((view, False) for view in textures), *((view, True) for view in points.held_out_views)]
    return in_threads(lambda each: _encode(each[0], held_out=each[1]), views[:MOST_VIEWS])


def write_views(packed: zipfile.ZipFile, views: Sequence[EncodedView]) -> None:
    """Write pictures, depths and masks to the archive."""
    for number, view in enumerate(views):
        packed.writestr(_picture_name(number), view.jpeg)
        write_array(packed, _depth_name(number), view.depth)
        if view.mask is not None:
            write_array(packed, _mask_name(number), view.mask)


def view_files(heads: Sequence[ArchivedView]) -> set[str]:
    """Return the names of the pictures' files in the archive of points."""
    masks = {_mask_name(number) for number, head in enumerate(heads) if head.mask_shape}
    return {name(number) for number in range(len(heads)) for name in (_picture_name, _depth_name)} | masks


def read_views(folder: Path, heads: Sequence[ArchivedView], head_file: str) -> list[TextureView]:
    """Check the pictures, depths and masks of an unpacked archive, and return views that load the pictures from there.

    head_file: name of the file that `heads` is from. Raises EdgeError POINTS_INVALID.
    """
    return [_read_view(folder, number, head, head_file) for number, head in enumerate(heads)]


def _encode(view: TextureView, *, held_out: bool) -> EncodedView:
    depth = _at_most(view.load_depth_m())
    mask = None if view.load_mask is None else _at_most(view.load_mask())
    height, width = depth.shape
    step = max(float(depth.max(initial=0.0)), _LEAST_DEPTH) / _DEPTH_STEPS
    lens = view.intrinsics
    rows: Any = tuple(map(tuple, np.asarray(view.camera_to_world, np.float64)[:3].tolist()))
    head = ArchivedView(
        name=view.name,
        camera=(float(lens.fx), float(lens.fy), float(lens.cx), float(lens.cy)),
        size=(int(lens.width), int(lens.height)),
        camera_to_world=rows,
        tracked=bool(view.tracked),
        held_out=held_out,
        depth_shape=(height, width),
        depth_step=step,
        mask_shape=None if mask is None else mask.shape,
    )
    bits = None if mask is None else np.packbits(mask, axis=1)
    return EncodedView(encode_copy(view.load_rgb()), np.round(depth / step).astype("<u2"), bits, head)


def _at_most(image: Any) -> Any:
    """Leave out rows and columns of an image (H,W) that is larger than the archive's."""
    by = -(-max(image.shape) // _DEPTH_SIDE)
    return image[::by, ::by]


def _read_view(folder: Path, number: int, view: ArchivedView, head_file: str) -> TextureView:
    pose = np.array([*view.camera_to_world, (0.0, 0.0, 0.0, 1.0)])
    if not np.abs(pose[:3, :3] @ pose[:3, :3].T - np.eye(3)).max() < _UNIT or np.linalg.det(pose[:3, :3]) < 0:
        raise invalid(f"the pose of view {number} is no rotation", head_file)
    name = _picture_name(number)
    path = folder / name
    if path.stat().st_size > _MOST_PICTURE_BYTES:
        raise invalid(f"has more than {_MOST_PICTURE_BYTES:,} bytes", name)
    with path.open("rb") as file:
        size = header_size(file.read(_JPEG_HEAD_BYTES))
    if size is None or not 0 < min(size) <= max(size) <= COPY_PX:
        raise invalid(f"is no picture of at most {COPY_PX} x {COPY_PX} pixels", name)
    steps = read_array(folder / _depth_name(number), np.dtype("<u2"), view.depth_shape)
    mask = _read_mask(folder / _mask_name(number), view.mask_shape) if view.mask_shape else None
    return TextureView(
        Intrinsics(*view.camera, *view.size),
        pose,
        PhotoPixels(path.read_bytes, name, "opencv", size, 0),
        lambda: np.asarray(steps * np.float32(view.depth_step), np.float32),
        view.name,
        tracked=view.tracked,
        load_mask=None if mask is None else lambda: mask,
    )


def _read_mask(path: Path, shape: tuple[int, int]) -> Bools:
    height, width = shape
    bits = read_array(path, np.dtype("|u1"), (height, -(-width // 8)))
    return np.unpackbits(bits, axis=1, count=width).astype(bool)


def _picture_name(number: int) -> str:
    return f"view-{number}.picture"


def _depth_name(number: int) -> str:
    return f"view-{number}.depth"


def _mask_name(number: int) -> str:
    return f"view-{number}.mask"
