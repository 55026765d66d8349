"""Draw how far meshes lie from the truth as colours: a picture of columns, a GLB with a bar that tells the scale."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import trimesh

from capture2vr.edge.arrays import Bytes, Floats
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.render.renderer import RenderMesh, place_cameras, render_view
from capture2vr.edge.srgb import to_srgb
from tests.support.mesh_metrics import distances_to

WORST = 0.01  # unit frame: what lies farther has the last colour
_COLOURS = np.array([[30, 70, 210], [40, 190, 220], [95, 210, 90], [250, 225, 50], [255, 25, 15]])
"""sRGB from 0 to WORST. The last is bright: a dark one would look like a shadow."""
_PLAIN = (196, 196, 200)  # sRGB of what has no error: the truth, the points
_SIZE = 460  # pixels of a view's side
_DOT = 0.004  # radius of a drawn point, unit frame
_APART = 1.25  # between the meshes of a GLB, in longest sides
_BAR = (0.06, 1.0, 60)  # width and height of the bar in longest sides, and its steps


@dataclass(frozen=True, slots=True)
class View:
    """Where the camera stands: degrees about Y from +Z towards +X, and above the floor."""

    azimuth: float = 25.0
    elevation: float = 15.0


@dataclass(frozen=True, slots=True)
class Column:
    """A mesh in its colours, what it is called, and the figures under it; no mesh: the words stand in its place."""

    title: str
    caption: str
    mesh: Mesh | None


def coloured(mesh: Mesh, truth: Mesh) -> Mesh:
    """The mesh with the colour of its vertices' distance from the truth."""
    return replace(mesh, rgb=colours_of(distances_to(truth, mesh.vertices)))


def colours_of(distances: Floats) -> Bytes:
    """(n,3) sRGB colours of distances (n,)."""
    place = np.clip(distances / WORST, 0, 1) * (len(_COLOURS) - 1)
    channels = [np.interp(place, range(len(_COLOURS)), channel) for channel in _COLOURS.T]
    colours: Bytes = np.stack(channels, axis=-1).round().astype(np.uint8)
    return colours


def plain(mesh: Mesh) -> Mesh:
    """The mesh in light grey."""
    return replace(mesh, rgb=np.tile(np.array(_PLAIN, np.uint8), (len(mesh.vertices), 1)))


def dots(points: Floats) -> Mesh:
    """Points (n,3) as small octahedra, in light grey."""
    corners = _DOT * np.concatenate([np.eye(3), -np.eye(3)])
    faces = np.array([[0, 1, 2], [1, 3, 2], [3, 4, 2], [4, 0, 2], [1, 0, 5], [3, 1, 5], [4, 3, 5], [0, 4, 5]])
    vertices = (points[:, None] + corners[None]).reshape(-1, 3)
    return plain(Mesh(vertices, (faces[None] + 6 * np.arange(len(points))[:, None, None]).reshape(-1, 3)))


def draw(rows: Sequence[Sequence[Column]], view: View, path: Path) -> None:
    """Write a PNG: a line of views for each row, with the scale of the colours beside them."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    width = max(len(row) for row in rows)
    figure, grid = plt.subplots(
        len(rows), width, figsize=(2.7 * width + 0.8, 3.2 * len(rows)), layout="constrained", squeeze=False
    )
    for axes, row in zip(grid, rows, strict=True):
        for axis, column in zip(axes, row, strict=False):
            axis.axis("off")
            axis.set_title(column.title, fontsize=9)
            white = np.full((_SIZE, _SIZE, 3), 255, np.uint8)
            axis.imshow(white if column.mesh is None else _rendered(column.mesh, view))
            height = 0.5 if column.mesh is None else -0.02
            axis.text(0.5, height, column.caption, ha="center", va="top", fontsize=8, transform=axis.transAxes)
    scale = mpl.colors.LinearSegmentedColormap.from_list("error", _COLOURS / 255)
    shown = mpl.cm.ScalarMappable(mpl.colors.Normalize(0, WORST), scale)
    figure.colorbar(shown, ax=grid, shrink=0.8, extend="max", label="distance from the truth, longest side 1")
    figure.savefig(path, dpi=100, pil_kwargs={"optimize": True})
    plt.close(figure)


def write_glb(columns: Sequence[Column], path: Path) -> None:
    """Write all meshes of a row side by side, and at their right the bar from 0 (below) to WORST (above).

    Every node is named by its column; notches and numbers stand at quarters of the bar, in the unit frame.
    """
    scene = trimesh.Scene()
    shown = [column for column in columns if column.mesh is not None]
    for number, column in enumerate(shown):
        assert column.mesh is not None
        _add(scene, column.mesh, column.title, (number * _APART, 0.0, 0.0))
    for name, mesh in bar().items():
        _add(scene, mesh, name, (len(shown) * _APART - 0.5, -0.5, 0.0))
    scene.export(path)


def bar() -> dict[str, Mesh]:
    """The bar of the scale and its numbers, by the names of their nodes; the bar's foot is at the origin."""
    width, height, steps = _BAR
    y = np.linspace(0, height, steps)
    left, right = np.zeros(steps), np.full(steps, width)
    vertices = np.concatenate([np.stack([x, y, 0 * y], axis=1) for x in (left, right)])
    low = np.arange(steps - 1)
    faces = np.concatenate(
        [np.stack([low, steps + low, low + 1], axis=1), np.stack([steps + low, steps + low + 1, low + 1], axis=1)]
    )
    parts = {"scale": Mesh(vertices, faces, np.tile(colours_of(WORST * y / height), (2, 1)))}
    for quarter in range(5):
        text = f"{WORST * quarter / 4:g}"
        parts[f"{text} of the longest side"] = _number(text, at=(1.6 * width, height * quarter / 4))
    return parts


# Segments of a digit: from (x,y) to (x,y), in a box of 1 by 2.
_SEGMENTS = {
    "a": ((0, 2), (1, 2)),
    "b": ((1, 2), (1, 1)),
    "c": ((1, 1), (1, 0)),
    "d": ((0, 0), (1, 0)),
    "e": ((0, 0), (0, 1)),
    "f": ((0, 1), (0, 2)),
    "g": ((0, 1), (1, 1)),
    ".": ((0.4, 0), (0.6, 0)),
}
_DIGITS = {
    "0": "abcdef",
    "1": "bc",
    "2": "abged",
    "3": "abgcd",
    "4": "fgbc",
    "5": "afgcd",
    "6": "afgedc",
    "7": "abc",
    "8": "abcdefg",
    "9": "abcdfg",
    ".": ".",
}
_HIGH = 0.05  # of a digit, in longest sides


def _number(text: str, at: tuple[float, float]) -> Mesh:
    """A number as flat strokes, its middle at the height of `at`."""
    boxes = []
    for place, digit in enumerate(text):
        for segment in _DIGITS[digit]:
            ends = np.array(_SEGMENTS[segment], float) + np.array([1.6 * place, -1.0])
            low, high = ends.min(axis=0) - 0.12, ends.max(axis=0) + 0.12
            boxes.append([[low[0], low[1]], [high[0], low[1]], [high[0], high[1]], [low[0], high[1]]])
    corners = np.array(boxes).reshape(-1, 2) * _HIGH / 2 + at
    first = 4 * np.arange(len(boxes))[:, None, None]
    faces = (np.array([[0, 1, 2], [0, 2, 3]])[None] + first).reshape(-1, 3)
    return plain(Mesh(np.column_stack([corners, np.zeros(len(corners))]), faces))


def _add(scene: trimesh.Scene, mesh: Mesh, name: str, at: tuple[float, float, float]) -> None:
    part = trimesh.Trimesh(mesh.vertices + np.array(at), mesh.faces, vertex_colors=mesh.rgb, process=False)
    scene.add_geometry(part, node_name=name, geom_name=name)


def _rendered(mesh: Mesh, view: View) -> Bytes:
    """(size,size,3) uint8 sRGB on white."""
    subject = RenderMesh.of(mesh, _SIZE)
    (camera,) = place_cameras(subject, (view.azimuth,), view.elevation)
    seen = render_view(subject, camera, _SIZE)
    return to_srgb(seen.light + (1 - seen.cover))
