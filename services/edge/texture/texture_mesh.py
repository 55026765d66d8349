"""Texture a mesh: decide whether a texture is worth it and how large, unwrap the mesh, bake and encode the texture."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain

import numpy as np

from capture2vr.edge.arrays import Floats, Ints, Tick, no_tick, part_of
from capture2vr.edge.export.ktx2 import EncodeKtx2
from capture2vr.edge.mesh.nouns import Mesh, TexturedMesh
from capture2vr.edge.mesh.sampling import area
from capture2vr.edge.mesh.simplify import Hold, simplify
from capture2vr.edge.parallel import in_threads, shared_ticks, slices
from capture2vr.edge.srgb import to_linear, to_srgb
from capture2vr.edge.texture.bake import bake, interpolate, jpeg_of, random_places
from capture2vr.edge.texture.nearest_colour import ColouredPoints
from capture2vr.edge.texture.unwrap import UnwrapError, unwrap
from capture2vr.sentences.sentence import say

SMALLEST_PX = 64
"""Side of the smallest texture, in texels."""

_FACES = 50_000  # of a textured level, or half as many again where openings forbid fewer: the texture holds the detail
_TEXELS_PER_POINT = 2.0  # on the surface: points lie on no grid, and one texel each would blur them
_FILLED = 0.6  # of a texture lies on the surface: there are gaps between charts and a strip at a side
_NEIGHBOURS = 4  # of a texel: of a print on a truck 4 keep more than the 6 of a vertex (mean error 4.0 against 4.3)
_SAMPLES_PER_VERTEX = 2.0  # known colours per vertex: with fewer, vertex colours show all that is known
_LEAST_GAIN = 1.0  # mean difference of known and vertex colours in sRGB bytes below which nobody sees a texture
_PROBES = 20_000  # places at which that is measured
_SMALLER_FROM = 512  # texels along a side: coarser levels halve what is larger
_MANY = 2  # points per texel from which on all of them are averaged, rather than the nearest interpolated
_AT_ONCE = 1 << 18  # texels whose neighbours are looked up together: a second
_PHOTO_SHARE = 0.7  # of the time of finding the texels' light goes into photos, where there are any
_QUALITY = 88  # of the JPEG
_UNWRAP_SHARE = 0.5  # of the time of a texture of 1024², the rest is baking
_BAKE_SHARE = 0.4  # of the time is unwrapping and baking where KTX2 is encoded after it

PictureLight = Callable[[Floats, Floats, float, Tick], tuple[Floats, Floats]]
"""Function from places (N,3) on the mesh, unit normals and the size of a texel to linear light (N,3) from photos, and
(N,) how reliable it is in [0,1]."""


@dataclass(frozen=True, slots=True)
class Palette:
    """Sources of a mesh's colours, in its frame: coloured points, and photos where there are any.

    points    coloured points on and near the surface
    pictures  light from photos, or None
    pixel     side of a photo's pixel on the surface, in units of the mesh; 0 without photos
    """

    points: ColouredPoints
    pictures: PictureLight | None = None
    pixel: float = 0.0

    def samples_on(self, area: float) -> float:
        """Estimate how many different colours are known of a surface of that area: points, or photos' pixels."""
        return max(len(self.points), area / self.pixel**2 if self.pixel else 0.0)

    def light_at(self, places: Floats, normals: Floats, texel: float, tick: Tick = no_tick) -> Floats:
        """Sample linear colours (N,3) for texels of this size: from photos where reliable, else from the points."""
        light, sure = np.zeros((len(places), 3), np.float32), np.zeros(len(places), np.float32)
        if self.pictures is not None:
            light, sure = self.pictures(places, normals, texel, part_of(tick, 0, _PHOTO_SHARE))
            tick = part_of(tick, _PHOTO_SHARE, 1)
        unsure = np.flatnonzero(sure < 1)
        if len(unsure):
            known = sure[unsure, None]
            light[unsure] = known * light[unsure] + (1 - known) * self._light_of_points(places, unsure, texel, tick)
        return light

    def _light_of_points(self, places: Floats, which: Ints, texel: float, tick: Tick) -> Floats:
        """(K,3) light at K of the places: interpolated from neighbours; the mean where a texel has many points."""
        light: Floats = np.zeros((len(places), 3), np.float32)
        count: Ints = np.zeros(len(places), np.int64)
        if _MANY * len(places) <= len(self.points):  # the nearest few alone would give a noisy texture
            light, count = self.points.mean_light(places, texel)
        alone = which[count[which] == 0]
        for part in slices(len(alone), _AT_ONCE):
            light[alone[part]] = self.points.light_at(places[alone[part]], _NEIGHBOURS)
            tick(part.stop / len(alone))
        return light[which]


def texture_side(mesh: Mesh, palette: Palette, most: int) -> int:
    """Side of a mesh's texture: the power of two, at most `most` texels, that holds all known colours."""
    wanted = np.sqrt(_TEXELS_PER_POINT * palette.samples_on(area(mesh)) / _FILLED)
    return int(np.clip(2 ** np.ceil(np.log2(wanted)), SMALLEST_PX, max(most, SMALLEST_PX)))


def needs_texture(mesh: Mesh, palette: Palette) -> bool:
    """Whether a texture would show more than a mesh's vertex colours: more colours are known, and they differ."""
    if mesh.rgb is None or palette.samples_on(area(mesh)) < _SAMPLES_PER_VERTEX * len(mesh.vertices):
        return False
    # Photos are sharper than the points. They are not compared, because all of them would have to be loaded.
    return palette.pictures is not None or colour_gain(mesh, palette.points) >= _LEAST_GAIN


def colour_gain(mesh: Mesh, points: ColouredPoints) -> float:
    """Measure what a texture would add: mean difference in sRGB codes between point and vertex colours."""
    assert mesh.rgb is not None
    face, weight = random_places(mesh, _PROBES)
    place = interpolate(mesh.vertices, mesh.faces[face], weight)
    shown = to_srgb(interpolate(to_linear(mesh.rgb), mesh.faces[face], weight)).astype(np.float64)
    known = to_srgb(points.light_at(place, _NEIGHBOURS)).astype(np.float64)
    return float(np.abs(shown - known).mean())


def unwrap_and_bake(
    mesh: Mesh, palette: Palette, *, side: int, encode: EncodeKtx2 | None = None, tick: Tick = no_tick
) -> TexturedMesh:
    """Give a mesh a texture of side × side texels instead of vertex colours; with an `encode`, also as KTX2.

    Raises UnwrapError where the mesh cannot be unwrapped, or into so many charts that vertex colours show as much.
    """
    whole, tick = tick, part_of(tick, 0, _BAKE_SHARE if encode else 1)
    unwrapped = unwrap(mesh, side=side, tick=part_of(tick, 0, _UNWRAP_SHARE))
    bare = replace(unwrapped.mesh, rgb=None)
    texel = float(np.sqrt(area(mesh) / _FILLED) / side)
    light_at = partial(_light_at, palette, texel)
    picture, covered = bake(bare, unwrapped.uv, light_at, side=side, tick=part_of(tick, _UNWRAP_SHARE, 1))
    if covered < _SAMPLES_PER_VERTEX * len(mesh.vertices):
        raise UnwrapError(say("charts_leave_only_texels_surface", charts=unwrapped.charts, covered=covered, side=side))
    ktx2 = encode(picture, part_of(whole, _BAKE_SHARE, 1)) if encode else None
    return TexturedMesh(bare, unwrapped.uv, jpeg_of(picture, _QUALITY), side, ktx2)


def _light_at(palette: Palette, texel: float, places: Floats, normals: Floats, tick: Tick) -> Floats:
    return palette.light_at(places, normals, texel, tick)


def texture_levels(
    levels: Sequence[Mesh],
    palette: Palette,
    *,
    most_px: int,
    fits: Callable[[TexturedMesh], bool] = lambda _: True,
    encode: EncodeKtx2 | None = None,
    hold: Hold | None = None,
    tick: Tick = no_tick,
) -> tuple[tuple[Mesh | TexturedMesh, ...], tuple[str, ...]]:
    """Texture the levels of detail, finest first, where that shows more than vertex colours; also return warnings.

    most_px  side of the largest texture; coarser levels get smaller ones
    fits     whether the coarsest level is small enough; its texture is halved until it is
    encode   encoder of KTX2 textures; None: they are JPEG
    hold     vertices of a level that stay where they are, as in `simplify`

    A level of more than 50,000 triangles is simplified first: with the texture of a dense capture they show more than
    100,000 with vertex colours.
    """
    ticks = shared_ticks(tick, len(levels))

    def texture(number: int) -> tuple[Mesh | TexturedMesh, tuple[str, ...]]:
        level, level_tick = levels[number], ticks[number]
        coarse = simplify(level, _FACES, hold=hold, tick=part_of(level_tick, 0, 0))
        if not needs_texture(coarse, palette):
            return level, ()
        widest = texture_side(coarse, palette, most_px)
        side = max(widest >> number, min(widest, _SMALLER_FROM))
        make = partial(unwrap_and_bake, coarse, palette, encode=encode, tick=level_tick)
        try:
            return (_make_largest(make, side, fits) if number == len(levels) - 1 else make(side=side)), ()
        except UnwrapError as error:
            return level, (say("lod_has_no_texture_keeps", level=number, why=error),)

    # At the same time: half of a level's seconds, such as xatlas packing its charts, keep one core busy alone.
    assets, warnings = zip(*in_threads(texture, range(len(levels))), strict=True)
    tick(1)
    return assets, tuple(chain.from_iterable(warnings))


def _make_largest(make: Callable[..., TexturedMesh], side: int, fits: Callable[[TexturedMesh], bool]) -> TexturedMesh:
    """Make the asset with the largest texture that fits, halving `side`; with the smallest if none fits."""
    asset = make(side=side)
    while not fits(asset) and asset.side > SMALLEST_PX:
        asset = make(side=asset.side // 2)
    return asset
