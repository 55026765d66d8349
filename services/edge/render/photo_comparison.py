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

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from io import BytesIO
from typing import Any

import numpy as np

from services.edge.arrays import Bools, Bytes, Floats, Ints
from services.edge.mesh.normals import face_normals
from services.edge.mesh.nouns import Mesh, TexturedMesh
from services.edge.parallel import in_threads
from services.edge.render.posed_picture import PosedPicture
from services.edge.render.rays import Hits, Scene, pinhole
from services.edge.render.sample_image import bilinear, pixels_at, shrink_to

LONGEST_PX = 480
"""Longer side of the pictures in which surfaces are compared: a hole of 1 % of the picture is then 5 pixels wide."""
LIKENESS_PX = 960
"""Longer side of the pictures in which colours are compared."""
_CLOSED = 0.02  # radius of the closing of a silhouette, of the root of its area: holes that reach the outline
_AROUND = 0.08  # reach of what is searched for parts of the thing that the mesh lacks, of the same length
_CORE = 0.01  # how far inside the mesh's outline the photo surely shows the thing
_ASIDE = 0.02  # of the mesh's longest side: what the photo's depth shows as far from the mesh is not the thing
_PAST = 0.04  # relative depth by which a photo that looks past a place sees farther
_AGREES = 0.02  # relative depth within which a photo's depth and a place are one surface
_MEETS = 0.01  # of the depth: the mesh meets it
_FACING = 0.1  # least cosine of a place's normal in a photo that sees it
_ROUNDS = 3  # of GrabCut
_OUTLINE_PX = 1  # how well an outline is known: less beside it is no leak
_LEAST_GROUND = 0.02  # of the picture: with less background around the thing nothing is cut out
_LEAST_PIXELS = 200  # of the silhouette; a photo that shows less of the mesh says nothing
_SAMPLES = 2  # per pixel and axis: a texture finer than the pixels would look sharper than it is
_PROBES = 20_000  # pixels of a photo for which it is asked which side the other photos saw
_HOLE, _INSIDE, _LEAK = (255, 0, 255), (255, 200, 0), (0, 200, 255)  # sRGB signal colours of the marked pictures


@dataclass(frozen=True, slots=True)
class PhotoFigures:
    """Mean figures over the compared photos, in [0,1] but for psnr in dB; None where it cannot be measured.

    photos  number of photos; the other fields as in the module's text
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
    photos: Iterable[PosedPicture],
    seen_by: Sequence[PosedPicture],
    mask_of: Callable[[PosedPicture], Bools | None] = lambda _: None,
) -> list[SurfaceCheck]:
    """Compare a mesh's surface with photos that it was not made from, in whose frame it is.

    seen_by  the photos that it was made from, with their depth: which side of a surface they saw
    mask_of  the mask (h,w) of the thing in a photo, of any size, where it is known
    """
    pictures = [*photos]
    if not pictures:
        return []
    scene, normals = Scene(mesh), face_normals(mesh.vertices, mesh.faces)
    depths = [picture.depth() for picture in seen_by]
    checks = in_threads(lambda photo: _check(photo, mesh, scene, normals, seen_by, depths, mask_of(photo)), pictures)
    return [check for check in checks if check is not None]


def check_likeness(
    subject: Mesh | TexturedMesh, photos: Sequence[PosedPicture], things: Sequence[Bools]
) -> list[LikenessCheck]:
    """Compare renderings of a coloured mesh with photos in its frame, each where its mask (h,w) shows the thing."""
    scene = Scene(subject.mesh if isinstance(subject, TexturedMesh) else subject)
    colours = _colours_of(subject)
    pairs = [*zip(photos, things, strict=True)]
    return in_threads(lambda pair: _likeness(*pair, scene, colours), pairs)


def mean_figures(checks: Sequence[SurfaceCheck], likeness: Sequence[LikenessCheck] = ()) -> PhotoFigures | None:
    """Average the figures over photos; None without any."""
    if not checks:
        return None
    each = [check.figures for check in checks]
    alike = [pair for pair in likeness if pair.ssim > 0]  # 0: the rendering and the photo share no pixels
    depths = [figures.depth for figures in each if figures.depth is not None]
    return PhotoFigures(
        photos=len(checks),
        cover=_mean([figures.cover for figures in each]),
        lace=_mean([figures.lace for figures in each]),
        inside_out=_mean([figures.inside_out for figures in each]),
        leak=_mean([figures.leak for figures in each]),
        depth=_mean(depths) if depths else None,
        psnr=_mean([pair.psnr for pair in alike]) if alike else None,
        ssim=_mean([pair.ssim for pair in alike]) if alike else None,
        sharp=_mean([pair.sharp for pair in alike]) if alike else None,
    )


def _mean(values: Sequence[float]) -> float:
    return round(float(np.mean(values)), 5)


def marked_jpeg(check: SurfaceCheck, likeness: LikenessCheck | None = None, quality: int = 85) -> bytes:
    """Encode the photo beside the rendering as JPEG: holes magenta, insides yellow, leaks cyan.

    The photo is darkened where the thing is not; without a likeness the right half shows the photo's colours on the
    mesh.
    """
    from PIL import Image

    photo = check.rgb if likeness is None else likeness.photo
    shown = np.where(check.mesh[..., None], check.rgb, 32).astype(np.uint8) if likeness is None else likeness.rendering
    size = (photo.shape[1], photo.shape[0])
    shown = shown.copy()
    for mask, colour in ((check.hole, _HOLE), (check.inside, _INSIDE), (check.leak, _LEAK)):
        shown[_resize_mask(mask, size)] = colour
    thing = _resize_mask(check.thing, size)
    left = np.where(thing[..., None], photo, photo // 3)
    stream = BytesIO()
    Image.fromarray(np.concatenate([left, shown], axis=1)).save(stream, "JPEG", quality=quality)
    return stream.getvalue()


def _check(
    picture: PosedPicture,
    mesh: Mesh,
    scene: Scene,
    normals: Floats,
    seen_by: Sequence[PosedPicture],
    depths: Sequence[Floats],
    known: Bools | None,
) -> SurfaceCheck | None:
    import cv2

    rgb = shrink_to(picture.load_rgb(), LONGEST_PX)
    height, width = rgb.shape[:2]
    hits, rays = _cast(picture, scene, width, height)
    found = (hits.face >= 0).reshape(height, width)
    whole = _filled_silhouette(found)
    if whole.sum() < _LEAST_PIXELS:
        return None
    z = np.where(found, hits.along.reshape(height, width), 0)  # the rays have depth 1 along the optical axis
    own = cv2.resize(picture.depth(), (width, height), interpolation=cv2.INTER_NEAREST)
    past = (own > 0) & (own > (1 + _PAST) * _nearest_known(z, found))
    if known is None:
        places = picture.eye + own.reshape(-1, 1) * rays
        aside = (own > 0) & ~whole & (scene.longest > 0)
        aside[aside] = _far_from(places[aside.ravel()], mesh, _ASIDE * scene.longest)
        thing = _cut_out(rgb, found, whole, past | aside)
    else:
        thing = _resize_mask(known, (width, height))
    inside = np.zeros(found.size, bool)
    step = max(1, int(found.sum()) // _PROBES)
    probes = np.flatnonzero(found)[::step]
    places = picture.eye + hits.along[probes, None] * rays[probes]
    wrong = _shows_back(places, normals[hits.face[probes]], picture.eye, seen_by, depths)
    inside[probes] = wrong
    if step > 1:  # the pixels between the probes, for the picture
        inside = cv2.dilate(inside.reshape(height, width).astype(np.uint8), np.ones((step, step), np.uint8)) > 0
    inside = inside.reshape(height, width) & found
    hole = whole & thing & ~found
    leak = found & ~(cv2.dilate(thing.astype(np.uint8), _disc(_OUTLINE_PX)) > 0)
    on = thing & (own > 0) & ~past
    figures = PhotoFigures(
        photos=1,
        cover=_share(found, thing),
        lace=_share(hole, whole & thing),
        inside_out=float(wrong.mean()) if len(wrong) else 0.0,
        leak=_share(leak, found),
        depth=_share(found & (np.abs(z - own) < _MEETS * own), on) if on.any() else None,
    )
    return SurfaceCheck(picture, rgb, found, thing, hole, inside, leak, figures)


def _cast(picture: PosedPicture, scene: Scene, width: int, height: int) -> tuple[Hits, Floats]:
    """Cast a ray through every pixel; also return the rays (N,3), whose length along the optical axis is 1 of the
    camera's units."""
    back = np.linalg.inv(picture.to_camera)[:3, :3]
    x = ((np.arange(width) + 0.5) / width - picture.middle[0]) / picture.focal[0]
    y = ((np.arange(height) + 0.5) / height - picture.middle[1]) / picture.focal[1]
    rays = pinhole(x, y, *back.T)
    return scene.cast(picture.eye[None], rays), rays


def _filled_silhouette(found: Bools) -> Bools:
    """Close the gaps of a mask (h,w) and fill its holes."""
    import cv2
    from scipy.ndimage import binary_fill_holes

    radius = max(2, round(_CLOSED * float(np.sqrt(found.sum()))))
    padded = np.pad(found.astype(np.uint8), radius)
    closed = cv2.morphologyEx(padded, cv2.MORPH_CLOSE, _disc(radius))[radius:-radius, radius:-radius]
    return np.asarray(binary_fill_holes(closed > 0))


def _disc(radius: int) -> Bytes:
    import cv2

    return np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1,) * 2), np.uint8)


def _nearest_known(z: Floats, found: Bools) -> Floats:
    """Depth (h,w) of the mesh, and where it is not, of the mesh's nearest pixel."""
    import cv2

    if found.all():
        return z
    _, label = cv2.distanceTransformWithLabels(
        (~found).astype(np.uint8), cv2.DIST_L2, 3, labelType=cv2.DIST_LABEL_PIXEL
    )
    of_label = np.zeros(label.max() + 1, z.dtype)
    of_label[label[found]] = z[found]
    nearest: Floats = of_label[label]
    return nearest


def _far_from(places: Floats, mesh: Mesh, reach: float) -> Bools:
    """(N,) whether places lie farther from every vertex of the mesh."""
    from scipy.spatial import cKDTree

    step = max(1, len(mesh.vertices) // _PROBES)
    away, _ = cKDTree(mesh.vertices[::step]).query(places, distance_upper_bound=reach)
    return np.asarray(~np.isfinite(away))


def _cut_out(rgb: Bytes, found: Bools, whole: Bools, past: Bools) -> Bools:
    """Find the thing in a photo (h,w): near the mesh's silhouette, without what is known to be something else."""
    import cv2

    length = float(np.sqrt(whole.sum()))
    around = cv2.dilate(whole.astype(np.uint8), _disc(max(3, round(_AROUND * length)))) > 0
    core = cv2.erode(found.astype(np.uint8), _disc(max(2, round(_CORE * length)))) > 0
    ground = ~around | past
    if ground.mean() < _LEAST_GROUND or not (core & ~past).any():
        return whole & ~past
    labels = np.full(found.shape, cv2.GC_PR_BGD, np.uint8)
    labels[whole] = cv2.GC_PR_FGD
    labels[core] = cv2.GC_FGD
    labels[ground] = cv2.GC_BGD
    models = np.zeros((1, 65)), np.zeros((1, 65))
    cv2.setRNGSeed(0)  # GrabCut draws its first colour clusters
    cv2.grabCut(np.ascontiguousarray(rgb[..., ::-1]), labels, (0, 0, 0, 0), *models, _ROUNDS, cv2.GC_INIT_WITH_MASK)
    return np.asarray((labels == cv2.GC_FGD) | (labels == cv2.GC_PR_FGD))


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


def _likeness(picture: PosedPicture, thing: Bools, scene: Scene, colours: Callable[[Hits], Floats]) -> LikenessCheck:
    import cv2
    from skimage.metrics import structural_similarity

    photo = shrink_to(picture.load_rgb(), LIKENESS_PX)
    height, width = photo.shape[:2]
    fine = (_SAMPLES * width, _SAMPLES * height)
    hits, _ = _cast(picture, scene, *fine)
    met = hits.face >= 0
    drawn = np.full((len(met), 3), 32, np.float32)
    drawn[met] = colours(Hits(hits.face[met], hits.along[met], hits.bary[met]))
    rendering = cv2.resize(drawn.reshape(*fine[::-1], 3), (width, height), interpolation=cv2.INTER_AREA)
    found = cv2.resize(met.reshape(fine[::-1]).astype(np.float32), (width, height), interpolation=cv2.INTER_AREA) == 1
    shown = _resize_mask(thing, (width, height))
    both = cv2.erode((shown & found).astype(np.uint8), _disc(2)) > 0
    if not both.any():
        return LikenessCheck(photo, np.clip(rendering, 0, 255).astype(np.uint8), 0.0, 0.0, 0.0)
    true = photo.astype(np.float32)
    gain = (rendering[both] * true[both]).sum(axis=0) / np.maximum(np.square(rendering[both]).sum(axis=0), 1e-9)
    rendering = np.clip(rendering * gain, 0, 255)
    error = float(np.square(rendering[both] - true[both]).mean())
    grey_true, grey = (cv2.cvtColor(each, cv2.COLOR_RGB2GRAY) for each in (true, rendering.astype(np.float32)))
    ssim: Any = structural_similarity  # the library has no types
    _, similar = ssim(grey_true, grey, data_range=255, full=True)
    edges = [cv2.Laplacian(each, cv2.CV_32F)[both].var() for each in (grey, grey_true)]
    return LikenessCheck(
        photo,
        rendering.astype(np.uint8),
        psnr=10 * float(np.log10(255**2 / max(error, 1e-6))),
        ssim=float(similar[both].mean()),
        sharp=float(edges[0] / max(edges[1], 1e-6)),
    )


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


def _resize_mask(mask: Bools, size: tuple[int, int]) -> Bools:
    """Resize a mask to (width, height)."""
    import cv2

    return np.asarray(cv2.resize(mask.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0)


def _share(part: Bools, whole: Bools) -> float:
    """Share of `whole` in which `part` is; 0 where there is nothing."""
    total = int(whole.sum())
    return int((part & whole).sum()) / total if total else 0.0
