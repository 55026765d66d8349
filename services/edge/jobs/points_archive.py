"""Zip archive of prepared points, which one worker makes and another fits a field to. All of it is checked when read.

points.json     format version, and everything that is not an array
xyz.npy         (N,3) float64 capture frame
rgb.npy         (N,3) uint8 sRGB, absent where the capture has no colours
confidence.npy  (N,) float32
origin.npy      (N,) uint8, as edge/origin.py, absent where all points are measured
whole.bin       all points of a large scene, of which the others are some: records of archived_whole.py
view-N.picture  JPEG, for the textures, or to compare with, at most `COPY_PX` pixels on its longer side
view-N.depth    .npy, (H,W) uint16, its depth in steps that points.json has; 0 where unknown
view-N.mask     .npy, (H,⌈W/8⌉) uint8, a bit for each pixel that shows the object; absent without a mask

Nothing else is compressed: coordinates hardly deflate, and the link between two workers is fast.
"""

from __future__ import annotations

import json
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import ConfigDict, Field, TypeAdapter, ValidationError

from capture2vr.edge.arrays import Floats
from capture2vr.edge.capture.facts import CaptureFacts
from capture2vr.edge.capture.nouns import PictureCamera, ScaleConfidence, UpSource
from capture2vr.edge.capture_to_points import PreparedPoints
from capture2vr.edge.geodesy.well_known_text import MOST_CHARACTERS, tidy
from capture2vr.edge.jobs.archived_arrays import invalid, read_array, write_array
from capture2vr.edge.jobs.archived_views import (
    MOST_VIEWS,
    VIEW_BYTES,
    VIEW_FILES,
    ArchivedView,
    encode_views,
    read_views,
    view_files,
    write_views,
)
from capture2vr.edge.jobs.archived_whole import MOST_WHOLE, RECORD, WHOLE, ArchivedWhole, read_whole, write_whole
from capture2vr.edge.models.nouns import UsedModel
from capture2vr.edge.origin import MEASURED, NAMES, PROPOSED
from capture2vr.edge.points.clean_cloud import MIN_POINTS
from capture2vr.edge.points.nouns import CutReport, Points, UnseenSide
from capture2vr.edge.worker.capabilities import POINTS_VERSION
from capture2vr.order.edits import Edits
from capture2vr.process.archives import ArchiveError, ArchiveLimits, unpack
from capture2vr.process.atomic_write import atomic_write
from capture2vr.sentences.documents import restored, with_codes, with_sentences

MOST_POINTS = 4_000_000
"""Most points that are read: more than twice what fusing and cleaning ever leave; 124 MB of arrays."""

MOST_CAMERAS = 2_000
"""Most cameras of photos that are sent along: for downloads alone, so those of further photos are left out."""

MOST_MODELS = 16
"""Most learned models that may have had a part in a cloud."""

_HEAD, _XYZ, _RGB, _CONFIDENCE, _ORIGIN = "points.json", "xyz.npy", "rgb.npy", "confidence.npy", "origin.npy"
_HEAD_BYTES = 4 << 20  # 300 photos with advice for each take 100 kB, 2,000 cameras 1 MB
_POINT_BYTES = 24 + 3 + 4 + 1  # xyz, rgb, confidence, origin
_LIMITS = ArchiveLimits(
    entries=6 + VIEW_FILES * MOST_VIEWS,
    total_bytes=_HEAD_BYTES
    + (MOST_POINTS * _POINT_BYTES + 4 * 1024)
    + (MOST_VIEWS * VIEW_BYTES + MOST_WHOLE * RECORD.itemsize),
)
_FARTHEST = 1e12  # capture units from the origin: a squared distance stays far from overflowing
_UNIT = 0.01  # tolerance of a length or a share of 1: some are rounded to three digits

Stage = Literal["ALIGNING", "POINT_CLOUD"]
_Vector = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class _Head:
    """Content of points.json."""

    version: int
    points: Annotated[int, Field(ge=MIN_POINTS, le=MOST_POINTS)]
    coloured: bool
    completed: bool
    closed: bool
    metres_per_unit: Annotated[float, Field(gt=0)]
    scale_confidence: ScaleConfidence
    scale_by_model: bool
    up: _Vector | None
    up_source: UpSource | None
    offset: _Vector | None
    crs: Annotated[str, Field(max_length=MOST_CHARACTERS)]
    models: Annotated[tuple[UsedModel, ...], Field(max_length=MOST_MODELS)]
    warnings: tuple[str, ...]
    unseen: tuple[UnseenSide, ...]
    cut: CutReport | None
    whole: ArchivedWhole | None
    views: Annotated[tuple[ArchivedView, ...], Field(max_length=MOST_VIEWS)]
    edits: Edits
    cameras: Annotated[tuple[PictureCamera, ...], Field(max_length=MOST_CAMERAS)]
    source: CaptureFacts
    seconds: dict[Stage, Annotated[float, Field(ge=0)]]

    __pydantic_config__ = ConfigDict(extra="forbid", allow_inf_nan=False)


_HEADS = TypeAdapter(_Head)


def write_prepared(prepared: PreparedPoints, archive: Path) -> None:
    """Write the zip atomically. Raises OSError where it cannot be written, CaptureError for a broken picture."""
    archive.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
    points = prepared.points
    rows = {_XYZ: points.xyz, _CONFIDENCE: points.confidence, _RGB: points.rgb, _ORIGIN: points.origin}
    arrays = {name: array for name, array in rows.items() if array is not None}
    views = encode_views(points)
    with atomic_write(archive) as part, zipfile.ZipFile(part, "w", zipfile.ZIP_STORED) as packed:
        for name, array in arrays.items():
            write_array(packed, name, np.ascontiguousarray(array, _array_type(name, len(points))[0]))
        write_views(packed, views)
        whole = None if points.whole is None else write_whole(packed, points.whole, points.xyz.mean(axis=0))
        head = _HEADS.dump_python(_head_of(prepared, tuple(view.head for view in views), whole))
        packed.writestr(_HEAD, json.dumps(with_codes(head)))


def read_prepared(archive: Path, scratch: Path) -> PreparedPoints:
    """Read the points of a zip, which is unpacked into the folder `scratch`; its pictures are read from there later.

    Raises EdgeError POINTS_INVALID, naming the file at fault, for anything that `write_prepared` would not write.
    """
    try:
        unpack(archive, scratch, _LIMITS)
    except ArchiveError as error:
        raise invalid(error.message, error.file) from None
    head = _read_head(scratch / _HEAD)
    _require_files(scratch, _files_of(head))
    seconds = {str(stage): seconds for stage, seconds in head.seconds.items()}
    return PreparedPoints(_read_points(scratch, head), head.source, seconds)


def _files_of(head: _Head) -> set[str]:
    """Return the names of the files that an archive with this head has."""
    optional = ({_RGB} if head.coloured else set()) | ({WHOLE} if head.whole else set())
    optional |= {_ORIGIN} if head.completed else set()
    return {_HEAD, _XYZ, _CONFIDENCE} | view_files(head.views) | optional


def _read_points(scratch: Path, head: _Head) -> Points:
    """Read and check the arrays and pictures of an unpacked archive. Raises EdgeError POINTS_INVALID."""
    xyz, confidence = (_read_array(scratch / name, head.points) for name in (_XYZ, _CONFIDENCE))
    rgb = _read_array(scratch / _RGB, head.points) if head.coloured else None
    origin = _read_array(scratch / _ORIGIN, head.points) if head.completed else None
    _require_cloud(xyz)
    _require_confidences(confidence)
    _require_origins(origin)
    views = read_views(scratch, head.views, _HEAD)
    return Points(
        texture_views=tuple(view for view, each in zip(views, head.views, strict=True) if not each.held_out),
        held_out_views=tuple(view for view, each in zip(views, head.views, strict=True) if each.held_out),
        xyz=xyz,
        rgb=rgb,
        confidence=confidence,
        origin=origin,
        closed=head.closed,
        metres_per_unit=head.metres_per_unit,
        scale_confidence=head.scale_confidence,
        scale_by_model=head.scale_by_model,
        up=_array(head.up),
        warnings=head.warnings,
        unseen=head.unseen,
        up_source=head.up_source,
        offset=_array(head.offset),
        crs=tidy(head.crs),
        models=head.models,
        cut=head.cut,
        edits=head.edits,
        cameras=head.cameras,
        whole=None if head.whole is None else read_whole(scratch / WHOLE, head.whole),
    )


def _head_of(prepared: PreparedPoints, views: tuple[ArchivedView, ...], whole: ArchivedWhole | None) -> _Head:
    points = prepared.points
    seconds: Any = dict(prepared.seconds)
    return _Head(
        version=POINTS_VERSION,
        points=len(points),
        coloured=points.rgb is not None,
        completed=points.origin is not None,
        closed=points.closed,
        metres_per_unit=float(points.metres_per_unit),
        scale_confidence=points.scale_confidence,
        scale_by_model=points.scale_by_model,
        up=_vector(points.up),
        up_source=points.up_source,
        offset=_vector(points.offset),
        crs=points.crs,
        models=points.models,
        warnings=points.warnings,
        unseen=points.unseen,
        cut=points.cut,
        edits=points.edits,
        cameras=points.cameras[:MOST_CAMERAS],
        whole=whole,
        views=views,
        source=prepared.source,
        seconds=seconds,
    )


def _vector(found: Any) -> _Vector | None:
    if found is None:
        return None
    x, y, z = (float(value) for value in found)
    return x, y, z


def _array(vector: _Vector | None) -> Floats | None:
    return None if vector is None else np.array(vector, np.float64)


def _read_head(path: Path) -> _Head:
    """Read and check points.json. Raises EdgeError POINTS_INVALID."""
    if not path.is_file():
        raise invalid("is missing", _HEAD)
    if path.stat().st_size > _HEAD_BYTES:
        raise invalid(f"has more than {_HEAD_BYTES:,} bytes", _HEAD)
    text = path.read_bytes()
    _require_version(text)
    try:
        document = with_sentences(json.loads(text))
        head = restored(_HEADS.validate_json(json.dumps(document), strict=True), document)
    except RecursionError:
        raise invalid("is nested too deeply", _HEAD) from None
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        raise invalid(f"{'.'.join(map(str, first['loc']))}: {first['msg']}", _HEAD) from None
    for direction in ([] if head.up is None else [head.up]) + [each.toward for each in head.unseen]:
        if not abs(np.linalg.norm(direction) - 1) < _UNIT:
            raise invalid(f"the direction {direction} is not of length 1", _HEAD)
    if not all(0 < each.share <= 1 + _UNIT for each in head.unseen):
        raise invalid("the share of an unseen side is not in (0, 1]", _HEAD)
    return head


def _require_version(text: bytes) -> None:
    """Check the version before the other fields: another version may give them another meaning."""
    try:
        head = json.loads(text)
    except (ValueError, RecursionError):
        raise invalid("is not JSON", _HEAD) from None
    version = head.get("version") if isinstance(head, dict) else None
    if version != POINTS_VERSION:
        raise invalid(f"is of version {version!r}; this worker reads {POINTS_VERSION}", _HEAD)


def _require_files(folder: Path, wanted: set[str]) -> None:
    found = {path.relative_to(folder).as_posix() for path in folder.rglob("*")}
    if found != wanted:
        raise invalid(f"the archive holds {', '.join(sorted(found))} instead of {', '.join(sorted(wanted))}")


def _array_type(name: str, count: int) -> tuple[np.dtype[Any], tuple[int, ...]]:
    """The dtype and shape that an array of `count` points must have."""
    kinds = {
        _XYZ: ("<f8", (count, 3)),
        _RGB: ("|u1", (count, 3)),
        _CONFIDENCE: ("<f4", (count,)),
        _ORIGIN: ("|u1", (count,)),
    }
    kind, shape = kinds[name]
    return np.dtype(kind), shape


def _read_array(path: Path, count: int) -> Any:
    return read_array(path, *_array_type(path.name, count))


def _require_cloud(xyz: Any) -> None:
    if not (np.abs(xyz) <= _FARTHEST).all():  # false for NaN
        raise invalid(f"has coordinates that are not finite, or beyond {_FARTHEST:g}", _XYZ)
    if not np.ptp(xyz, axis=0).any():
        raise invalid("has all its points in one place", _XYZ)


def _require_confidences(confidence: Any) -> None:
    if not ((confidence >= 0) & (confidence <= 1)).all():  # false for NaN
        raise invalid("has confidences outside [0, 1]", _CONFIDENCE)


def _require_origins(origin: Any) -> None:
    """Check origins (N,), or None: some points are measured, or, of a guess, all are proposed."""
    if origin is None or (origin == PROPOSED).all():
        return
    if origin.max() >= len(NAMES):
        raise invalid("has origins that there are not", _ORIGIN)
    if (origin == MEASURED).sum() < MIN_POINTS:
        raise invalid("leaves hardly any measured points", _ORIGIN)
