"""Train splats that cover a mesh until they look like the photos.

The parameters and the loss are those of B. Kerbl et al. (2023): 0.8 · L1 + 0.2 · (1 − SSIM) for one photo a step, Adam.
Differences: all splats are there from the start, evenly spread on the mesh, so that none are split or added; their
colours do not change with the direction; and each photo has a gain for each colour channel, because phones change
exposure and white balance on the way.

The photos show more than the thing. Where it is, its splats are drawn over a random colour, so that they must cover it,
also where it is more than its mesh; around it they must cover nothing. Along its outline, which is known to some
pixels, and where a depth image shows something in front of the mesh, nothing is compared: splats there would take the
colours of what is behind the thing, or in front of it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from capture2vr.edge.arrays import Bools, Floats, Tick, no_tick, part_of
from capture2vr.edge.errors import EdgeError
from capture2vr.edge.field.compute import translate_memory_errors
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.render.posed_picture import PosedPicture
from capture2vr.edge.render.rays import RaycastingScene
from capture2vr.edge.render.sample_image import shrink_to
from capture2vr.edge.render.silhouette import colours_of, disc, outline_thing, see_mesh
from capture2vr.edge.splat_training.splat_rendering import PinholeView, SplatTensors, draw_splats
from capture2vr.edge.splats.surface_splats import THINNEST_M, Splats
from capture2vr.sentences.sentence import say

LONGEST_PX = 640
"""Longer side of the photos that splats are compared with: a headset shows a thing at arm's length about as large."""
_LOADING_SHARE = 0.1  # of the time goes into loading photos
_STRUCTURE = 0.2  # weight of 1 − SSIM
_WINDOW, _SIGMA = 11, 1.5  # of SSIM: Z. Wang et al. (2004)
_C1, _C2 = 0.01**2, 0.03**2
# First learning rates of Adam, each in the units of its parameter.
_PLACE = 0.05  # widths of a splat
_TURN, _SIZE, _OPACITY, _COLOUR, _GAIN = 0.01, 0.02, 0.05, 0.03, 0.002
_UNSURE = 0.006  # of a photo's longer side: how well the thing's outline is known
_LAST_RATE = 0.1  # of the first
_WIDEST = 10.0  # times its first width that a splat may have
_GONE = 0.02  # opacity of splats that are left out at the end


@dataclass(frozen=True, slots=True)
class _Photo:
    """A photo: rgb (H,W,3) uint8; thing, around (H,W) where it surely shows the thing, and surely does not."""

    rgb: Tensor
    thing: Tensor
    around: Tensor
    view: PinholeView


def train_splats(
    splats: Splats,
    mesh: Mesh,
    pictures: Sequence[PosedPicture],
    *,
    steps: int,
    device: str = "cpu",
    tick: Tick = no_tick,
) -> Splats:
    """Train splats that cover a mesh, against photos in their frame. The same input gives the same splats on a CPU.

    Raises EdgeError SPLATS_UNSEEN where no photo shows the mesh, SPLATS_DIVERGED, GPU_OOM.
    """
    with translate_memory_errors(f"a training of {len(splats):,} splats"):
        photos = _load(mesh, pictures, torch.device(device), part_of(tick, 0, _LOADING_SHARE))
        run = _Training(splats, len(photos), steps, torch.device(device))
        for step, number in zip(range(steps), _numbers(len(photos)), strict=False):
            run.descend(photos[number], number)
            tick(_LOADING_SHARE + (1 - _LOADING_SHARE) * (step + 1) / steps)
        return run.splats()


def _numbers(count: int) -> Iterator[int]:
    """Yield the photos' numbers, all in a new order in every round."""
    rng = np.random.default_rng(0)
    while True:
        yield from map(int, rng.permutation(count))


def _load(mesh: Mesh, pictures: Sequence[PosedPicture], device: torch.device, tick: Tick) -> list[_Photo]:
    """Load the photos that show the mesh."""
    scene, colours, photos = RaycastingScene(mesh), colours_of(mesh, pictures), list[_Photo]()
    for number, each in enumerate(pictures):
        picture = each.loaded()  # decoded once, and looked at three times
        if (view := see_mesh(picture, scene)) is not None:
            thing = outline_thing(view, picture, mesh, scene, colours)
            unsure = disc(max(1, round(_UNSURE * max(thing.shape))))
            inner = cv2.erode((thing & ~view.hidden).astype(np.uint8), unsure) > 0
            outer = cv2.dilate((thing | view.whole | view.hidden).astype(np.uint8), unsure) > 0
            photos.append(_photo(picture, inner, ~outer, device))
        tick((number + 1) / len(pictures))
    if not photos:
        raise EdgeError("SPLATS_UNSEEN", say("no_photo_shows_mesh"), hints=(say("photograph_thing_from_all_sides"),))
    return photos


def _photo(picture: PosedPicture, thing: Bools, around: Bools, device: torch.device) -> _Photo:
    rgb = shrink_to(picture.load_rgb(), LONGEST_PX)
    height, width = rgb.shape[:2]

    def resized(mask: Bools) -> Tensor:
        sized = cv2.resize(mask.astype(np.uint8), (width, height), interpolation=cv2.INTER_NEAREST)
        return torch.tensor(sized > 0, device=device)

    view = PinholeView.of(picture, width, height, device)
    return _Photo(torch.tensor(rgb, device=device), resized(thing), resized(around), view)


class _Training:
    """The splats' parameters, each without bounds, with Adam's state."""

    def __init__(self, splats: Splats, photos: int, steps: int, device: torch.device) -> None:
        def parameter(values: Floats) -> Tensor:
            return torch.tensor(values, dtype=torch.float32, device=device, requires_grad=True)

        self._width = float(splats.scale[:, 0].mean())
        self._xyz = parameter(splats.xyz)
        self._rotation = parameter(splats.rotation)
        self._scale = parameter(np.log(splats.scale))
        self._opacity = parameter(_logit(splats.opacity))
        self._rgb = parameter(_logit(splats.rgb / 255))
        self._gains = parameter(np.zeros((photos, 3)))
        rates = {
            self._xyz: _PLACE * self._width,
            self._rotation: _TURN,
            self._scale: _SIZE,
            self._opacity: _OPACITY,
            self._rgb: _COLOUR,
            self._gains: _GAIN,
        }
        self._optimiser = torch.optim.Adam([{"params": [each], "lr": rate} for each, rate in rates.items()], eps=1e-15)
        self._schedule = torch.optim.lr_scheduler.ExponentialLR(self._optimiser, _LAST_RATE ** (1 / max(1, steps)))
        self._random = torch.Generator(device).manual_seed(0)
        self._kernel = _gaussian(device)

    def descend(self, photo: _Photo, number: int) -> None:
        """Take one step towards a photo."""
        loss = self._loss(photo, number)
        self._optimiser.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        self._optimiser.step()
        self._schedule.step()
        with torch.no_grad():
            self._scale.clamp_(math.log(THINNEST_M), math.log(_WIDEST * self._width))

    def splats(self) -> Splats:
        """The splats as they are, without those that have faded away. Raises EdgeError SPLATS_DIVERGED."""
        with torch.no_grad():
            now = self._tensors()
            arrays = [each.cpu().numpy() for each in (now.xyz, now.rotation, now.scale, now.opacity, now.rgb)]
        xyz, rotation, scale, opacity, rgb = arrays
        if not all(np.isfinite(each).all() for each in arrays):
            raise EdgeError("SPLATS_DIVERGED", say("training_splats_diverged"))
        kept = opacity >= _GONE
        rotation = rotation / np.maximum(np.linalg.norm(rotation, axis=1, keepdims=True), 1e-12)
        colours = np.rint(rgb * 255).astype(np.uint8)
        return Splats(xyz[kept], rotation[kept], scale[kept], opacity[kept], colours[kept])

    def _tensors(self) -> SplatTensors:
        opacity, rgb = torch.sigmoid(self._opacity), torch.sigmoid(self._rgb)
        return SplatTensors(self._xyz, self._rotation, torch.exp(self._scale), opacity, rgb)

    def _loss(self, photo: _Photo, number: int) -> Tensor:
        true = photo.rgb.to(torch.float32) / 255
        colours, covered = draw_splats(self._tensors(), photo.view)
        # The mean of all photos has no gain: it would be at odds with the splats' own colours.
        gain = 1 + self._gains[number] - self._gains.mean(dim=0)
        drawn = colours * gain + (1 - covered)[..., None] * torch.rand(3, generator=self._random, device=true.device)
        # SSIM looks at the pixels around, too: those that do not count are alike, and have no derivative.
        counts = photo.thing[..., None]
        true, drawn = torch.where(counts, true, drawn.detach()), torch.where(counts, drawn, drawn.detach())
        each = (1 - _STRUCTURE) * (drawn - true).abs().mean(dim=2) + _STRUCTURE * self._unlike(drawn, true)
        return ((each * photo.thing).sum() + (covered * photo.around).sum()) / photo.thing.sum().clamp(min=1)

    def _unlike(self, one: Tensor, other: Tensor) -> Tensor:
        """1 − SSIM of two pictures (H,W,3) at each pixel (H,W)."""
        a, b = one.permute(2, 0, 1)[None], other.permute(2, 0, 1)[None]
        means = self._blurred(torch.cat([a, b, a * a, b * b, a * b]))
        mean_a, mean_b, aa, bb, ab = means.unbind(0)
        alike = (2 * mean_a * mean_b + _C1) * (2 * (ab - mean_a * mean_b) + _C2)
        alike = alike / ((mean_a**2 + mean_b**2 + _C1) * (aa - mean_a**2 + bb - mean_b**2 + _C2))
        return 1 - alike.mean(dim=0)

    def _blurred(self, pictures: Tensor) -> Tensor:
        """Pictures (B,3,H,W) blurred by SSIM's window."""
        kernel, half = self._kernel.expand(3, 1, 1, _WINDOW), _WINDOW // 2
        across = functional.conv2d(pictures, kernel, padding=(0, half), groups=3)
        return functional.conv2d(across, kernel.transpose(2, 3), padding=(half, 0), groups=3)


def _logit(share: Floats) -> Floats:
    """The number whose sigmoid is a share in [0,1]; kept away from the ends, where its slope is none."""
    inner = np.clip(share, 0.01, 0.99)
    logit: Floats = np.log(inner / (1 - inner))
    return logit


def _gaussian(device: torch.device) -> Tensor:
    """SSIM's window along one axis, (1,1,1,11)."""
    away = torch.arange(_WINDOW, dtype=torch.float32, device=device) - _WINDOW // 2
    weights = torch.exp(-away.square() / (2 * _SIGMA**2))
    return (weights / weights.sum()).reshape(1, 1, 1, _WINDOW)
