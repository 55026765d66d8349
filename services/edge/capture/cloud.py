"""Point clouds and the surfaces of meshes: which format a file's bytes are, read, and judged fit to reconstruct."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from services.edge.arrays import Bools, Floats
from services.edge.capture.files import Folder, reading, unreadable
from services.edge.capture.meshes import read_mesh, vertex_colours
from services.edge.capture.nouns import Capture, Cloud, ScaleConfidence
from services.edge.capture.pcd import read_pcd
from services.edge.capture.ply import read_ply
from services.edge.capture.surface import Surface, sample
from services.edge.capture.tables import MAX_POINTS, looks_numeric, read_npy, read_table, too_many
from services.edge.errors import CaptureError

MIN_DISTINCT = 100  # points; fewer describe no surface
MAX_COORDINATE = 1e6  # units; beyond it float32 steps are 6 cm, and 1e30 is a broken file
MAX_BAD_SHARE = 0.1  # of the points; fewer are dropped with a warning
MIN_SECOND_EXTENT = 1e-4  # of the first principal extent; below it the points lie on a line
MAX_BYTES = 2**31  # of a file: 20 million points of 100 bytes
_MAX_BYTES = {"obj": 2**28, "off": 2**28, "xyz": 2**30}  # text takes many times its size in memory while it is parsed
_SNIFF_BYTES = 2**16
# Odd, so that each is invertible modulo 2^64; their bits are those of the golden ratio and of the roots of 3 and 5.
_ODD_FACTORS = np.array([0x9E3779B97F4A7C15, 0xBB67AE8584CAA73B, 0x3C6EF372FE94F82B], np.uint64)
_SAMPLE = 100_000  # points that judge degeneracy; enough, and quick for 20 million

UP_Y = (0.0, 1.0, 0.0)
UP_Z = (0.0, 0.0, 1.0)


@dataclass(frozen=True, slots=True)
class _Frame:
    """What a format says about its frame."""

    scale: ScaleConfidence = "unknown"
    up: tuple[float, float, float] | None = None


_FRAMES = {
    "glb": _Frame("metric", UP_Y),  # glTF 2.0, section 3.4: metres, Y up
    "gltf": _Frame("metric", UP_Y),
    "las": _Frame("estimated", UP_Z),  # metres by habit; the coordinate system decides
}
_MESHES = ("obj", "off", "stl", "glb", "gltf")


def cloud_format(folder: Folder, name: str) -> str | None:
    """The format of a file by its bytes: ply, pcd, npy, las, a mesh format, xyz, or None when it is none of these."""
    path = folder.path(name)
    with reading(name, "file"), path.open("rb") as stream:
        head = stream.read(_SNIFF_BYTES)
    magic = _by_magic(head)
    if magic is None and len(head) >= 84 and path.stat().st_size == 84 + 50 * int.from_bytes(head[80:84], "little"):
        return "stl"
    return magic or _by_text(head)


def _by_magic(head: bytes) -> str | None:
    if re.match(rb"ply\r?\n", head):
        return "ply"
    for magic, name in ((b"\x93NUMPY", "npy"), (b"LASF", "las"), (b"glTF", "glb")):
        if head.startswith(magic):
            return name
    if re.search(rb"^FIELDS\b", head[:2048], re.M) and re.search(rb"^(VERSION|SIZE|WIDTH|DATA)\b", head[:2048], re.M):
        return "pcd"
    return "pcd" if head.startswith(b"# .PCD") else None


def _by_text(head: bytes) -> str | None:
    text = head.decode("utf-8-sig", errors="replace")
    if "\0" in text or text.count("�") > len(text) // 100:
        return None
    start = text.lstrip()
    if start.startswith("{"):
        return "gltf" if re.search(r'"asset"\s*:', text) and '"version"' in text else None
    if re.match(r"(ST)?C?N?4?OFF\b", start):
        return "off"
    if start.startswith("solid") and "facet" in text:
        return "stl"
    if re.search(r"^v[ \t]+[-+.\d]\S*[ \t]+[-+.\d]\S*[ \t]+[-+.\dna]", text, re.M | re.I):
        return "obj"
    return "xyz" if looks_numeric(text[: text.rfind("\n")] if len(head) == _SNIFF_BYTES else text) else None


def read_cloud(folder: Folder, name: str, kind: str) -> Capture:
    """A validated capture of kind "points" from one file of format `kind`."""
    cloud, warnings = _read(folder, name, kind)
    if len(cloud.xyz) > MAX_POINTS:
        raise too_many(len(cloud.xyz), name)
    cloud, dropped = _finite(cloud, name)
    _check_shape(cloud.xyz, name)
    frame = _FRAMES.get(kind, _Frame())
    up = None if frame.up is None else np.array(frame.up)
    return Capture("points", kind, cloud=cloud, scale_confidence=frame.scale, up=up, warnings=(*warnings, *dropped))


def _read(folder: Folder, name: str, kind: str) -> tuple[Cloud, tuple[str, ...]]:
    path = folder.path(name)
    limit = _MAX_BYTES.get(kind, MAX_BYTES)
    if path.stat().st_size > limit:
        what = f"is over {limit // 2**20:,} MiB of {kind.upper()}"
        raise CaptureError("CAPTURE_TOO_LARGE", what, file=name, hints=("thin the cloud or the mesh out",))
    if kind == "las":
        from services.edge.capture.las import read_las

        return read_las(path, name)
    if kind == "ply":
        cloud, faces = read_ply(path, name)
        used = np.count_nonzero(np.bincount(faces.reshape(-1)))
        if len(faces) == 0 or 2 * used < len(cloud.xyz):  # a cloud with a few stray faces is no mesh
            return cloud, ()
        colours = None if cloud.rgb is None else vertex_colours(cloud.rgb, faces)
        return _sampled([Surface(cloud.xyz, faces, colours)], name)
    if kind in _MESHES:
        surfaces = read_mesh(folder, name, kind)
        return _sampled(surfaces, name) if surfaces else (_obj_vertices(folder, name, kind), ())
    return {"pcd": read_pcd, "npy": read_npy, "xyz": read_table}[kind](path, name), ()


def _sampled(surfaces: list[Surface], name: str) -> tuple[Cloud, tuple[str, ...]]:
    """Points on the surfaces, after judging the vertices: a mesh without extent has its own, plainer names."""
    vertices = np.concatenate([surface.vertices for surface in surfaces])
    if len(vertices) > 3 * MAX_POINTS:
        raise too_many(len(vertices), name)
    cloud, warnings = _finite(Cloud(vertices), name)
    if (cloud.xyz == cloud.xyz[0]).all():
        raise CaptureError("CAPTURE_DEGENERATE", "has all its vertices in one place", file=name)
    keep = [replace(surface, vertices=np.where(_good(surface.vertices)[:, None], surface.vertices, np.nan))
            for surface in surfaces]  # fmt: skip
    return sample(keep, name), warnings


def _obj_vertices(folder: Folder, name: str, kind: str) -> Cloud:
    """An .obj without faces is a point cloud; any other mesh file without triangles is empty."""
    if kind != "obj":
        raise CaptureError("CAPTURE_EMPTY", "holds no triangles", file=name, hints=("export the mesh again",))
    with reading(name, "OBJ"):
        lines = folder.path(name).read_bytes().decode("latin-1").splitlines()
        rows = [line.split()[1:] for line in lines if line.startswith(("v ", "v\t"))]
        xyz = np.array([row[:3] for row in rows], np.float64)
    if xyz.ndim != 2:
        raise unreadable(name, "has no vertices")
    return Cloud(xyz)


def _good(xyz: Floats) -> Bools:
    """(N,) whether a point is finite and within MAX_COORDINATE."""
    with np.errstate(invalid="ignore"):
        return np.asarray((np.abs(xyz) <= MAX_COORDINATE).all(axis=1))


def _finite(cloud: Cloud, name: str) -> tuple[Cloud, tuple[str, ...]]:
    """The cloud without its bad points, and the warning that says so; CAPTURE_NOT_FINITE above MAX_BAD_SHARE."""
    good = _good(cloud.xyz)
    bad = len(good) - int(good.sum())
    if bad == 0:
        return cloud, ()
    what = f"{bad:,} of {len(good):,} points are not finite or beyond {MAX_COORDINATE:,.0f} units"
    if bad > MAX_BAD_SHARE * len(good):
        raise CaptureError("CAPTURE_NOT_FINITE", what, file=name, hints=("export the capture again, in metres",))
    kept = Cloud(
        cloud.xyz[good],
        None if cloud.rgb is None else cloud.rgb[good],
        None if cloud.normals is None else cloud.normals[good],
    )
    return kept, (f"{name}: {what}; they were dropped",)


def _check_shape(xyz: Floats, name: str) -> None:
    """Raise CAPTURE_TOO_FEW_POINTS or CAPTURE_DEGENERATE for what spans no surface."""
    hint = ("walk around the thing and scan it again",)
    if len(xyz) < MIN_DISTINCT:
        what = f"{len(xyz)} points; at least {MIN_DISTINCT} are needed"
        raise CaptureError("CAPTURE_TOO_FEW_POINTS", what, file=name, hints=hint)
    if (xyz == xyz[0]).all():
        what = f"all {len(xyz):,} points lie in one place"
        raise CaptureError("CAPTURE_DEGENERATE", what, file=name, hints=hint)
    if (distinct := _distinct(xyz)) < MIN_DISTINCT:
        what = f"{distinct} distinct points; at least {MIN_DISTINCT} are needed"
        raise CaptureError("CAPTURE_TOO_FEW_POINTS", what, file=name, hints=hint)
    first, second, _ = _extents(xyz)
    if second < MIN_SECOND_EXTENT * first:
        raise CaptureError("CAPTURE_DEGENERATE", "all points lie on one line", file=name, hints=hint)


def _distinct(xyz: Floats) -> int:
    """How many distinct points there are, counted no further than a sample needs to show MIN_DISTINCT."""
    few = len(np.unique(xyz[:: max(1, len(xyz) // 10_000)], axis=0))
    return few if few >= MIN_DISTINCT or len(xyz) < 10_000 else len(np.unique(_hashed(xyz)))


def _hashed(xyz: Floats) -> NDArray[np.uint64]:
    """(N,) one number for each place: sorting millions of rows takes seconds, sorting numbers a tenth of one.

    Two of a hundred places share a number once in 10^15 captures, which then are told "too few" one place too early.
    """
    bits = (np.ascontiguousarray(xyz, np.float64) + 0.0).view(np.uint64)  # + 0.0 makes 0 of -0
    mixed = bits ^ (bits >> np.uint64(29))  # low bits of a double are often 0, and products only carry upward
    hashed: NDArray[np.uint64] = (mixed * _ODD_FACTORS).sum(axis=1, dtype=np.uint64)
    return hashed


def _extents(xyz: Floats) -> Floats:
    """(3,) standard deviations along the principal axes, the largest first."""
    some = xyz[:: max(1, len(xyz) // _SAMPLE)]
    extents: Floats = np.linalg.svd(some - some.mean(axis=0), compute_uv=False) / np.sqrt(len(some))
    return extents
