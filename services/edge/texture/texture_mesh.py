"""Whether a mesh should carry a picture, how large, and the mesh with it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from services.edge.arrays import Floats, Ints, Tick, no_tick
from services.edge.mesh.bake import bake, blended, jpeg_of, scattered
from services.edge.mesh.band import part_of
from services.edge.mesh.colour import ColouredPoints
from services.edge.mesh.ktx2 import Encode
from services.edge.mesh.metrics import area
from services.edge.mesh.nouns import Mesh, Textured
from services.edge.mesh.simplify import simplify
from services.edge.mesh.unwrap import MOST_FACES, UnwrapError, unwrap
from services.edge.srgb import to_linear, to_srgb
from services.edge.threads import slices

SMALLEST_PX = 64
"""Side of the smallest picture."""

_TEXELS_PER_POINT = 2.0  # on the surface: points lie on no grid, and one texel each would blur them
_FILLED = 0.6  # of a picture lies on the surface: there are gaps between charts and a strip at a side
_NEIGHBOURS = 4  # of a texel: of a print on a truck 4 keep more than the 6 of a vertex (mean error 4.0 against 4.3)
_SAMPLES_PER_VERTEX = 2.0  # with fewer, vertices hold what is known
_LEAST_GAIN = 1.0  # sRGB codes by which light and blended vertices differ on average; below it nobody sees a texture
_PROBES = 20_000  # places at which that is measured
_SMALLER_FROM = 512  # texels along a side: coarser levels halve what is larger
_MANY = 2  # points to a texel, from which on they are averaged rather than the nearest blended
_AT_ONCE = 1 << 18  # texels whose neighbours are looked for together: a second
_PICTURED = 0.7  # of the time of a texel's light goes into photos where there are any
_QUALITY = 88  # of a JPEG
_UNWRAPPED = 0.5  # of the time of a picture of 1024 texels
_BAKED = 0.4  # of the time, where it is packed as KTX2 behind that

PictureLight = Callable[[Floats, Floats, float, Tick], tuple[Floats, Floats]]
"""Places (N,3) on the mesh, unit normals there, and the size of a texel -> (N,3) linear light from photos, (N,) how
sure of it in [0,1]."""


@dataclass(frozen=True, slots=True)
class Palette:
    """What is known of the colours of a thing, in the frame of its mesh.

    points    coloured points on and near the surface
    pictures  what photos show of it, or None
    pixel     side of a photo's pixel on the surface, in units of the mesh; 0 without photos
    """

    points: ColouredPoints
    pictures: PictureLight | None = None
    pixel: float = 0.0

    def samples_on(self, area: float) -> float:
        """How many colours are known of a surface of that area."""
        return max(len(self.points), area / self.pixel**2 if self.pixel else 0.0)

    def light_at(self, places: Floats, normals: Floats, texel: float, tick: Tick = no_tick) -> Floats:
        """(N,3) linear light for texels of that size: the photos' as far as they are sure, else the points'."""
        light, sure = np.zeros((len(places), 3), np.float32), np.zeros(len(places), np.float32)
        if self.pictures is not None:
            light, sure = self.pictures(places, normals, texel, part_of(tick, 0, _PICTURED))
            tick = part_of(tick, _PICTURED, 1)
        unsure = np.flatnonzero(sure < 1)
        if len(unsure):
            known = sure[unsure, None]
            light[unsure] = known * light[unsure] + (1 - known) * self._of_points(places, unsure, texel, tick)
        return light

    def _of_points(self, places: Floats, which: Ints, texel: float, tick: Tick) -> Floats:
        """(K,3) at K of the places: blended over neighbours; where a texel holds many points, their mean."""
        light: Floats = np.zeros((len(places), 3), np.float32)
        count: Ints = np.zeros(len(places), np.int64)
        if _MANY * len(places) <= len(self.points):  # the nearest few alone would be speckled
            light, count = self.points.mean_light(places, texel)
        alone = which[count[which] == 0]
        for part in slices(len(alone), _AT_ONCE):
            light[alone[part]] = self.points.light_at(places[alone[part]], _NEIGHBOURS)
            tick(part.stop / len(alone))
        return light[which]


def side_for(mesh: Mesh, palette: Palette, most: int) -> int:
    """Texels along a side, a power of two of at most `most`, that hold what is known of the colours of a mesh."""
    wanted = np.sqrt(_TEXELS_PER_POINT * palette.samples_on(area(mesh)) / _FILLED)
    return int(np.clip(2 ** np.ceil(np.log2(wanted)), SMALLEST_PX, max(most, SMALLEST_PX)))


def worth_a_picture(mesh: Mesh, palette: Palette) -> bool:
    """Whether a picture would show more of a mesh (with rgb) than its vertices do: more is known, and it differs."""
    if len(mesh.faces) > MOST_FACES or mesh.rgb is None:
        return False
    if palette.samples_on(area(mesh)) < _SAMPLES_PER_VERTEX * len(mesh.vertices):
        return False
    # What photos show is sharper than the points tell: to compare it would mean to load them all.
    return palette.pictures is not None or gain(mesh, palette.points) >= _LEAST_GAIN


def gain(mesh: Mesh, points: ColouredPoints) -> float:
    """Mean difference in sRGB codes between the points' light on a mesh and what its vertices (with rgb) make of it."""
    assert mesh.rgb is not None
    face, weight = scattered(mesh, _PROBES)
    place = blended(mesh.vertices, mesh.faces[face], weight)
    shown = to_srgb(blended(to_linear(mesh.rgb), mesh.faces[face], weight)).astype(np.float64)
    known = to_srgb(points.light_at(place, _NEIGHBOURS)).astype(np.float64)
    return float(np.abs(shown - known).mean())


def textured(
    mesh: Mesh, palette: Palette, *, side: int, encode: Encode | None = None, tick: Tick = no_tick
) -> Textured:
    """The mesh with a picture of side × side texels instead of colours at its vertices, as KTX2 too with an `encode`.

    Raises UnwrapError where the mesh cannot be unwrapped, or into so many charts that its vertices would show as much.
    """
    whole, tick = tick, part_of(tick, 0, _BAKED if encode else 1)
    unwrapped = unwrap(mesh, side=side, tick=part_of(tick, 0, _UNWRAPPED))
    bare = replace(unwrapped.mesh, rgb=None)
    texel = float(np.sqrt(area(mesh) / _FILLED) / side)
    light_at = partial(_light_at, palette, texel)
    picture, covered = bake(bare, unwrapped.uv, light_at, side=side, tick=part_of(tick, _UNWRAPPED, 1))
    if covered < _SAMPLES_PER_VERTEX * len(mesh.vertices):
        raise UnwrapError(f"its {unwrapped.charts:,} charts leave {covered:,} texels of {side}² on the surface")
    ktx2 = encode(picture, part_of(whole, _BAKED, 1)) if encode else None
    return Textured(bare, unwrapped.uv, jpeg_of(picture, _QUALITY), side, ktx2)


def _light_at(palette: Palette, texel: float, places: Floats, normals: Floats, tick: Tick) -> Floats:
    return palette.light_at(places, normals, texel, tick)


def with_pictures(
    levels: Sequence[Mesh],
    palette: Palette,
    *,
    most_px: int,
    fits: Callable[[Textured], bool] = lambda _: True,
    encode: Encode | None = None,
    tick: Tick = no_tick,
) -> tuple[tuple[Mesh | Textured, ...], tuple[str, ...]]:
    """Levels of detail, finest first, each with a picture where that shows more than its vertices; and warnings.

    most_px  side of the largest picture; coarser levels get smaller ones
    fits     whether the coarsest level is small enough; its picture is halved until it is
    encode   packs pictures as KTX2; None: they are JPEG

    A level of more triangles than are unwrapped is brought down to as many: 50,000 with a picture of a dense capture
    show more than 100,000 with a colour at each vertex.
    """
    shown: list[Mesh | Textured] = []
    warnings: list[str] = []
    for number, level in enumerate(levels):
        begin, end = number / len(levels), (number + 1) / len(levels)
        inside = part_of(tick, begin, end)
        coarse = simplify(level, MOST_FACES, tick=part_of(tick, begin, begin))
        shown.append(level)
        if worth_a_picture(coarse, palette):
            widest = side_for(coarse, palette, most_px)
            side = max(widest >> number, min(widest, _SMALLER_FROM))
            made = partial(textured, coarse, palette, encode=encode, tick=inside)
            try:
                shown[-1] = _fitting(made, side, fits) if number == len(levels) - 1 else made(side=side)
            except UnwrapError as error:
                warnings.append(f"LOD {number} has no texture: {error}. Its colours are at the vertices.")
        inside(1)
    return tuple(shown), tuple(warnings)


def _fitting(made: Callable[..., Textured], side: int, fits: Callable[[Textured], bool]) -> Textured:
    """With the largest picture that fits, from `side` on down; with the smallest if none does."""
    asset = made(side=side)
    while not fits(asset) and asset.side > SMALLEST_PX:
        asset = made(side=asset.side // 2)
    return asset
