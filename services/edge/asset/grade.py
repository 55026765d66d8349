"""Grade an asset in one word that a person understands, with the cause and what to do.

Figures are of photos beside renderings of the surface: held-out ones, or where the capture could spare none, a few of
those that it was made from, which see holes as well. The worst photo counts, because a person walks around the thing:
of a furry head whose mean share of holes was 2 %, the dark side had 6 %.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

from capture2vr.edge.asset.photo_check import PhotoCheck
from capture2vr.edge.certificate import Certificate
from capture2vr.edge.render.photo_comparison import SurfaceCheck, mean_figures, worst_photo
from capture2vr.sentences.sentence import say

Level = Literal["good", "usable", "incomplete", "shoot again"]

_DEPTH = (0.85, 0.65, 0.6)
"""Least share of the photos' own depth that the surface meets within 1 %, for good, usable and incomplete. Statue .94,
fruit .96, stump .94; furry head .68; glass .44 and, rendered, .58; black gloss .36."""
_FAR_APART = 20.0
"""Degrees between neighbouring photos from which on these, and not shine, are why depth disagrees: key points are found
again over 30 degrees by chance, and photos end up in wrong places."""
_LACE = (0.02, 0.05, 0.2)
"""Most of the object in holes in the worst photo."""
_COVER = (0.9, 0.8, 0.6)
"""Least share of the object in a photo where the surface is."""
_RAGGED = (8.0, 15.0, 25.0)
"""Most border over the root of an object's area. A dress has 6, a glass bottle of crumpled foil 39."""
_OPEN = 0.5
"""Share of an object's pixels that show its inside, from where that is most, from which on it is an open shell. Of what
was shot from one side, fruit that was closed has .002, half a toy animal .99."""
_SHUT, _SCRAPS = 0.1, 1.2
"""Share of an object's pixels that show its inside below which its surface is shut, and border over root from which on
that of a shut one is of scraps that stick out. Fruit has .3, bananas .5, a single opening of a tenth .6; a plush dog
with dozens of scraps 2.9, a plaster temple 3.3."""
_MADE_UP = (0.5, 0.6, 0.75)
"""Most of the surface that nobody saw. Fruit that was shot from above has .43."""


@dataclass(frozen=True, slots=True)
class Grade:
    """How good an asset is. level: one of four; because, advice: sentences, "" for a good one."""

    level: Level
    because: str = ""
    advice: str = ""

    def as_json(self) -> dict[str, Any]:
        """Serialise the grade as JSON."""
        return {"level": self.level, "because": self.because, "advice": self.advice}

    def warnings(self) -> tuple[str, ...]:
        """The sentence that comes before all other warnings; none for a good asset or a usable one."""
        told = {"incomplete": "grade_incomplete", "shoot again": "grade_shoot_again"}
        return (say(told[self.level], why=self.because, advice=self.advice),) if self.level in told else ()


_LEVELS: tuple[Level, ...] = ("good", "usable", "incomplete", "shoot again")


def grade_asset(certificate: Certificate, check: PhotoCheck, filled: float) -> Grade | None:
    """Grade a surface by its certificate, its photos and the share (0 to 1) that was filled in; None without photos."""
    checks = check.surface or check.own
    if not checks:
        return None
    faults = list(_faults(certificate, check, checks, filled))
    worst = max(faults, key=lambda each: each.level)
    if not worst.level:
        return Grade("good")
    if check.one_side and not check.flat and worst.kind != "depth":
        worst = replace(worst, because=say("photos_of_one_side", degrees=check.one_side), advice="again_all_around")
    other = next((each for each in faults if each.level == 1 == worst.level and each.kind != worst.kind), None)
    if other is None:
        return Grade(_LEVELS[worst.level], worst.because, say(worst.advice))
    # Of eleven photos of fruit half was made up, and the rest had wrong depth: a rag, but neither saw it.
    because = say("one_and_other", one=worst.because, other=other.because)
    return Grade(_LEVELS[worst.level + 1], because, say(worst.advice))


@dataclass(frozen=True, slots=True)
class _Fault:
    """How bad a figure is, 0 to 3; kind: figures of one kind see the same; because: a sentence; advice: its code."""

    level: int
    kind: Literal["holes", "depth", "made up"]
    because: str
    advice: str


def _faults(
    certificate: Certificate, check: PhotoCheck, checks: Sequence[SurfaceCheck], filled: float
) -> Iterator[_Fault]:
    """Yield how bad each figure is."""
    worst = worst_photo(checks)
    lace, photo = worst.figures.lace, worst.picture.name
    yield _Fault(
        _above(lace, _LACE), "holes", say("holes_where_photo_shows_object", share=lace, photo=photo), "again_near"
    )
    # A sensor's depth has noise of its own, which says nothing about the surface.
    matched = mean_figures([each for each in checks if not each.picture.tracked])
    depth = 1.0 if matched is None or matched.depth is None else matched.depth
    met = _above(-depth, tuple(-each for each in _DEPTH))
    if check.apart > _FAR_APART:
        yield _Fault(met, "depth", say("photos_stand_far_apart", share=depth, degrees=check.apart), "again_around")
    else:
        much, little = say("depth_of_photos_disagrees", share=depth), say("depth_disagrees_a_little", share=depth)
        yield _Fault(met, "depth", much if met > 1 else little, "again_matt")
    cover = sum(each.figures.cover for each in checks) / len(checks)
    covered = _above(-cover, tuple(-each for each in _COVER))
    yield _Fault(covered, "holes", say("object_not_covered", share=cover), "again_around")
    yield from _faults_of_shape(certificate, check, filled)


def _faults_of_shape(certificate: Certificate, check: PhotoCheck, filled: float) -> Iterator[_Fault]:
    """Yield how bad each figure is that no single photo shows."""
    shell = check.one_side and not check.flat and certificate.largest_hole > _OPEN
    yield _Fault(2 if shell else 0, "holes", say("photos_of_one_side", degrees=check.one_side), "again_all_around")
    shut = not check.scene and certificate.largest_hole < _SHUT
    scraps = shut and certificate.border_over_root > _SCRAPS
    yield _Fault(1 if scraps else 0, "holes", say("scraps_stick_out_of_surface"), "again_before_other_colour")
    # A room and a relief end where their photos do.
    ragged = 0.0 if check.scene or check.flat else certificate.border_over_root
    yield _Fault(_above(ragged, _RAGGED), "holes", say("surface_is_ragged", border=ragged), "again_matt")
    yield _Fault(_above(filled, _MADE_UP), "made up", say("much_was_filled_in", share=filled), "again_around")


def _above(value: float, limits: tuple[float, ...]) -> int:
    """Number of the rising limits that a value exceeds."""
    return sum(value > limit for limit in limits)
