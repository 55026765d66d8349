"""A mesh beside photos of itself is faultless, and known holes, insides and leaks are found with their size."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from capture2vr.edge.arrays import Bools
from capture2vr.edge.mesh.nouns import Mesh, TexturedMesh
from capture2vr.edge.render.marked_picture import marked_jpeg
from capture2vr.edge.render.photo_comparison import (
    LikenessCheck,
    PhotoFigures,
    SurfaceCheck,
    check_likeness,
    check_surface,
    mean_figures,
)
from capture2vr.edge.render.posed_picture import PosedPicture
from tests.support import surfaces
from tests.support.photos.posed_pictures import SIDE, photograph, photographs, print_on, printed, silhouette


def sheet(cells: int) -> Mesh:
    """A square with waves, in the unit frame, with a print."""
    return printed(surfaces.patch(lambda u, v: [u, v, 0.05 * np.sin(6 * u) * np.cos(5 * v)], cells, cells))


BALL = surfaces.sphere()
SHEET = sheet(100)
FINE_SHEET = sheet(250)  # for its colours, which it has at its vertices
ASIDE = (1.5, 0.3, 0.2)  # an eye at the side of the ball
ABOVE = (0.2, 0.1, 1.4)  # an eye over the sheet
AROUND = [(1.6 * np.cos(turn), 1.6 * np.sin(turn), 0.6 * (-1) ** n) for n, turn in enumerate(np.arange(6) * np.pi / 3)]
FROM_ABOVE, FROM_BELOW = ((0.5, 0.0, 1.3), (-0.5, 0.2, 1.3)), ((0.0, 0.5, -1.3), (0.2, -0.5, -1.3))


def without(mesh: Mesh, vertices: Bools) -> Mesh:
    """The mesh without the faces at these vertices (V,)."""
    return Mesh(mesh.vertices, mesh.faces[~vertices[mesh.faces].any(axis=1)], mesh.rgb)


def joined(first: Mesh, second: Mesh) -> Mesh:
    """Both meshes as one."""
    faces = np.concatenate([first.faces, second.faces + len(first.vertices)])
    return printed(Mesh(np.concatenate([first.vertices, second.vertices]), faces))


def in_a_disc(mesh: Mesh, radius: float) -> Bools:
    """(V,) which vertices are near the z axis."""
    return np.linalg.norm(mesh.vertices[:, :2], axis=1) < radius


HOLED = without(SHEET, in_a_disc(SHEET, 0.12))
HOLE_SHARE = 1 - silhouette(HOLED, ABOVE).sum() / silhouette(SHEET, ABOVE).sum()


def only(mesh: Mesh, photo: PosedPicture, seen_by: Sequence[PosedPicture] = ()) -> SurfaceCheck:
    """The check of one photo."""
    (check,) = check_surface(mesh, [photo], seen_by)
    return check


def likeness(subject: Mesh | TexturedMesh, photo: PosedPicture) -> LikenessCheck:
    """How alike a subject and its photo are, wherever the subject is."""
    mesh = subject.mesh if isinstance(subject, TexturedMesh) else subject
    (pair,) = check_likeness(subject, [photo], [only(mesh, photo).thing])
    return pair


# Surfaces


@pytest.mark.slow
@pytest.mark.parametrize("scale", [1.0, 0.2])
def test_a_mesh_beside_photos_of_itself_is_faultless(scale: float) -> None:
    ball = printed(surfaces.patch(lambda u, v: surfaces._on_sphere(2 * np.pi * u, np.pi * v), 400, 200))
    photo, *seen_by = photographs(ball, [ASIDE, *AROUND], scale=scale)
    (check,) = check_surface(ball, [photo], seen_by)
    figures = mean_figures([check], check_likeness(ball, [photo], [check.thing]))
    assert figures is not None
    assert (figures.photos, figures.cover, figures.lace, figures.inside_out, figures.leak) == (1, 1, 0, 0, 0)
    assert figures.depth == 1
    assert figures.psnr is not None
    assert figures.psnr > 40
    assert figures.ssim == pytest.approx(1, abs=0.02)
    assert figures.sharp == pytest.approx(1, abs=0.15)


@pytest.mark.slow
@settings(max_examples=8)
@given(st.floats(0, 2 * np.pi), st.floats(-0.9, 0.9), st.floats(1.4, 2), st.booleans())
def test_it_is_faultless_from_everywhere(turn: float, height: float, away: float, depth: bool) -> None:
    eye = (away * np.cos(turn), away * np.sin(turn), height)
    figures = only(BALL, photograph(BALL, eye, depth=depth)).figures
    # Of its outline, colours alone leave single pixels in doubt.
    assert max(1 - figures.cover, figures.lace, figures.leak) < (0.001 if depth else 0.01)
    assert figures.depth == (pytest.approx(1, abs=0.001) if depth else None)


@pytest.mark.parametrize("depth", [True, False], ids=["with depth", "colours alone"])
def test_a_hole_is_as_large_as_it_is(depth: bool) -> None:
    check = only(HOLED, photograph(SHEET, ABOVE, depth=depth))
    assert HOLE_SHARE > 0.04
    assert check.figures.lace == pytest.approx(HOLE_SHARE, rel=0.05)
    assert check.figures.cover == pytest.approx(1 - HOLE_SHARE, rel=0.01)
    assert check.figures.leak == 0
    missing = silhouette(SHEET, ABOVE) & ~silhouette(HOLED, ABOVE)
    assert (check.hole == missing).mean() > 0.999


@pytest.mark.slow
@settings(max_examples=6)
@given(st.floats(0.08, 0.3))
def test_cover_and_lace_add_up_to_the_thing(radius: float) -> None:
    holed = without(SHEET, in_a_disc(SHEET, radius))
    figures = only(holed, photograph(SHEET, ABOVE)).figures
    assert figures.cover + figures.lace == pytest.approx(1, abs=0.002)
    cut = radius + 0.005  # half a cell: faces with one corner in the disc are cut out
    assert figures.lace == pytest.approx(np.pi * cut**2, rel=0.1), "the sheet's area is 1"


@pytest.mark.parametrize("depth", [True, False], ids=["with depth", "colours alone"])
def test_an_opening_of_the_thing_itself_is_no_hole(depth: bool) -> None:
    check = only(HOLED, photograph(HOLED, ABOVE, depth=depth))
    assert max(check.figures.lace, check.figures.leak, 1 - check.figures.cover) < 0.001
    assert check.hole.sum() < 5


def test_depth_tells_an_opening_from_a_hole_where_colours_cannot() -> None:
    """Behind the opening stands more of the same print."""
    behind = Mesh(4 * SHEET.vertices - [0, 0, 1.5], SHEET.faces)
    before = photograph(joined(HOLED, behind), ABOVE)
    assert only(HOLED, before).figures.lace == 0
    blind = PosedPicture(before.to_camera, before.focal, before.middle, before.load_rgb)
    assert only(HOLED, blind).figures.lace > 0.8 * HOLE_SHARE


def test_what_shows_through_a_hole_in_a_closed_thing_is_its_inside() -> None:
    front = BALL.vertices @ ASIDE > 0.47 * np.linalg.norm(ASIDE)
    bitten = without(BALL, front)
    bite = Mesh(BALL.vertices, BALL.faces[front[BALL.faces].any(axis=1)])
    share = silhouette(bite, ASIDE).sum() / silhouette(BALL, ASIDE).sum()
    check = only(bitten, photograph(BALL, ASIDE), photographs(BALL, AROUND))
    assert share > 0.2
    assert check.figures.inside_out == pytest.approx(share, rel=0.05)
    assert check.inside.mean() == pytest.approx(share * silhouette(BALL, ASIDE).mean(), rel=0.1)
    assert check.figures.lace == 0, "the inside covers it"
    assert check.figures.depth == pytest.approx(1 - share, rel=0.02), "but not where the photo has its depth"


def test_a_sheet_that_was_seen_from_both_sides_has_no_inside() -> None:
    photo = photograph(SHEET, ABOVE)
    assert only(SHEET, photo, photographs(SHEET, [*FROM_ABOVE, *FROM_BELOW])).figures.inside_out < 0.005
    assert only(SHEET, photo, photographs(SHEET, FROM_BELOW)).figures.inside_out > 0.99
    assert only(SHEET, photo).figures.inside_out == 0, "nobody saw the other side either"


def test_a_side_that_another_surface_hid_was_not_seen() -> None:
    """The photos from below saw a lid below the sheet, and not the sheet."""
    lid = joined(SHEET, Mesh(SHEET.vertices - [0, 0, 0.3], SHEET.faces))
    hidden = photographs(lid, FROM_BELOW)
    below = only(SHEET, photograph(SHEET, ABOVE), hidden).figures.inside_out
    assert below < 0.2  # its rims alone


@pytest.mark.parametrize(("scale", "outside"), [(1.0, 0.62), (0.2, -0.62)])
def test_a_flap_where_the_photo_looks_past_is_a_leak_of_its_size(scale: float, outside: float) -> None:
    flap = Mesh(SHEET.vertices * [0.15, 0.8, 1] + [outside, 0, 0], SHEET.faces)
    flying = joined(SHEET, flap)
    share = 1 - silhouette(SHEET, ABOVE).sum() / silhouette(flying, ABOVE).sum()
    check = only(flying, photograph(SHEET, ABOVE, scale=scale))
    assert share > 0.05
    assert check.figures.leak == pytest.approx(share, rel=0.05)
    assert (check.figures.cover, check.figures.lace) == (1, 0)
    assert not (check.leak & silhouette(SHEET, ABOVE)).any()


def test_colours_alone_tell_a_rim_of_background() -> None:
    grown = Mesh(1.06 * BALL.vertices, BALL.faces)
    check = only(grown, photograph(BALL, ASIDE, depth=False))
    rim = silhouette(grown, ASIDE) & ~silhouette(BALL, ASIDE)
    assert check.leak.sum() > 0.2 * rim.sum(), "less what lies within a pixel, and what is taken for the thing's core"
    assert not (check.leak & ~rim).any()


def test_a_mesh_at_another_depth_than_its_photo_meets_none_of_it() -> None:
    near = Mesh(SHEET.vertices + np.array([0, 0, 0.03]), SHEET.faces)  # 2 % of the way to the camera
    assert only(near, photograph(SHEET, ABOVE)).figures.depth == pytest.approx(0, abs=0.01)


@pytest.mark.parametrize("finer", [1, 3])
def test_a_known_mask_is_believed_at_any_size(finer: int) -> None:
    """Where the mask has the thing, an opening in the photo is a hole; and where it has not, a sheet is a leak."""
    photo = photograph(HOLED, ABOVE)

    def checked(mesh: Mesh, known: Bools) -> PhotoFigures:
        mask = np.kron(known, np.ones((finer, finer))) > 0
        (check,) = check_surface(mesh, [replace(photo, load_mask=lambda: mask)], ())
        return check.figures

    assert checked(HOLED, silhouette(SHEET, ABOVE)).lace == pytest.approx(HOLE_SHARE, rel=0.05)
    leak = checked(SHEET, silhouette(HOLED, ABOVE)).leak
    assert 0.7 * HOLE_SHARE < leak < HOLE_SHARE


@pytest.mark.parametrize(
    "elsewhere",
    [Mesh(BALL.vertices + 50, BALL.faces), Mesh(0.08 * BALL.vertices, BALL.faces)],
    ids=["out of sight", "too small"],
)
def test_a_photo_that_shows_nothing_of_the_mesh_says_nothing(elsewhere: Mesh) -> None:
    photos = photographs(BALL, [ASIDE])
    assert check_surface(elsewhere, photos, ()) == []
    assert mean_figures([]) is None
    assert [check.picture for check in check_surface(BALL, photos, ())] == photos


def test_two_comparisons_come_out_the_same() -> None:
    photos = photographs(SHEET, [ABOVE, FROM_ABOVE[0]], depth=False)
    seen_by = photographs(SHEET, FROM_ABOVE)
    first, second = (check_surface(HOLED, photos, seen_by) for _ in range(2))
    for one, other in zip(first, second, strict=True):
        assert one.figures == other.figures
        for name in ("mesh", "thing", "hole", "inside", "leak"):
            assert (getattr(one, name) == getattr(other, name)).all()
        assert marked_jpeg(one) == marked_jpeg(other)
    assert first[0].figures != first[1].figures


def test_large_photos_are_compared_at_a_bounded_size() -> None:
    small = photograph(SHEET, ABOVE)

    def enlarged() -> np.ndarray:
        return cv2.resize(small.load_rgb(), (5 * SIDE, 3 * SIDE), interpolation=cv2.INTER_CUBIC)

    large = PosedPicture(small.to_camera, small.focal, small.middle, enlarged, small.load_depth)
    check = only(HOLED, large)
    assert check.rgb.shape == (288, 480, 3)
    assert check.figures.lace == pytest.approx(HOLE_SHARE, rel=0.1)


# Likeness


@pytest.mark.slow
def test_the_exposure_of_a_photo_does_not_count() -> None:
    plain, other = (
        likeness(FINE_SHEET, photograph(FINE_SHEET, ABOVE, gain=gain)) for gain in ((1.0, 1.0, 1.0), (0.7, 0.9, 1.1))
    )
    assert plain.psnr > 40
    assert abs(other.psnr - plain.psnr) < 5
    assert other.ssim == pytest.approx(plain.ssim, abs=0.01)


def test_another_print_is_not_alike() -> None:
    other = Mesh(FINE_SHEET.vertices, FINE_SHEET.faces, printed(Mesh(FINE_SHEET.vertices + 0.3, FINE_SHEET.faces)).rgb)
    pair = likeness(other, photograph(FINE_SHEET, ABOVE))
    assert pair.psnr < 18
    assert pair.ssim < 0.6


def textured(blur: float = 0.0) -> TexturedMesh:
    """A flat square with the print as its texture."""
    at = (np.arange(512) + 0.5) / 512 - 0.5
    x, y = np.meshgrid(at, at)
    picture = print_on(np.stack([x, y, 0 * x], axis=-1).reshape(-1, 3)).reshape(512, 512, 3)
    if blur:
        picture = cv2.GaussianBlur(picture, (0, 0), blur)
    stream = io.BytesIO()
    Image.fromarray(np.rint(picture).astype(np.uint8)).save(stream, "JPEG", quality=95, subsampling=0)
    flat = surfaces.patch(lambda u, v: [u, v, 0 * u], 2, 2)
    return TexturedMesh(flat, flat.vertices[:, :2] + 0.5, stream.getvalue(), 512)


def test_a_blurred_texture_is_less_sharp_than_its_photo() -> None:
    flat = textured()
    photo = photograph(flat.mesh, ABOVE)
    sharp, soft, softer = (likeness(textured(blur), photo) for blur in (0.0, 6.0, 12.0))
    assert sharp.sharp == pytest.approx(1, abs=0.1)
    assert sharp.psnr > 35
    assert sharp.sharp > 2 * soft.sharp > 4 * softer.sharp
    assert sharp.psnr > soft.psnr > softer.psnr


# Means and pictures


def check_with(figures: PhotoFigures) -> SurfaceCheck:
    """A check with these figures, of which nothing else is looked at."""
    nothing: Any = None
    return SurfaceCheck(*[nothing] * 7, figures)


@given(st.lists(st.tuples(st.floats(0, 1), st.floats(0, 1), st.none() | st.floats(0, 1)), min_size=1, max_size=6))
def test_means_lie_between_their_photos_and_leave_out_what_is_not_known(
    figures: list[tuple[float, float, float | None]],
) -> None:
    mean = mean_figures([check_with(PhotoFigures(1, cover, 0, 0, leak, depth)) for cover, leak, depth in figures])
    assert mean is not None
    assert mean.photos == len(figures)
    for found, values in ((mean.cover, [each[0] for each in figures]), (mean.leak, [each[1] for each in figures])):
        assert found == pytest.approx(np.mean(values), abs=1e-5)
    depths = [each[2] for each in figures if each[2] is not None]
    assert mean.depth == (pytest.approx(np.mean(depths), abs=1e-5) if depths else None)
    assert (mean.psnr, mean.ssim, mean.sharp) == (None, None, None)


def halves(jpeg: bytes) -> tuple[np.ndarray, np.ndarray]:
    """The photo's half and the mesh's half of a marked picture."""
    pixels = np.asarray(Image.open(io.BytesIO(jpeg))).astype(int)
    left, right = np.split(pixels, 2, axis=1)
    return left, right


@pytest.mark.parametrize("rendered", [True, False])
def test_holes_insides_and_leaks_have_their_colours(rendered: bool) -> None:
    photo = photograph(SHEET, ABOVE)
    check = only(SHEET, photo)
    spots = [np.zeros((SIDE, SIDE), bool) for _ in range(3)]
    for number, spot in enumerate(spots):
        spot[90:110, 60 + 30 * number : 80 + 30 * number] = True
    marked = SurfaceCheck(photo, check.rgb, check.mesh, check.thing, *spots, check.figures)
    pair = likeness(SHEET, photo) if rendered else None
    left, right = halves(marked_jpeg(marked, pair, quality=95))
    for spot, colour in zip(spots, ((255, 0, 255), (255, 200, 0), (0, 200, 255)), strict=True):
        inner = cv2.erode(spot.astype(np.uint8), np.ones((9, 9))) > 0
        assert np.abs(right[inner] - colour).max() < 40
    inner = cv2.erode(check.thing.astype(np.uint8), np.ones((9, 9))) > 0
    outer = cv2.dilate(check.thing.astype(np.uint8), np.ones((9, 9))) == 0
    rgb = photo.load_rgb().astype(int)
    assert np.abs(left[inner] - rgb[inner]).mean() < 8
    assert np.abs(left[outer] - rgb[outer] // 3).mean() < 8, "the photo is darkened where the thing is not"
    assert np.abs(right[outer] - 32).mean() < 8
