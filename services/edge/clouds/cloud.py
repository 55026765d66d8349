"""Detect, read and validate files of point clouds and of meshes; points are sampled on the surface of a mesh."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from capture2vr.edge.arrays import Floats
from capture2vr.edge.capture.files import Folder, unreadable
from capture2vr.edge.capture.nouns import Capture, Cloud, CloudParts, ScaleConfidence
from capture2vr.edge.capture.units import are_degrees
from capture2vr.edge.clouds.cloud_parts import (
    MAX_BAD_SHARE,
    MAX_COORDINATE,
    dropped_warnings,
    first_places,
    projected,
    projected_parts,
    read_some,
    returned,
    valid_mask,
)
from capture2vr.edge.clouds.cloud_process import georeferenced_origin, moved_warning
from capture2vr.edge.clouds.cloud_shape import check_shape
from capture2vr.edge.clouds.meshes import is_binary_stl, read_mesh
from capture2vr.edge.clouds.obj import read_obj
from capture2vr.edge.clouds.pcd import read_pcd
from capture2vr.edge.clouds.ply import PlyFile, ply_parts, read_ply
from capture2vr.edge.clouds.raw_parts import RawParts
from capture2vr.edge.clouds.sample_surface import ColourAt, SampledSurface, sample_surfaces
from capture2vr.edge.clouds.stated_reference import GUESSED_DEGREES, StatedReference, stated_reference
from capture2vr.edge.clouds.surface_colours import face_colours, vertex_colours
from capture2vr.edge.clouds.table_text import decode_head
from capture2vr.edge.clouds.tables import MAX_POINTS, looks_numeric, npy_parts, read_npy, read_table, too_many_points
from capture2vr.edge.errors import CaptureError
from capture2vr.edge.geodesy.place_on_earth import survey_up
from capture2vr.order.reading import TableColumns
from capture2vr.sentences.sentence import say

MAX_PARTED_BYTES = 2**33  # of a file that is read in parts
MAX_BYTES = 2**31  # of a file: 20 million points of 100 bytes
_MAX_BYTES = {
    "obj": 2**28,
    "off": 2**28,
    "xyz": 2**30,
}  # of text formats, which need many times their size to be parsed
SNIFF_BYTES = 2**16  # read of a file to detect its format
_FAR_OFF = 100.0  # of a cloud's extent from the origin: below it float32 is exact to a hundred thousandth of that
_SAMPLE = 100_000  # points used for the principal extents; fast also for a cloud of 20 million

UP_Y = (0.0, 1.0, 0.0)
UP_Z = (0.0, 0.0, 1.0)


@dataclass(frozen=True, slots=True)
class _Frame:
    """Scale and up axis that a file format guarantees for its coordinates."""

    scale: ScaleConfidence = "unknown"
    up: tuple[float, float, float] | None = None


_FRAMES = {
    "glb": _Frame("metric", UP_Y),  # glTF 2.0, section 3.4: metres, Y up
    "gltf": _Frame("metric", UP_Y),
    "e57": _Frame("metric", UP_Z),  # ASTM E2807: metres; scanners level themselves
    "ptx": _Frame("metric", UP_Z),  # Leica's description of it: metres, levelled as the scanner was
    "las": _Frame("estimated", UP_Z),  # usually metres, where no coordinate reference system says another unit
}
_MESHES = ("off", "stl", "glb", "gltf")


def format_by_head(head: bytes, size: int, name: str) -> str | None:
    """Detect the format of a file of `size` bytes by the SNIFF_BYTES at its beginning: ply, pcd, npy, las, e57, one of
    a mesh, xyz, or None."""
    magic = _by_magic(head)
    if magic is None and is_binary_stl(head, size, named=name.lower().endswith(".stl")):
        return "stl"
    if magic is None and name.lower().endswith(".gltf") and head.lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"{"):
        return "gltf"  # what tells it may come behind megabytes of a buffer
    return magic or _by_text(head)


def _by_magic(head: bytes) -> str | None:
    """Return the format that a magic number or a PCD header identifies, or None."""
    if re.match(rb"ply[ \t]*\r?\n", head):
        return "ply"
    for magic, name in ((b"\x93NUMPY", "npy"), (b"LASF", "las"), (b"ASTM-E57", "e57"), (b"glTF", "glb")):
        if head.startswith(magic):
            return name
    if re.search(rb"^FIELDS\b", head[:2048], re.M) and re.search(rb"^(VERSION|SIZE|WIDTH|DATA)\b", head[:2048], re.M):
        return "pcd"
    return "pcd" if head.startswith(b"# .PCD") else None


def _by_text(head: bytes) -> str | None:
    """Return the text format (gltf, off, stl, obj, xyz) that the first bytes look like, or None."""
    text = decode_head(head)
    if "\0" in text or text.count("�") > len(text) // 100:
        return None
    start = text.lstrip()
    if start.startswith("{"):
        return "gltf" if re.search(r'"asset"\s*:', text) and '"version"' in text else None
    if re.match(r"(ST)?C?N?4?OFF\b", start):
        return "off"
    if re.match("solid", start, re.I) and re.search("facet", text, re.I):
        return "stl"
    if re.search(r"^[ \t]*v[ \t]+[-+.\d]\S*[ \t]+[-+.\d]\S*[ \t]+[-+.\dna]", text, re.M | re.I):
        return "obj"
    return "xyz" if looks_numeric(text[: text.rfind("\n")] if len(head) == SNIFF_BYTES else text) else None


def read_cloud(folder: Folder, name: str, kind: str) -> Capture:
    """Read a point cloud or mesh file of format `kind`, validate it, and return a capture of kind "points".

    Of a cloud of more than LARGE points some are read now, and all of them in parts when they are asked for.
    """
    reading = folder.reading
    if reading.columns and kind != "xyz":
        raise unreadable(name, say("columns_are_of_tables"), say("leave_columns_out"))
    asked = stated = stated_reference(folder, name, kind)
    if (parts := _parts(folder, name, kind)) is not None:
        if stated.in_degrees and not reading.unit:
            stated = stated.fitting(first_places(parts, name))
        parts, crs = projected_parts(parts, name, stated.crs) if stated.in_degrees else (parts, stated.crs)
        some, whole, warnings = read_some(parts, name, folder.tick)
        read = _capture(kind, name, replace(some, crs=crs), warnings, whole)
    else:
        rows = _read_rows(folder, name, stated) if kind == "xyz" else (*_read(folder, name, kind), stated)
        cloud, warnings, asked = rows
        stated = asked if reading.unit else asked.fitting(cloud.xyz)
        cloud = projected(cloud, stated.crs) if stated.in_degrees else replace(cloud, crs=stated.crs)
        read = capture_of_cloud(cloud, name, kind, warnings)
    if reading.unit:
        return read
    read = replace(read, warnings=(*_about_degrees(asked, stated, name), *read.warnings))
    return read if stated.metres is None else replace(read, metres_per_unit=stated.metres, scale_confidence="metric")


def _about_degrees(asked: StatedReference, used: StatedReference, name: str) -> tuple[str, ...]:
    """Say what became of the degrees that a file states."""
    if used.in_degrees:
        return () if used.guessed else (say("degrees_were_projected", file=name),)
    return (say("degrees_are_none", file=name),) if asked.in_degrees else ()


def _read_rows(folder: Folder, name: str, stated: StatedReference) -> tuple[Cloud, tuple[str, ...], StatedReference]:
    """Read a table of numbers; also return what it states of its coordinates, with the unit that its header names."""
    path, reading = folder.path(name), folder.reading
    _check_size(path, name, "xyz")
    told = TableColumns.parse(reading.columns) if reading.columns else None
    cloud, warnings, columns = read_table(path, name, told)
    if columns.metres is not None and not reading.unit:
        return cloud, warnings, stated.in_unit_of(columns.metres, degrees=columns.degrees)
    if not reading.unit and stated.units is None and are_degrees(cloud.xyz):
        return cloud, (*warnings, say("doubt_degrees")), GUESSED_DEGREES
    return cloud, warnings, stated


def capture_of_cloud(cloud: Cloud, name: str, kind: str, warnings: tuple[str, ...] = ()) -> Capture:
    """Validate a point cloud, and return a capture of kind "points".

    name  of its file, for errors; kind: its format. Raises CaptureError for too many or too few points, for points on a
    line, and where many are not finite.
    """
    if len(cloud.xyz) > MAX_POINTS:
        raise too_many_points(len(cloud.xyz), name)
    (xyz,), origin, moved = _near_origin([returned(cloud.xyz)], name)
    cloud, dropped = _drop_invalid(replace(cloud, xyz=xyz, origin=cloud.origin if origin is None else origin), name)
    return _capture(kind, name, cloud, (*warnings, *moved, *dropped))


def _parts(folder: Folder, name: str, kind: str) -> RawParts | None:
    """The points of a large file in parts; None where it is not large, or of a format that is read at once."""
    path = folder.path(name)
    if kind not in ("las", "e57", "ply", "npy"):
        return None
    if path.stat().st_size > MAX_PARTED_BYTES:
        raise _too_many_bytes(name, kind, MAX_PARTED_BYTES)
    if kind == "las":
        from capture2vr.edge.clouds.las import las_parts

        return las_parts(path, name, folder.tick)
    if kind == "e57":
        from capture2vr.edge.clouds.e57 import e57_parts

        return e57_parts(path, name, folder.tick)
    return ply_parts(path, name) if kind == "ply" else npy_parts(path, name)


def _capture(kind: str, name: str, cloud: Cloud, warnings: tuple[str, ...], whole: CloudParts | None = None) -> Capture:
    """Return the capture of a cloud whose points are valid, in the frame of its format. Raises CAPTURE_DEGENERATE."""
    check_shape(cloud.xyz, name)
    warnings += tuple(say("file_note", file=name, note=note) for note in cloud.notes)
    frame = _FRAMES.get(kind, _Frame())
    up = np.array(UP_Y) if frame.up == UP_Y else survey_up(cloud.origin, cloud.crs)
    up = np.array(frame.up) if up is None and frame.up else up
    return Capture("points", kind, cloud=cloud, whole=whole, scale_confidence=frame.scale, up=up, warnings=warnings)


def _too_many_bytes(name: str, kind: str, limit: int) -> CaptureError:
    what = say("larger_than_mib_most_read", size=limit // 2**20, kind=kind.upper())
    hint = say("downsample_point_cloud_simplify_mesh")
    return CaptureError("CAPTURE_TOO_LARGE", what, file=name, hints=(hint,))


def _read(folder: Folder, name: str, kind: str) -> tuple[Cloud, tuple[str, ...]]:
    """Read one file of format `kind`: its points, or points sampled on its triangles, and warnings."""
    path = folder.path(name)
    _check_size(path, name, kind)
    if kind == "e57":
        from capture2vr.edge.clouds.e57 import read_e57

        return read_e57(path, name, folder.tick)
    if kind == "las":
        from capture2vr.edge.clouds.las import read_las

        return read_las(path, name, folder.tick)
    if kind == "ply":
        read = read_ply(path, name)
        used = np.count_nonzero(np.bincount(read.faces.reshape(-1)))
        if len(read.faces) == 0 or 2 * used < len(read.cloud.xyz):  # a cloud with a few stray faces is not a mesh
            return read.cloud, read.warnings
        surface = SampledSurface(read.cloud.xyz, read.faces, _ply_colours(read))
        sampled, dropped = _sample_mesh([surface], name)
        return sampled, (*read.warnings, *dropped)
    if kind == "obj":
        obj = read_obj(folder, name)
        if obj.surface is None:
            return obj.vertices, ()
        sampled, dropped = _sample_mesh([obj.surface], name)
        return sampled, (*obj.warnings, *dropped)
    if kind in _MESHES:
        mesh = read_mesh(folder, name, kind)
        if mesh.points is not None:
            return mesh.points, mesh.warnings
        if not mesh.surfaces:
            raise CaptureError(
                "CAPTURE_EMPTY", say("mesh_without_triangles"), file=name, hints=(say("export_mesh_again"),)
            )
        sampled, dropped = _sample_mesh(mesh.surfaces, name)
        return sampled, (*mesh.warnings, *dropped)
    return {"pcd": read_pcd, "npy": read_npy}[kind](path, name), ()


def _check_size(path: Path, name: str, kind: str) -> None:
    """Raise CAPTURE_TOO_LARGE for a file of more bytes than are read of its format."""
    limit = _MAX_BYTES.get(kind, MAX_BYTES)
    if path.stat().st_size > limit:
        raise _too_many_bytes(name, kind, limit)


def _ply_colours(read: PlyFile) -> ColourAt | None:
    """Return the colours of a mesh: those of its vertices, else of its faces, if it has any."""
    if read.cloud.rgb is not None:
        return vertex_colours(read.cloud.rgb, read.faces)
    return None if read.face_rgb is None else face_colours(read.face_rgb)


def _sample_mesh(surfaces: list[SampledSurface], name: str) -> tuple[Cloud, tuple[str, ...]]:
    """Sample points on the surfaces, after validating the vertices, so that errors are about the file's vertices."""
    if (count := sum(len(surface.vertices) for surface in surfaces)) > 3 * MAX_POINTS:
        raise too_many_points(count, name)
    near, origin, moved = _near_origin([surface.vertices for surface in surfaces], name)
    surfaces = [replace(surface, vertices=vertices) for surface, vertices in zip(surfaces, near, strict=True)]
    cloud, dropped = _drop_invalid(Cloud(np.concatenate(near)), name)
    if (cloud.xyz == cloud.xyz[0]).all():
        raise CaptureError("CAPTURE_DEGENERATE", say("has_all_vertices_same_position"), file=name)
    keep = [replace(surface, vertices=np.where(valid_mask(surface.vertices)[:, None], surface.vertices, np.nan))
            for surface in surfaces]  # fmt: skip
    return replace(sample_surfaces(keep, name), origin=origin), (*moved, *dropped)


def _near_origin(parts: Sequence[Floats], name: str) -> tuple[list[Floats], Floats | None, tuple[str, ...]]:
    """Move georeferenced coordinates, parts of (N,3), near the origin, as float32 has steps of 3 cm at 500 km.

    Returns them, what was subtracted, and a warning of it.

    A few points that are far away do not make coordinates georeferenced, nor do they say where the others are.
    """
    some = np.concatenate([part[:: max(1, len(part) // _SAMPLE)] for part in parts])
    some = some[np.isfinite(some).all(axis=1)]
    if len(some) == 0:
        return list(parts), None, ()
    low, high = np.quantile(some, (MAX_BAD_SHARE, 1 - MAX_BAD_SHARE), axis=0)
    origin, farthest = georeferenced_origin(low, high), float(np.abs([low, high]).max())
    # A house in millimetres reaches as far from the origin, and stays where it is.
    if origin is None or farthest < min(MAX_COORDINATE, _FAR_OFF * float((high - low).max())):
        return list(parts), None, ()
    return [np.asarray(part, np.float64) - origin for part in parts], origin, (moved_warning(origin, name),)


def _drop_invalid(cloud: Cloud, name: str) -> tuple[Cloud, tuple[str, ...]]:
    """Remove invalid points; return the cloud and a warning. Raises CAPTURE_NOT_FINITE as `dropped_warnings`."""
    warnings = dropped_warnings(cloud.xyz, name)
    return cloud.subset(valid_mask(cloud.xyz)) if warnings else cloud, warnings
