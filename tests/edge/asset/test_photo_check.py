"""An asset beside its held-out photos, in whatever frame; advice names the photo that shows a fault most."""

from __future__ import annotations

import io
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from PIL import Image

from capture2vr.edge.arrays import Floats
from capture2vr.edge.asset.photo_check import (
    PhotoCheck,
    check_surface_with_photos,
    check_textures_with_photos,
    figures_with_textures,
    marked_pictures,
)
from capture2vr.edge.capture.nouns import Capture, Intrinsics
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.pipeline import reconstruct
from capture2vr.edge.points.nouns import Points, TextureView, UnitFrame
from capture2vr.edge.preset import Preset
from capture2vr.edge.render.photo_comparison import PhotoFigures, SurfaceCheck
from capture2vr.edge.render.place_views import posed_picture
from capture2vr.edge.render.posed_picture import PosedPicture
from capture2vr.order.job_options import JobOptions
from capture2vr.storage.bundle import Bundle
from tests.support import surfaces
from tests.support.photos.posed_pictures import SIDE, photographs, printed
from tests.support.scenes import film, orbit, table_with_sphere

SHEET = printed(surfaces.patch(lambda u, v: [u, v, 0.05 * np.sin(6 * u)], 200, 200))
EYES = ((0.2, 0.1, 1.4), (-0.3, 0.1, 1.3), (0.1, -0.4, 1.3))
SIZE, CENTRE = 2.5, np.array([3.0, -1.0, 7.0])  # of the capture: its unit frame is that of the sheet
FAULTLESS = PhotoFigures(photos=1, cover=1.0, lace=0.0, inside_out=0.0, leak=0.0)


def view(picture: PosedPicture) -> TextureView:
    """The photo of the sheet as one of a capture that is `SIZE` times larger, somewhere else."""
    camera = Intrinsics(SIDE, SIDE, SIDE / 2 - 0.5, SIDE / 2 - 0.5, SIDE, SIDE)
    pose = np.linalg.inv(picture.to_camera)
    pose[:3, 3] = SIZE * pose[:3, 3] + CENTRE
    return TextureView(
        camera.scaled_to(50, 50), pose, picture.load_rgb, lambda: SIZE * picture.depth(), f"{picture.name}.jpg"
    )


def points(held_out: tuple[TextureView, ...], textures: tuple[TextureView, ...] = ()) -> Points:
    xyz = np.zeros((1, 3))
    return Points(xyz, None, np.ones(1, np.float32), 1.0, "metric", None, (), (), textures, held_out)


def measured(mesh: Mesh = SHEET) -> tuple[PhotoCheck, Points]:
    """The mesh beside two photos of the sheet, and the capture's points."""
    *held_out, other = map(view, photographs(SHEET, EYES))
    known = points(tuple(held_out), (other,))
    return check_surface_with_photos(mesh, known, UnitFrame(centre=CENTRE, size=SIZE)), known


def to_asset() -> Floats:
    """(4,4) half a metre per unit, the capture's Z up, somewhere else."""
    placed = np.eye(4)
    placed[:3, :3] = 0.5 * np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
    placed[:3, 3] = -0.3, 0.1, 0.7
    return placed


def in_asset(mesh: Mesh, placed: Floats) -> Mesh:
    """The mesh in the unit frame, moved to the asset's."""
    capture = SIZE * mesh.vertices + CENTRE
    return Mesh(capture @ placed[:3, :3].T + placed[:3, 3], mesh.faces, mesh.rgb)


def check_of(name: str, **figures: float) -> SurfaceCheck:
    """A check of which the figures and the photo's name count."""
    nothing: Any = None
    photo = PosedPicture(np.eye(4), np.ones(2), np.full(2, 0.5), nothing, name=name)
    return SurfaceCheck(photo, *[nothing] * 6, replace(FAULTLESS, **figures))


def test_surface_and_colours_are_compared_in_the_frames_of_unit_and_asset() -> None:
    check, known = measured()
    assert check.figures == replace(FAULTLESS, photos=2, depth=1.0)
    first, second, third = (np.array(each) / np.linalg.norm(each) for each in EYES)
    nearest = [
        max(first @ second, first @ third),
        max(second @ first, second @ third),
        max(third @ first, third @ second),
    ]
    assert check.apart == pytest.approx(np.degrees(np.arccos(np.median(nearest))), abs=0.1)
    pairs = check_textures_with_photos(in_asset(SHEET, to_asset()), check, known, to_asset())
    figures = figures_with_textures(check, pairs)
    assert figures is not None
    assert figures.psnr is not None
    assert figures.psnr > 40
    assert figures.cover == 1


@pytest.mark.parametrize(("shape", "flat"), [(SHEET, True), (surfaces.hemisphere(), False)])
def test_a_relief_is_told_from_half_an_object_that_was_shot_from_one_side(shape: Mesh, flat: bool) -> None:
    known = points(tuple(map(view, photographs(shape, EYES))))
    check = check_surface_with_photos(shape, known, UnitFrame(centre=CENTRE, size=SIZE))
    assert check.one_side > 15
    assert check.flat == flat


def test_each_rendering_is_beside_its_own_photo_where_one_shows_nothing() -> None:
    """The first of three photos looks past the thing, so that the checks are fewer than the photos."""
    away = photographs(Mesh(SHEET.vertices + 40, SHEET.faces), [(0.0, 0.3, 1.4)])[0]
    seeing = photographs(SHEET, EYES[:2])
    elsewhere = replace(view(away), camera_to_world=view(away).camera_to_world @ np.diag([1.0, -1, -1, 1]), name="away")
    known = points((elsewhere, *map(view, seeing)))
    check = check_surface_with_photos(SHEET, known, UnitFrame(centre=CENTRE, size=SIZE))
    assert [each.picture.name for each in check.surface] == ["0.jpg", "1.jpg"]
    pairs = check_textures_with_photos(in_asset(SHEET, to_asset()), check, known, to_asset())
    assert [pair.psnr > 40 for pair in pairs] == [True, True]


@pytest.mark.slow
def test_a_photo_keeps_its_camera_in_another_frame() -> None:
    """The middle of a pixel is where it was, at any resolution of the intrinsics."""
    (photo,) = photographs(SHEET, EYES[:1])
    placed = to_asset()
    posed = posed_picture(view(photo), placed)
    at, depth = photo.project(SHEET.vertices)
    again, deep = posed.project(in_asset(SHEET, placed).vertices)
    assert again == pytest.approx(at, abs=1e-9)
    assert deep == pytest.approx(SIZE * depth), "in the units of the depth image"
    assert posed.name == "0.jpg"


def test_a_hole_is_warned_of_with_the_photo_that_shows_it_most() -> None:
    check = PhotoCheck((check_of("a.jpg", lace=0.02, cover=0.97), check_of("b.jpg", lace=0.1, cover=0.87)))
    (warning,) = check.warnings()
    assert "6% of what your photos show of the object is missing" in warning
    assert "b.jpg" in warning
    assert "a.jpg" not in warning


def test_cover_alone_is_no_warning_because_it_may_count_the_ground_below() -> None:
    assert PhotoCheck((check_of("a.jpg", cover=0.9),)).warnings() == ()


def test_insides_and_leaks_are_warned_of() -> None:
    inside, leak = PhotoCheck(
        (check_of("a.jpg", inside_out=0.1), check_of("b.jpg", leak=0.08), check_of("c.jpg", leak=0.04))
    ).warnings()
    assert inside.startswith("3% of what is seen is the inside of the object")
    assert leak.startswith("4% of the surface lies where your photos show background")
    assert "b.jpg" in leak


@pytest.mark.parametrize("checks", [(), (check_of("a.jpg", lace=0.01, inside_out=0.02, leak=0.02, cover=0.98),)])
def test_nothing_is_warned_of_without_photos_or_without_faults(checks: tuple[SurfaceCheck, ...]) -> None:
    assert PhotoCheck(checks).warnings() == ()


def test_without_photos_there_are_no_figures_and_no_pictures() -> None:
    check = check_surface_with_photos(SHEET, points(()), UnitFrame(centre=CENTRE, size=SIZE))
    assert check == PhotoCheck()
    assert check.figures is None
    assert figures_with_textures(check, check_textures_with_photos(SHEET, check, points(()), np.eye(4))) is None
    assert marked_pictures(check, []) == {}


@pytest.mark.parametrize("coloured", [True, False])
def test_marked_pictures_are_jpegs_of_photo_beside_rendering(coloured: bool) -> None:
    check, known = measured()
    asset = in_asset(SHEET if coloured else Mesh(SHEET.vertices, SHEET.faces), to_asset())
    pairs = check_textures_with_photos(asset, check, known, to_asset())
    assert len(pairs) == (2 if coloured else 0)
    figures = figures_with_textures(check, pairs)
    assert figures is not None
    assert (figures.psnr is None) == (not coloured)
    pictures = marked_pictures(check, pairs)
    assert list(pictures) == ["photo-1.jpg", "photo-2.jpg"]
    for jpeg in pictures.values():
        with Image.open(io.BytesIO(jpeg)) as picture:
            assert (picture.format, picture.size) == ("JPEG", (2 * SIDE, SIDE))


@pytest.mark.slow
@pytest.mark.usefixtures("small_pictures")
def test_a_capture_of_many_pictures_ends_with_their_figures() -> None:
    frames = film(table_with_sphere(), orbit(16, radius=0.7, height=0.5))
    preset = Preset("coarse", resolution=48, most_points=10_000, lod_faces=(2_000,))
    steps = reconstruct(Capture("rgbd", "test", frames=frames), preset, JobOptions(cut="scene"))
    *_, bundle = [step for step in steps if isinstance(step, Bundle)]
    figures = bundle.manifest["quality"]["photos"]
    assert figures["photos"] == 2
    assert figures["worst_lace"] >= figures["lace"]
    assert bundle.manifest["quality"]["grade"]["level"] in {"good", "usable", "incomplete"}
    assert figures["cover"] > 0.95
    assert figures["lace"] < 0.02
    assert figures["psnr"] > 15
    assert sorted(bundle.private) == ["origin.png", "photo-1.jpg", "photo-2.jpg"]
    assert not bundle.private.keys() & bundle.files.keys()
