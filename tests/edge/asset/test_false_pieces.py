"""Small pieces that the photos do not bear out go, each with a reason; what they show stays."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from capture2vr.edge.arrays import Floats
from capture2vr.edge.asset.photo_check import drop_false_pieces
from capture2vr.edge.certificate import Evidence, certify
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.mesh.sampling import area
from capture2vr.edge.points.nouns import Points, TextureView, UnitFrame
from tests.edge.asset.test_photo_check import CENTRE, EYES, SHEET, SIZE, points, view
from tests.edge.test_certificate import flat_field
from tests.support import surfaces
from tests.support.photos.posed_pictures import photographs, printed, silhouette


def patch(side: float, x: float, height: float) -> Mesh:
    """A square over the sheet at (x, 0)."""
    unit = surfaces.patch(lambda u, v: [u, v, 0 * u], 12, 12)
    return printed(Mesh(side * unit.vertices + [x, 0, height], unit.faces))


def joined(*meshes: Mesh) -> Mesh:
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    faces = [mesh.faces + start for mesh, start in zip(meshes, starts, strict=False)]
    rgb = np.concatenate([mesh.rgb for mesh in meshes if mesh.rgb is not None])
    return Mesh(np.concatenate([mesh.vertices for mesh in meshes]), np.concatenate(faces), rgb)


UNIT = UnitFrame(centre=CENTRE, size=SIZE)
FLYING = patch(0.1, 0.1, 0.3)
BOTH = joined(SHEET, FLYING)


def views_of(mesh: Mesh) -> tuple[TextureView, ...]:
    return tuple(view(picture) for picture in photographs(mesh, EYES))


def painted(shot: TextureView, eye: tuple[float, ...], colour: tuple[int, int, int]) -> TextureView:
    """The photo with another colour where the flying piece is."""

    def load() -> Floats:
        return np.where(silhouette(FLYING, eye)[..., None], np.array(colour, np.uint8), shot.load_rgb())

    return replace(shot, load_rgb=load)


def judged(mesh: Mesh, views: tuple[TextureView, ...]) -> tuple[Mesh, str, bool]:
    """The mesh that is left, and the fate of its smaller piece."""
    left, pieces = drop_false_pieces(mesh, points((), views), UNIT)
    assert pieces[0].reason == "the largest"
    assert pieces[0].kept
    assert sum(piece.share for piece in pieces) == pytest.approx(1)
    return left, pieces[1].reason, pieces[1].kept


def test_a_piece_that_the_photos_show_stays() -> None:
    left, reason, kept = judged(BOTH, views_of(BOTH))
    assert kept
    assert "two photos or more" in reason
    assert left is BOTH


def test_a_piece_that_no_photo_shows_goes() -> None:
    left, reason, kept = judged(BOTH, views_of(SHEET))
    assert (reason, kept) == ("no photo sees it", False)
    assert area(left) == pytest.approx(area(SHEET))
    assert left.rgb is not None
    assert len(left.rgb) == len(left.vertices)


def test_one_photo_alone_confirms_nothing() -> None:
    views = (views_of(BOTH)[0], *views_of(SHEET)[1:])
    assert judged(BOTH, views)[1:] == ("only one photo sees it", False)


def test_a_piece_that_every_photo_shows_in_another_colour_goes() -> None:
    colours = ((250, 20, 20), (20, 250, 20), (20, 20, 250))
    views = tuple(map(painted, views_of(BOTH), EYES, colours))
    assert judged(BOTH, views)[1:] == ("the photos that see it disagree on its colours", False)


def test_a_darker_exposure_is_no_disagreement() -> None:
    bright, dark = photographs(BOTH, EYES), photographs(BOTH, EYES, gain=(0.85, 0.85, 0.85))
    assert judged(BOTH, (view(bright[0]), view(dark[1]), view(bright[2])))[2]


def test_a_large_piece_stays_whatever_the_photos_say() -> None:
    large = joined(SHEET, patch(0.4, 0.0, 0.3))
    assert judged(large, views_of(SHEET))[1:] == ("large", True)


@pytest.mark.parametrize("depth", [True, False])
def test_without_photos_or_depth_there_is_nobody_to_ask(depth: bool) -> None:
    views = tuple(map(view, photographs(BOTH, EYES, depth=False))) if not depth else ()
    left, reason, kept = judged(BOTH, views)
    assert kept
    assert left is BOTH
    assert "no photos to ask" in reason


def test_the_certificate_lists_what_went() -> None:
    found: Points = points((), views_of(SHEET))
    left, pieces = drop_false_pieces(BOTH, found, UNIT, specks=[1e-4] * 20)
    xyz = SHEET.vertices[::7]
    told = certify(flat_field, left, Evidence.of(xyz, xyz[:0]), pieces).as_json()["pieces"]
    assert told[0] == {"share": pytest.approx(0.988, abs=0.005), "count": 1, "kept": True, "reason": "the largest"}
    assert sum(each["count"] for each in told) == 22
    assert {each["reason"] for each in told if not each["kept"]} == {
        "no photo sees it",
        "smaller than 15 squared point spacings",
    }
