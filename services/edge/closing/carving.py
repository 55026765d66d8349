"""Find free space around a thing: what photos see past, and what they show to be background.

Both say that every place on a pixel's ray up to what it shows is empty (K. N. Kutulakos, S. M. Seitz, "A Theory of
Shape by Space Carving", 2000); here photos vote, because depth and outlines err.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from capture2vr.edge.arrays import Bools, Bytes, Floats
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.parallel import in_threads, slices
from capture2vr.edge.render.object_colours import ObjectColours
from capture2vr.edge.render.posed_picture import PosedPicture
from capture2vr.edge.render.rays import RaycastingScene
from capture2vr.edge.render.sample_image import pixels_at
from capture2vr.edge.render.silhouette import beyond, colours_of, outline_thing, see_mesh

_BEYOND = 0.02
"""Relative depth by which a photo sees past a place, or something before it."""
_FEWEST = 2
"""Photos that must agree on free space: one may err."""
_BESIDE = 0.35
"""Share of the photos that show a place which must show background there. Fewer see a rim before the background than
before the thing; in dark corners a third of the outlines is wrong."""
_LONGEST_PX = 320
"""Longer side of the pictures in which outlines are found: a cell of the grid that is carved has 3 pixels then."""
_AT_ONCE = 65_536
"""Places per task of a thread."""
_ROUNDS = 1
"""Rounds of GrabCut: photos vote, and three rounds find no more."""


@dataclass(frozen=True, slots=True)
class _Outline:
    """A photo's outline of the thing: beside, hidden (h,w) uint8 where it shows background, and something before the
    thing."""

    beside: Bytes
    hidden: Bytes


@dataclass(frozen=True, slots=True)
class Carving:
    """What photos with depth say about places in their frame; outlines: theirs, as far as they are known."""

    pictures: tuple[PosedPicture, ...]
    outlines: tuple[_Outline | None, ...] = ()

    def with_outlines(self, thing: Mesh) -> Carving:
        """Return the same with the outlines that the photos have of a thing, whose mesh is known roughly."""
        scene, colours = RaycastingScene(thing), colours_of(thing, self.pictures)
        outlines = in_threads(lambda each: _outline(each, thing, scene, colours), self.pictures)
        return Carving(self.pictures, tuple(outlines))

    def is_free(self, places: Floats) -> Bools:
        """Return a mask (N,) of the places (N,3) that are in free space."""
        parts = slices(len(places), _AT_ONCE)
        free = in_threads(lambda part: self._is_seen_past(places[part]) | self.is_beside(places[part]), parts)
        return np.concatenate([np.zeros(0, bool), *free])

    def is_beside(self, places: Floats) -> Bools:
        """Return a mask (N,) of the places (N,3) where photos show background."""
        beside, on = (np.zeros(len(places), np.int16) for _ in range(2))
        for picture, outline in zip(self.pictures, self.outlines, strict=False):
            if outline is None:
                continue
            shown, at, _ = picture.in_view(places)
            is_beside, is_hidden = (pixels_at(each, at) > 0 for each in (outline.beside, outline.hidden))
            beside[shown] += is_beside & ~is_hidden
            on[shown] += ~is_beside
        return (beside >= _FEWEST) & (beside > _BESIDE * (beside + on))

    def _is_seen_past(self, places: Floats) -> Bools:
        """(N,) whether more photos see past a place (N,3) than see something before it."""
        past, before = (np.zeros(len(places), np.int16) for _ in range(2))
        for picture in self.pictures:
            shown, at, z = picture.in_view(places)
            found = pixels_at(picture.depth(), at)
            past[shown] += found > (1 + _BEYOND) * z
            before[shown] += (found > 0) & (found < (1 - _BEYOND) * z)
        return (past >= _FEWEST) & (past > before)


def _outline(
    picture: PosedPicture, thing: Mesh, scene: RaycastingScene, colours: ObjectColours | None
) -> _Outline | None:
    view = see_mesh(picture, scene, _LONGEST_PX)
    if view is None:
        return None
    beside = beyond(outline_thing(view, picture, thing, scene, colours, rounds=_ROUNDS))
    return _Outline(beside.astype(np.uint8), view.hidden.astype(np.uint8))
