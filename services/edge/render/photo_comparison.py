"""Compare a mesh with photos that it was not made from: holes, surface that should not be there, and likeness.

No true surface is needed. The mesh is rendered from the photo's own camera, and compared with what the photo shows:

S      silhouette of the mesh, its gaps closed and its holes filled
T      the thing in the photo: S, less what the photo shows to be background, by its depth or by its colours (GrabCut,
       Rother et al. 2004, started from S); or a mask that is known. Near the outline T errs by what stands there: cover
       may count the ground that a thing was cut from, lace never does
cover  share of T where the mesh is
lace   share of S ∩ T without mesh: holes
inside_out  share of the mesh's pixels that show the back of a surface whose front other photos saw: the inside of a
       thing through a hole
leak   share of the mesh's pixels more than a pixel outside T: rims of background, flying pieces
depth  share of the photo's own depth on the thing that the mesh meets within 1 %
psnr, ssim  likeness of the rendering and the photo, where both show the thing, after one gain per channel
sharp  variance of the Laplacian of the rendering over the photo's: 1 is as sharp as the photo
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from io import BytesIO
from typing import Any

import numpy as np

from capture2vr.edge.arrays import Bools, Bytes, Floats, Ints
from capture2vr.edge.mesh.normals import face_normals
from capture2vr.edge.mesh.nouns import Mesh, TexturedMesh
from capture2vr.edge.parallel import in_threads
from capture2vr.edge.render.posed_picture import PosedPicture
from capture2vr.edge.render.rays import Hits, RaycastingScene
from capture2vr.edge.render.sample_image import bilinear, pixels_at, resize_mask, shrink_to
from capture2vr.edge.render.silhouette import (
    MeshInPhoto,
    beyond,
    cast_pixels,
    colours_of,
    disc,
    outline_thing,
    see_mesh,
)

LIKENESS_PX = 960
"""Longer side of the pictures in which colours are compared."""
_AGREES = 0.02  # relative depth within which a photo's depth and a place are one surface
_MEETS = 0.01  # of the depth: the mesh meets it
_FACING = 0.1  # least cosine of a place's normal in a photo that sees it
_SAMPLES = 2  # per pixel and axis: a texture finer than the pixels would look sharper than it is
_PROBES = 20_000  # pixels of a photo for which it is asked which side the other photos saw


@dataclass(frozen=True, slots=True)
class PhotoFigures:
    """Mean figures over the compared photos, in [0,1] but for psnr in dB; None where it cannot be measured.

    photos  number of photos; worst_lace: the lace of the one with the largest; the other fields as in the module's text
    """

    photos: int
    cover: float
    lace: float
    inside_out: float
    leak: float
    depth: float | None = None
    psnr: float | None = None
    ssim: float | None = None
    sharp: float | None = None
    worst_lace: float = 0.0


@dataclass(frozen=True, slots=True)
class SurfaceCheck:
    """A mesh seen from one photo's camera, at `LONGEST_PX`.

    rgb (h,w,3) the photo; mesh, thing, hole, inside, leak (h,w) masks as in the module's text; figures of this photo
    """

    picture: PosedPicture
    rgb: Bytes
    mesh: Bools
    thing: Bools
    hole: Bools
    inside: Bools
    leak: Bools
    figures: PhotoFigures


@dataclass(frozen=True, slots=True)
class LikenessCheck:
    """A rendering beside its photo at `LIKENESS_PX`: photo and rendering (h,w,3) uint8, and the figures of the pair."""

    photo: Bytes
    rendering: Bytes
    psnr: float
    ssim: float
    sharp: float


def check_surface(
    mesh: Mesh,
    photos: Sequence[PosedPicture],
    seen_by: Sequence[PosedPicture],
) -> list[SurfaceCheck]:
    """Compare a mesh's surface with photos that it was not made from, in whose frame it is.

    seen_by  the photos that it was made from, with their depth: which side of a surface they saw
    """
    if not photos:
        return []
    scene, normals = RaycastingScene(mesh), face_normals(mesh.vertices, mesh.faces)
    depths = [picture.depth() for picture in seen_by]
    colours = colours_of(mesh, [*seen_by, *photos])

    def check(photo: PosedPicture) -> SurfaceCheck | None:
        view = see_mesh(photo, scene)
        if view is None:
            return None
        thing = outline_thing(view, photo, mesh, scene, colours)
        return _check(photo, view, thing, normals, seen_by, depths)

    return [found for found in in_threads(check, photos) if found is not None]


def check_likeness(
    subject: Mesh | TexturedMesh, photos: Sequence[PosedPicture], things: Sequence[Bools]
) -> list[LikenessCheck]:
    """Compare renderings of a coloured mesh with photos in its frame, each where its mask (h,w) shows the thing."""
    scene = RaycastingScene(subject.mesh if isinstance(subject, TexturedMesh) else subject)
    colours = _colours_of(subject)
    pairs = [*zip(photos, things, strict=True)]
    return in_threads(lambda pair: _likeness(*pair, scene, colours), pairs)


def mean_figures(checks: Sequence[SurfaceCheck], likeness: Sequence[LikenessCheck] = ()) -> PhotoFigures | None:
    """Average the figures over photos; None without any."""
    if not checks:
        return None
    alike = [pair for pair in likeness if pair.ssim > 0]  # 0: the rendering and the photo share no pixels
    return PhotoFigures(
        photos=len(checks),
        cover=_mean([check.figures.cover for check in checks]),
        lace=_mean([check.figures.lace for check in checks]),
        inside_out=_mean([check.figures.inside_out for check in checks]),
        leak=_mean([check.figures.leak for check in checks]),
        depth=_mean_of_known([check.figures.depth for check in checks]),
        psnr=_mean_of_known([pair.psnr for pair in alike]),
        ssim=_mean_of_known([pair.ssim for pair in alike]),
        sharp=_mean_of_known([pair.sharp for pair in alike]),
        worst_lace=round(worst_photo(checks).figures.lace, 5),
    )


def worst_photo(checks: Sequence[SurfaceCheck]) -> SurfaceCheck:
    """Return the check of the photo that shows most holes."""
    return max(checks, key=lambda check: check.figures.lace)


def _mean(values: Sequence[float]) -> float:
    return round(float(np.mean(values)), 5)


def _mean_of_known(values: Sequence[float | None]) -> float | None:
    """The mean of those that are known; None without any."""
    known = [value for value in values if value is not None]
    return _mean(known) if known else None


def _check(
    picture: PosedPicture,
    view: MeshInPhoto,
    thing: Bools,
    normals: Floats,
    seen_by: Sequence[PosedPicture],
    depths: Sequence[Floats],
) -> SurfaceCheck:
    import cv2

    found, whole, z, own, past = view.found, view.whole, view.z, view.own, view.past
    height, width = found.shape
    inside = np.zeros(found.size, bool)
    step = max(1, int(found.sum()) // _PROBES)
    probes = np.flatnonzero(found)[::step]
    places = picture.eye + view.hits.along[probes, None] * view.rays[probes]
    wrong = _shows_back(places, normals[view.hits.face[probes]], picture.eye, seen_by, depths)
    inside[probes] = wrong
    if step > 1:  # the pixels between the probes, for the picture
        inside = cv2.dilate(inside.reshape(height, width).astype(np.uint8), np.ones((step, step), np.uint8)) > 0
    inside = inside.reshape(height, width) & found
    hole = whole & thing & ~found
    leak = found & beyond(thing)
    on = thing & (own > 0) & ~past
    figures = PhotoFigures(
        photos=1,
        cover=_share(found, thing),
        lace=_share(hole, whole & thing),
        inside_out=float(wrong.mean()) if len(wrong) else 0.0,
        leak=_share(leak, found),
        depth=_share(found & (np.abs(z - own) < _MEETS * own), on) if on.any() else None,
    )
    return SurfaceCheck(picture, view.rgb, found, thing, hole, inside, leak, figures)


def _shows_back(
    places: Floats, normals: Floats, eye: Floats, seen_by: Sequence[PosedPicture], depths: Sequence[Floats]
) -> Bools:
    """(N,) whether no photo saw the side of the place that faces `eye`, but one saw its other side."""
    unit = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    side = np.sign(np.einsum("nx,nx->n", eye - places, unit))
    this, other = np.zeros(len(places), bool), np.zeros(len(places), bool)
    for picture, depth in zip(seen_by, depths, strict=True):
        at, z = picture.project(places)
        towards = picture.eye - places
        cosine = side * np.einsum("nx,nx->n", towards, unit) / np.maximum(np.linalg.norm(towards, axis=1), 1e-30)
        inside = (z > 0) & (np.minimum(at, 1 - at).min(axis=1) > 0)
        found = pixels_at(depth, at)
        seen = inside & (found > 0) & (np.abs(z - found) < _AGREES * found)
        this |= seen & (cosine > _FACING)
        other |= seen & (cosine < -_FACING)
    return ~this & other


def _likeness(
    picture: PosedPicture, thing: Bools, scene: RaycastingScene, colours: Callable[[Hits], Floats]
) -> LikenessCheck:
    import cv2

    photo = shrink_to(picture.load_rgb(), LIKENESS_PX)
    height, width = photo.shape[:2]
    fine = (_SAMPLES * width, _SAMPLES * height)
    hits, _ = cast_pixels(picture, scene, *fine)
    met = hits.face >= 0
    drawn = np.full((len(met), 3), 32, np.float32)
    drawn[met] = colours(Hits(hits.face[met], hits.along[met], hits.bary[met]))
    rendering = cv2.resize(drawn.reshape(*fine[::-1], 3), (width, height), interpolation=cv2.INTER_AREA)
    found = cv2.resize(met.reshape(fine[::-1]).astype(np.float32), (width, height), interpolation=cv2.INTER_AREA) == 1
    shown = resize_mask(thing, (width, height))
    both = cv2.erode((shown & found).astype(np.uint8), disc(2)) > 0
    return compare_colours(photo, np.asarray(rendering, np.float32), both)


def compare_colours(photo: Bytes, rendering: Floats, both: Bools) -> LikenessCheck:
    """Compare a rendering (h,w,3), sRGB bytes as numbers, with its photo (h,w,3) in the pixels `both` (h,w)."""
    import cv2
    from skimage.metrics import structural_similarity

    if not both.any():
        return LikenessCheck(photo, np.clip(rendering, 0, 255).astype(np.uint8), 0.0, 0.0, 0.0)
    true = photo.astype(np.float32)
    gain = (rendering[both] * true[both]).sum(axis=0) / np.maximum(np.square(rendering[both]).sum(axis=0), 1e-9)
    rendering = np.clip(rendering * gain, 0, 255)
    error = float(np.square(rendering[both] - true[both]).mean())
    both_rgb = (true, rendering.astype(np.float32))
    grey_true, grey = (np.asarray(cv2.cvtColor(each, cv2.COLOR_RGB2GRAY), np.float32) for each in both_rgb)
    ssim: Any = structural_similarity  # the library has no types
    _, similar = ssim(grey_true, grey, data_range=255, full=True)
    return LikenessCheck(
        photo,
        rendering.astype(np.uint8),
        psnr=10 * float(np.log10(255**2 / max(error, 1e-6))),
        ssim=float(similar[both].mean()),
        sharp=relative_sharpness(grey, grey_true, both),
    )


def relative_sharpness(grey: Floats, reference: Floats, within: Bools) -> float:
    """Return the variance of the Laplacian of `grey` (H,W) over that of `reference` (H,W), in the pixels `within`."""
    import cv2

    one, other = (float(cv2.Laplacian(each, cv2.CV_32F)[within].var()) for each in (grey, reference))
    return one / max(other, 1e-6)


def _colours_of(subject: Mesh | TexturedMesh) -> Callable[[Hits], Floats]:
    """Return a function from hits to unlit colours (N,3) float32, sRGB bytes."""
    if isinstance(subject, Mesh):
        assert subject.rgb is not None, "a mesh without colours has no likeness"
        rgb, faces = subject.rgb.astype(np.float32), subject.faces
        return lambda hits: _interpolate(rgb, faces, hits)
    picture, uv, corners = _decode(subject.jpeg), subject.uv.astype(np.float32), subject.mesh.faces
    return lambda hits: bilinear(picture, _interpolate(uv, corners, hits))


def _interpolate(values: Floats, faces: Ints, hits: Hits) -> Floats:
    mixed: Floats = np.einsum("nk,nkc->nc", hits.bary, values[faces[hits.face]])
    return mixed


def _decode(jpeg: bytes) -> Bytes:
    from PIL import Image

    with Image.open(BytesIO(jpeg)) as image:
        return np.asarray(image.convert("RGB"))


def _share(part: Bools, whole: Bools) -> float:
    """Share of `whole` in which `part` is; 0 where there is nothing."""
    total = int(whole.sum())
    return int((part & whole).sum()) / total if total else 0.0
