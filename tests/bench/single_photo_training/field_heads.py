"""The two heads that predict a field of unsigned distances from one picture. Torch.

Both use the frozen backbone of `pixels`, so that their results differ by the head alone.

implicit     f(q) = |MLP(q, latent)|: what anchor-udf is compared with
anchor-udf   f(q) = |MLP(q, latent, features of the picture where q is seen, the nearest anchors)|  (Zhao et al. 2021),
             anchors being k-means centres of the 1,024 points; a small MLP, for two CPU cores
"""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor, nn
from torch.nn import functional

from tests.bench.single_photo_network.camera import about_vertical, project
from tests.bench.single_photo_network.network import LATENT, POINTS, WIDTHS, Pixels, Prediction, likeliest_yaw
from tests.bench.single_photo_training.losses import nearest

ANCHORS = 600  # per thing, as published
_ROUNDS = 3  # of k-means; it starts with points all over the square, which are spread out already
_NEIGHBOURS = 4  # anchors per query
_FEATURES = 32  # channels of the picture's and of the anchors' features
_WIDE = 192  # channels of the MLP


class Implicit(nn.Module):
    """The head `implicit`: queries (n,q,3) in the frame of `shapes.py` -> distances (n,q)."""

    def __init__(self, backbone: Pixels) -> None:
        super().__init__()
        self.backbone = backbone.requires_grad_(False)
        self.whole = nn.Linear(LATENT, _WIDE)
        self.place = nn.Linear(3, _WIDE)
        self.deeper = _layers(_WIDE)

    def encode(self, picture: Tensor) -> Prediction:
        """Run the backbone, once per picture; `forward` then answers any number of queries."""
        return _encode(self.backbone, picture)

    def forward(self, prediction: Prediction, q: Tensor) -> Tensor:
        own = about_vertical(q, -likeliest_yaw(prediction.bins))
        distance: Tensor = self.deeper(self.place(own) + self.whole(prediction.latent)[:, None])[..., 0].abs()
        return distance


class AnchorUdf(nn.Module):
    """The head `anchor-udf`: as `Implicit`, with features of the picture and of the anchors at the query's place."""

    def __init__(self, backbone: Pixels) -> None:
        super().__init__()
        self.backbone = backbone.requires_grad_(False)
        self.whole = nn.Linear(LATENT, _WIDE)
        self.near = nn.Conv2d(WIDTHS[1], _FEATURES, 1)
        self.wide = nn.Conv2d(WIDTHS[2], _FEATURES, 1)
        self.beside = nn.Sequential(nn.Linear(4, _FEATURES), nn.Softplus(10), nn.Linear(_FEATURES, _FEATURES))
        self.place = nn.Linear(3 + 1 + 3 * _FEATURES, _WIDE)
        self.deeper = _layers(_WIDE)

    def encode(self, picture: Tensor) -> Prediction:
        """Run the backbone, once per picture; `forward` then answers any number of queries."""
        return _encode(self.backbone, picture)

    def forward(self, prediction: Prediction, q: Tensor) -> Tensor:
        at, depth = project(q, prediction.camera)
        pixel = (at * torch.tensor([1.0, -1.0], device=q.device))[:, None]
        maps = torch.cat(
            [self.near(prediction.near), functional.interpolate(self.wide(prediction.wide), scale_factor=2)], dim=1
        )
        features_there = functional.grid_sample(maps, pixel, align_corners=False)[:, :, 0].transpose(1, 2)
        beside = self.beside(_offsets(q, anchors(prediction.points, ANCHORS))).amax(dim=2)
        features = torch.cat([q, depth[..., None], features_there, beside], dim=2)
        distance: Tensor = self.deeper(self.place(features) + self.whole(prediction.latent)[:, None])[..., 0].abs()
        return distance


Field = Implicit | AnchorUdf


def anchors(points: Tensor, count: int) -> Tensor:
    """K-means centres (n,count,3) of points (n,p,3)."""
    centres = points[:, torch.arange(count, device=points.device) * points.shape[1] // count]
    for _ in range(_ROUNDS):
        own, _ = nearest(points, centres)
        index = own[..., None].expand(-1, -1, 3)
        total = torch.zeros_like(centres).scatter_add_(1, index, points)
        size = torch.zeros_like(centres).scatter_add_(1, index, torch.ones_like(points))
        centres = torch.where(size > 0, total / size.clamp(min=1), centres)
    return centres


def pull_to_surface(field: Field, prediction: Prediction, start: Tensor, *, rounds: int = 4) -> tuple[Tensor, Tensor]:
    """Pull queries (n,q,3) to where the field is 0, by f along −∇f -> places, and the distances (n,q) that remain."""
    q = start
    for _ in range(rounds):
        distance, gradient = value_and_gradient(field, prediction, q)
        q = (q - distance[..., None] * functional.normalize(gradient, dim=2)).detach()
    with torch.no_grad():
        return q, field(prediction, q)


def field_points(field: Field, prediction: Prediction, generator: torch.Generator) -> Tensor:
    """Sample points (n,1024,3) of the zero set: of many random queries the nearest to it, pulled onto it.

    Queries in a thin band around a surface are spread evenly over its area.
    """
    n = len(prediction.points)
    anywhere = 2 * torch.rand(n, 16 * POINTS, 3, generator=generator).to(prediction.points.device) - 1
    with torch.no_grad():
        distance = field(prediction, anywhere)
    nearby = distance.argsort(dim=1)[:, : 2 * POINTS, None].expand(-1, -1, 3)
    pulled, remaining = pull_to_surface(field, prediction, anywhere.gather(1, nearby))
    best = remaining.argsort(dim=1)[:, : POINTS + POINTS // 2]
    some = torch.rand(best.shape, generator=generator).argsort(dim=1)[:, :POINTS].to(best.device)
    return pulled.gather(1, best.gather(1, some)[..., None].expand(-1, -1, 3))


def value_and_gradient(
    field: Field, prediction: Prediction, q: Tensor, *, learn: bool = False
) -> tuple[Tensor, Tensor]:
    """Evaluate f and ∇f at q; `learn` keeps the graph for a second derivative."""
    with torch.enable_grad():
        q = q.requires_grad_(True)
        distance = field(prediction, q)
        (gradient,) = torch.autograd.grad(distance.sum(), q, create_graph=learn)
    return distance, gradient


def _layers(width: int) -> nn.Sequential:
    # Softplus, which is smooth, because the loss contains gradients.
    last = nn.Linear(width // 2, 1)
    nn.init.constant_(last.bias, 0.1)
    return nn.Sequential(
        nn.Softplus(10), nn.Linear(width, width), nn.Softplus(10), nn.Linear(width, width // 2), nn.Softplus(10), last
    )


def _offsets(q: Tensor, anchor: Tensor) -> Tensor:
    """Offsets from the nearest anchors to each query, and their lengths: (n,q,_NEIGHBOURS,4)."""
    with torch.no_grad():
        index = torch.cdist(q, anchor).topk(_NEIGHBOURS, dim=2, largest=False).indices
    near = anchor.gather(1, index.flatten(1)[..., None].expand(-1, -1, 3)).reshape(*index.shape, 3)
    offset = q[:, :, None] - near
    return torch.cat([offset, (offset.square().sum(dim=3, keepdim=True) + 1e-8).sqrt()], dim=3)


def _encode(backbone: Pixels, picture: Tensor) -> Prediction:
    """Run the frozen backbone: its weights and statistics do not change."""
    backbone.eval()
    with torch.no_grad():
        prediction: Prediction = backbone(picture)
    return replace(
        prediction, latent=prediction.latent.float(), near=prediction.near.float(), wide=prediction.wide.float()
    )
