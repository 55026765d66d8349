"""The other two heads: a field of unsigned distances from one picture. Torch.

Both stand on the backbone of `pixels`, which is not trained any more, so that rows of a table differ in the head alone.

implicit     f(q) = |MLP(q, latent)|: what anchors are compared with
anchor-udf   f(q) = |MLP(q, latent, features of the picture where q is seen, the nearest anchors)|  (Zhao et al. 2021),
             anchors being k-means centres of the 1,024 points; 256 of them and a small MLP, for two CPU cores
"""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor, nn
from torch.nn import functional

from services.edge.guess.losses import nearest
from services.edge.guess.network import LATENT, POINTS, WIDTHS, Pixels, Seen, likeliest
from services.edge.guess.pictures import project
from services.edge.guess.shapes import about_vertical

ANCHORS = 256
_ROUNDS = 3  # of k-means; the start is every fourth point of the square, which is spread already
_NEIGHBOURS = 4
_FEATURES = 32
_WIDE = 192


class Implicit(nn.Module):
    """Queries (n,q,3) in the frame of `shapes.py` -> distances (n,q)."""

    def __init__(self, backbone: Pixels) -> None:
        super().__init__()
        self.backbone = backbone.requires_grad_(False)
        self.whole = nn.Linear(LATENT, _WIDE)
        self.place = nn.Linear(3, _WIDE)
        self.deeper = _layers(_WIDE)

    def see(self, picture: Tensor) -> Seen:
        """Once per picture."""
        return _seen(self.backbone, picture)

    def forward(self, seen: Seen, q: Tensor) -> Tensor:
        own = about_vertical(q, -likeliest(seen.bins))
        distance: Tensor = self.deeper(self.place(own) + self.whole(seen.latent)[:, None])[..., 0].abs()
        return distance


class AnchorUdf(nn.Module):
    """As `Implicit`, with what the picture and the anchors say about the query's place."""

    def __init__(self, backbone: Pixels) -> None:
        super().__init__()
        self.backbone = backbone.requires_grad_(False)
        self.whole = nn.Linear(LATENT, _WIDE)
        self.near = nn.Conv2d(WIDTHS[1], _FEATURES, 1)
        self.wide = nn.Conv2d(WIDTHS[2], _FEATURES, 1)
        self.beside = nn.Sequential(nn.Linear(4, _FEATURES), nn.Softplus(10), nn.Linear(_FEATURES, _FEATURES))
        self.place = nn.Linear(3 + 1 + 3 * _FEATURES, _WIDE)
        self.deeper = _layers(_WIDE)

    def see(self, picture: Tensor) -> Seen:
        """Once per picture."""
        return _seen(self.backbone, picture)

    def forward(self, seen: Seen, q: Tensor) -> Tensor:
        at, depth = project(q, seen.camera)
        pixel = (at * torch.tensor([1.0, -1.0], device=q.device))[:, None]
        maps = torch.cat([self.near(seen.near), functional.interpolate(self.wide(seen.wide), scale_factor=2)], dim=1)
        seen_there = functional.grid_sample(maps, pixel, align_corners=False)[:, :, 0].transpose(1, 2)
        beside = self.beside(_offsets(q, anchors(seen.points, ANCHORS))).amax(dim=2)
        features = torch.cat([q, depth[..., None], seen_there, beside], dim=2)
        distance: Tensor = self.deeper(self.place(features) + self.whole(seen.latent)[:, None])[..., 0].abs()
        return distance


Field = Implicit | AnchorUdf


def anchors(points: Tensor, count: int) -> Tensor:
    """(n,p,3) -> (n,count,3): k-means centres."""
    centres = points[:, :: points.shape[1] // count][:, :count]
    for _ in range(_ROUNDS):
        own, _ = nearest(points, centres)
        index = own[..., None].expand(-1, -1, 3)
        total = torch.zeros_like(centres).scatter_add_(1, index, points)
        size = torch.zeros_like(centres).scatter_add_(1, index, torch.ones_like(points))
        centres = torch.where(size > 0, total / size.clamp(min=1), centres)
    return centres


def on_surface(field: Field, seen: Seen, start: Tensor, *, rounds: int = 4) -> tuple[Tensor, Tensor]:
    """Queries (n,q,3) pulled to where the field is 0, by f along −∇f; the distances that are left (n,q)."""
    q = start
    for _ in range(rounds):
        distance, gradient = with_gradient(field, seen, q)
        q = (q - distance[..., None] * functional.normalize(gradient, dim=2)).detach()
    with torch.no_grad():
        return q, field(seen, q)


def field_points(field: Field, seen: Seen, generator: torch.Generator) -> Tensor:
    """(n,1024,3) on the zero set: of many queries anywhere those nearest to it, pulled there.

    Those within a thin band are as dense as the surface is large.
    """
    n = len(seen.points)
    anywhere = 2 * torch.rand(n, 16 * POINTS, 3, generator=generator).to(seen.points.device) - 1
    with torch.no_grad():
        distance = field(seen, anywhere)
    nearby = distance.argsort(dim=1)[:, : 2 * POINTS, None].expand(-1, -1, 3)
    pulled, left = on_surface(field, seen, anywhere.gather(1, nearby))
    best = left.argsort(dim=1)[:, : POINTS + POINTS // 2]
    some = torch.rand(best.shape, generator=generator).argsort(dim=1)[:, :POINTS].to(best.device)
    return pulled.gather(1, best.gather(1, some)[..., None].expand(-1, -1, 3))


def with_gradient(field: Field, seen: Seen, q: Tensor, *, learn: bool = False) -> tuple[Tensor, Tensor]:
    """f and ∇f at q; `learn` keeps what a second derivative needs."""
    with torch.enable_grad():
        q = q.requires_grad_(True)
        distance = field(seen, q)
        (gradient,) = torch.autograd.grad(distance.sum(), q, create_graph=learn)
    return distance, gradient


def _layers(width: int) -> nn.Sequential:
    # Smooth, since the loss looks at gradients.
    last = nn.Linear(width // 2, 1)
    nn.init.constant_(last.bias, 0.1)
    return nn.Sequential(
        nn.Softplus(10), nn.Linear(width, width), nn.Softplus(10), nn.Linear(width, width // 2), nn.Softplus(10), last
    )


def _offsets(q: Tensor, anchor: Tensor) -> Tensor:
    """(n,q,_NEIGHBOURS,4): from the nearest anchors to the query, and how long that is."""
    with torch.no_grad():
        index = torch.cdist(q, anchor).topk(_NEIGHBOURS, dim=2, largest=False).indices
    near = anchor.gather(1, index.flatten(1)[..., None].expand(-1, -1, 3)).reshape(*index.shape, 3)
    offset = q[:, :, None] - near
    return torch.cat([offset, (offset.square().sum(dim=3, keepdim=True) + 1e-8).sqrt()], dim=3)


def _seen(backbone: Pixels, picture: Tensor) -> Seen:
    """The backbone keeps its weights and its statistics."""
    backbone.eval()
    with torch.no_grad():
        seen: Seen = backbone(picture)
    return replace(seen, latent=seen.latent.float(), near=seen.near.float(), wide=seen.wide.float())
