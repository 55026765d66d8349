"""Ask the photos about an asset: what may be filled in, and how it compares with those that were held out for this."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from capture2vr.edge.arrays import Bools, Floats, evenly
from capture2vr.edge.mesh.clean import SPECK
from capture2vr.edge.mesh.fill_gaps import FilledMesh, fill_gaps
from capture2vr.edge.mesh.nouns import Mesh, TexturedMesh
from capture2vr.edge.mesh.pieces import Piece, SplitMesh, list_pieces
from capture2vr.edge.mesh.spacing import point_spacing
from capture2vr.edge.mesh.topology import compact
from capture2vr.edge.mesh.trim_rims import trim_rims
from capture2vr.edge.points.nouns import Points, UnitFrame
from capture2vr.edge.render.free_space import ColouredSurface, ask_views
from capture2vr.edge.render.marked_picture import marked_jpeg
from capture2vr.edge.render.photo_comparison import (
    LikenessCheck,
    PhotoFigures,
    SurfaceCheck,
    check_likeness,
    check_surface,
    mean_figures,
    worst_photo,
)
from capture2vr.edge.render.piece_support import piece_support
from capture2vr.edge.render.place_views import in_unit_frame, posed_picture
from capture2vr.edge.render.seen_around import thinness
from capture2vr.edge.render.silhouette import outside_outlines
from capture2vr.order.option_table import Fill
from capture2vr.sentences.sentence import say

_MOST_OUTLINES = 20
"""Photos that are asked for outlines, evenly chosen: each takes a tenth of a second."""
_MOST_OWN = 4
"""Photos that a surface was made from and is compared with, where none could be spared for that."""
_CLOSED = 10.0
"""Spacings from inferred points within which a surface was closed, and has no rims."""
_CONE, _ARC, _BESIDE = 60.0, 120.0, 90.0
"""Degrees between the outermost photos below which they are of one side, and, of an arc, below which; and the least
part of a circle around their mean direction in which there is none of the outer ones, of an arc."""
_FLAT = 0.3
"""Thinness below which what was shot from one side is a relief and no half of an object: a temple's frieze has .16, a
statue before a wall .44, half a toy animal .63."""
_MANY_HOLES = 0.03
"""Share of the thing's silhouette in holes from which on a person notices them at once."""
_MUCH_INSIDE = 0.03
"""The same of pixels that show the inside of the thing through a hole."""
_MUCH_LEAK = 0.03
"""Share of the mesh's pixels beside the thing from which on rims and flying pieces are noticed."""


_SMALL_PIECE = 0.05
"""Share of the area of all pieces: a larger one is kept whatever the photos say, as a pose may be wrong instead."""
_FEWEST_VIEWS = 2
"""Photos that see a piece; one alone confirms nothing."""
_UNLIKE, _UNLIKE_USUAL = 30.0, 2.5
"""sRGB levels by which the photos of a piece differ, and times what those of the largest differ, above which they show
different things: exposure and gloss give 10 to 20."""


@dataclass(frozen=True, slots=True)
class PhotoCheck:
    """A surface compared with photos.

    surface  with those that were held out; empty where the capture could spare none
    own      then with a few of those that it was made from
    scene    whether the surroundings are a part of it, whose borders are where photos end
    apart    degrees from a photo to the next one, as seen from the surface: the median; 0 where there is no other
    one_side degrees that the photos span, as seen from the surface, where they show one side of it only; else 0
    flat     whether that side may be all there is, as of a relief or a picture
    """

    surface: tuple[SurfaceCheck, ...] = ()
    own: tuple[SurfaceCheck, ...] = ()
    scene: bool = False
    apart: float = 0.0
    one_side: float = 0.0
    flat: bool = False

    @property
    def figures(self) -> PhotoFigures | None:
        """Mean figures of the surface, without those of its textures."""
        return mean_figures(self.surface)

    def warnings(self) -> tuple[str, ...]:
        """Sentences about what a person would notice, with the photo that shows it most."""
        figures = self.figures
        if figures is None:
            return ()
        found = []
        if figures.lace > _MANY_HOLES:
            worst = worst_photo(self.surface)
            found.append(say("what_your_photos_show_thing", share=figures.lace, photo=worst.picture.name))
        if figures.inside_out > _MUCH_INSIDE:
            found.append(say("what_seen_inside_thing_through", share=figures.inside_out))
        if figures.leak > _MUCH_LEAK:
            worst = max(self.surface, key=lambda check: check.figures.leak)
            found.append(say("surface_lies_where_your_photos", share=figures.leak, photo=worst.picture.name))
        return tuple(found)


def check_surface_with_photos(mesh_unit: Mesh, points: Points, unit: UnitFrame) -> PhotoCheck:
    """Compare a mesh in the unit frame with the held-out photos of its points, else with a few of the others."""
    held_out, seen_by = in_unit_frame(points.held_out_views, unit), in_unit_frame(points.texture_views, unit)
    scene = points.cut is not None and points.cut.kept == "scene"
    middle = (mesh_unit.vertices.min(axis=0) + mesh_unit.vertices.max(axis=0)) / 2
    towards = np.array([each.eye for each in (*seen_by, *held_out)]).reshape(-1, 3) - middle
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    if held_out:
        check = PhotoCheck(tuple(check_surface(mesh_unit, held_out, seen_by)))
    else:
        check = PhotoCheck(own=tuple(check_surface(mesh_unit, evenly(seen_by, _MOST_OWN), seen_by)))
    one_side = 0.0 if scene else degrees_of_one_side(towards)
    flat = bool(one_side) and thinness(mesh_unit) < _FLAT
    return replace(check, scene=scene, apart=_degrees_apart(towards), one_side=one_side, flat=flat)


def _degrees_apart(towards: Floats) -> float:
    """Median angle between a camera and the next one, by unit vectors (M,3) to them; 0 below two cameras."""
    if len(towards) < 2:
        return 0.0
    chord = cKDTree(towards).query(towards, k=2)[0][:, 1]
    return float(np.degrees(2 * np.arcsin(np.median(chord) / 2)))


def degrees_of_one_side(towards: Floats) -> float:
    """Return the largest angle between two cameras, by unit vectors (M,3) to them, where all are on one side; else 0.

    They are within a narrow cone, or on an arc: around their mean direction there are none on some side. A ring of
    photos from above is no arc.
    """
    if len(towards) < 2:
        return 0.0
    span = float(np.degrees(np.arccos(np.clip((towards @ towards.T).min(), -1, 1))))
    if span < _CONE:
        return span
    if span > _ARC:
        return 0.0
    mean = towards.mean(axis=0) / np.linalg.norm(towards.mean(axis=0))
    across = np.linalg.svd(mean[None])[2][1:]
    outer = towards @ mean < (1 + (towards @ mean).min()) / 2
    turn = np.sort(np.degrees(np.arctan2(*(towards[outer] @ across.T).T)))
    gap = float(np.diff([*turn, turn[0] + 360]).max())
    return span if gap > _BESIDE else 0.0


def trim_rims_with_photos(mesh_unit: Mesh, points: Points, unit: UnitFrame) -> Mesh:
    """Cut off the rims of a mesh in the unit frame that photos show to be background.

    Depth that was matched between photos errs at outlines, by the width of a window; that of a sensor does not. An
    object that was closed has no rims: outlines were asked when points were inferred.
    """
    if points.closed and points.inferred is not None:
        return mesh_unit
    untracked = [view for view in points.texture_views if not view.tracked]
    outside = outside_outlines(mesh_unit, in_unit_frame(evenly(untracked, _MOST_OUTLINES), unit))
    # Outlines were asked when points were inferred: a surface that these close has no rims.
    if points.inferred is not None and outside.any():
        outside[outside] = ~_near_inferred(mesh_unit.vertices[outside], points, unit)
    return trim_rims(mesh_unit, outside)


def _near_inferred(places: Floats, points: Points, unit: UnitFrame) -> Bools:
    """Find the places (N,3) in the unit frame that are near inferred points, which close a surface."""
    xyz = unit.to_unit(points.xyz)
    reach = _CLOSED * float(np.median(point_spacing(xyz)))
    near: Bools = np.isfinite(cKDTree(xyz[points.inferred]).query(places, distance_upper_bound=reach, workers=-1)[0])
    return near


def drop_false_pieces(
    mesh_unit: Mesh, points: Points, unit: UnitFrame, specks: Sequence[float] = ()
) -> tuple[Mesh, tuple[Piece, ...]]:
    """Drop small pieces that fewer than two photos see, or whose colours the photos disagree on.

    mesh_unit  in the unit frame; specks: areas of pieces that were dropped before, because they are too small
    Returns the mesh, and a list of all pieces with the reason for each. Without photos that have depth, all are kept.
    """
    split = SplitMesh.of(mesh_unit)
    largest, whole = int(split.areas.argmax()), float(split.areas.sum())
    small = np.flatnonzero(split.areas < _SMALL_PIECE * whole)
    small = small[small != largest]
    reasons = ["large"] * len(split.areas)
    reasons[largest] = "the largest"
    kept = np.ones(len(split.areas), bool)
    views = (*points.texture_views, *points.held_out_views) if len(small) and points.texture_views else ()
    support = piece_support(split, [largest, *small.tolist()], in_unit_frame(views, unit))
    usual = float(np.nan_to_num(support.unlike[0]))
    for row, number in enumerate(small.tolist(), start=1):
        if support.views[0] < _FEWEST_VIEWS:  # of clouds, and of photos without depth
            reasons[number] = "small, and there are no photos to ask"
            continue
        kept[number], reasons[number] = _judge_piece(int(support.views[row]), float(support.unlike[row]), usual)
    pieces = list_pieces(
        [*split.areas.tolist(), *specks],
        [*kept.tolist(), *[False] * len(specks)],
        [*reasons, *[f"smaller than {SPECK:.0f} squared point spacings"] * len(specks)],
    )
    return (mesh_unit if kept.all() else compact(mesh_unit, kept[split.piece])), pieces


def _judge_piece(views: int, unlike: float, usual: float) -> tuple[bool, str]:
    """Return whether a small piece is kept, and why.

    views   photos that see it; unlike, usual: sRGB levels by which they differ in its colours, and the largest piece's
    """
    if views < _FEWEST_VIEWS:
        return False, "only one photo sees it" if views else "no photo sees it"
    if unlike > max(_UNLIKE, _UNLIKE_USUAL * usual):
        return False, "the photos that see it disagree on its colours"
    return True, "two photos or more see it alike"


def fill_gaps_with_photos(mesh_unit: Mesh, points: Points, unit: UnitFrame, fill: Fill) -> FilledMesh:
    """Fill holes of a mesh in the unit frame that the photos of its points do not see through."""
    if fill == "none":
        return FilledMesh.unfilled(mesh_unit)
    pictures = in_unit_frame(points.texture_views, unit)
    surface = None if points.rgb is None else ColouredSurface(unit.to_unit(points.xyz), points.rgb)
    return fill_gaps(mesh_unit, fill, ask_views(pictures, surface), closed=points.closed)


def check_textures_with_photos(
    finest: Mesh | TexturedMesh, check: PhotoCheck, points: Points, to_asset: Floats
) -> list[LikenessCheck]:
    """Compare the renderings of the finest level with the held-out photos, where the check saw the thing."""
    if isinstance(finest, Mesh) and finest.rgb is None:
        return []
    views = {id(view.load_rgb): view for view in points.held_out_views}
    photos = [posed_picture(views[id(each.picture.load_rgb)], to_asset) for each in check.surface]
    return check_likeness(finest, photos, [each.thing for each in check.surface])


def figures_with_textures(check: PhotoCheck, likeness: Sequence[LikenessCheck]) -> PhotoFigures | None:
    """Mean figures of surface and textures."""
    return mean_figures(check.surface, likeness)


def marked_pictures(check: PhotoCheck, likeness: Sequence[LikenessCheck]) -> dict[str, bytes]:
    """Encode each held-out photo beside its rendering, with holes marked: JPEG by file name."""
    pairs: list[LikenessCheck | None] = [*likeness] or [None] * len(check.surface)
    return {
        f"photo-{number}.jpg": marked_jpeg(each, pair)
        for number, (each, pair) in enumerate(zip(check.surface, pairs, strict=True), 1)
    }
