"""Stand-ins on the CPU for the GPU libraries that published networks import, as plain PyTorch and SciPy.

`install()` puts them where `import pytorch3d.ops` and `import pointnet2_ops.pointnet2_utils` find them, and keeps
tensors where they are when code asks for a GPU by name. Values are those of the originals; neighbours are sorted.
"""

from __future__ import annotations

import functools
import sys
from types import ModuleType
from typing import Any

import torch
from scipy.spatial import cKDTree

_PADDING = 1e-3  # squared distance from the origin


def knn_points(
    queries: torch.Tensor, points: torch.Tensor, K: int = 1, return_nn: bool = False, **_: Any
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor | None]:
    """The K nearest of points (B,N,3) to each of queries (B,M,3): squared distances, indices (B,M,K), points (B,M,K,3).

    Distances and neighbours have gradients; they are searched on the CPU. Raises ValueError for fewer than K points.
    """
    if points.shape[1] < K:
        raise ValueError(f"{points.shape[1]} points have no {K} neighbours")
    found = [
        cKDTree(cloud.detach().numpy()).query(asked.detach().numpy(), k=range(1, K + 1))[1]
        for asked, cloud in zip(queries, points, strict=True)
    ]
    index = torch.stack([torch.from_numpy(each) for each in found])
    near = knn_gather(points, index)
    return (queries[:, :, None] - near).square().sum(dim=-1), index, near if return_nn else None


def knn_gather(values: torch.Tensor, idx: torch.Tensor) -> torch.Tensor:
    """Rows (B,M,K,C) of values (B,N,C) at the indices (B,M,K)."""
    return torch.stack([each[at] for each, at in zip(values, idx, strict=True)])


def furthest_point_sample(points: torch.Tensor, count: int) -> torch.Tensor:
    """Indices (B,count) of points (B,N,3): from the first point on, always the point furthest from those chosen.

    As in pointnet2's kernel, points within about .03 of the origin are taken for padding and never chosen, but first.
    """
    padding = points.square().sum(dim=-1) <= _PADDING
    chosen = torch.zeros(points.shape[0], count, dtype=torch.int32)
    batch = torch.arange(points.shape[0])
    nearest = torch.full(points.shape[:2], torch.inf)
    for step in range(1, count):
        last = points[batch, chosen[:, step - 1].long()]
        nearest = torch.minimum(nearest, (points - last[:, None]).square().sum(dim=-1))
        chosen[:, step] = nearest.masked_fill(padding, -1).argmax(dim=1)
    return chosen


def gather_operation(values: torch.Tensor, index: torch.Tensor) -> torch.Tensor:
    """Columns (B,C,M) of values (B,C,N) at the indices (B,M)."""
    return values.gather(2, index.long()[:, None].expand(-1, values.shape[1], -1))


def install() -> None:
    """Put the stand-ins in place of the libraries, and keep tensors, networks and stored weights on the CPU."""
    _module("pytorch3d.ops", knn_points=knn_points, knn_gather=knn_gather)
    _module(
        "pointnet2_ops.pointnet2_utils", furthest_point_sample=furthest_point_sample, gather_operation=gather_operation
    )
    # Imported by mistake, and needs a display's library.
    _module("turtle", forward=None)
    for kind in (torch.Tensor, torch.nn.Module):
        kind.cuda = lambda self, *_, **__: self
    torch.load = functools.partial(torch.load, map_location="cpu")


def _module(name: str, **members: Any) -> None:
    made = ModuleType(name)
    made.__dict__.update(members)
    sys.modules[name] = made
    package, _, leaf = name.rpartition(".")
    if package:
        parent = sys.modules.setdefault(package, ModuleType(package))
        setattr(parent, leaf, made)
