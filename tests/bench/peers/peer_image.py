"""The published proof of concept's network on our lessons: one picture to 1,024 points by rearranged pixels, where the
camera sees them, with no class of yaw and no second look.

    (4,64,64) -> strided convolutions -> (384,4,4) -> 3 x [convolution, PixelShuffle 2] -> (3,32,32), on a base sphere

It was shown 3,000 fixed shapes; here no picture comes twice, which can but help it.
"""

from __future__ import annotations

import time
from itertools import pairwise
from pathlib import Path

import torch
from torch import Tensor, nn
from torch.nn import functional

from tests.bench.single_photo_network.network import POINTS, base_sphere
from tests.bench.single_photo_training.batches import Batch, training_batches
from tests.bench.single_photo_training.losses import chamfer_loss

MINUTES = 14.0  # of one core: what it was given
_WIDTHS = (4, 48, 96, 192, 384)
_RATE = 1e-3  # of Adam, falling in a line
_SEED = 7


class Peer(nn.Module):
    """Pictures (n,4,64,64) -> points (n,1024,3) in the camera's frame."""

    def __init__(self) -> None:
        super().__init__()
        down = [
            nn.Sequential(nn.Conv2d(a, b, 3, 2, 1), nn.BatchNorm2d(b), nn.ReLU(), nn.Conv2d(b, b, 3, 1, 1), nn.ReLU())
            for a, b in pairwise(_WIDTHS)
        ]
        self.down = nn.Sequential(*down)
        self.mix = nn.Sequential(nn.Flatten(), nn.Linear(384 * 16, 64), nn.ReLU(), nn.Linear(64, 384 * 16))
        up = [nn.Sequential(nn.Conv2d(a, 4 * b, 3, 1, 1), nn.PixelShuffle(2)) for a, b in ((384, 192), (192, 96))]
        self.up = nn.Sequential(up[0], nn.ReLU(), up[1], nn.ReLU(), nn.Conv2d(96, 12, 3, 1, 1), nn.PixelShuffle(2))
        self.register_buffer("sphere", base_sphere(), persistent=False)

    def forward(self, picture: Tensor) -> Tensor:
        deep = self.down(picture - 0.5)
        square = functional.relu(deep + self.mix(deep).reshape(deep.shape))
        moved: Tensor = self.up(square).flatten(2).transpose(1, 2)
        return self.sphere + moved


def peer(folder: Path, minutes: float = MINUTES) -> tuple[Peer, int]:
    """Trained, with its steps: read from the folder, or trained into it on this core."""
    path = folder / f"peer-{minutes:g}-minutes.pt"
    head = Peer()
    if path.exists():
        kept = torch.load(path, weights_only=True)
        head.load_state_dict(kept["head"])
        return head.eval(), int(kept["steps"])
    steps = _train(head, 60 * minutes)
    folder.mkdir(parents=True, exist_ok=True)
    torch.save({"head": head.state_dict(), "steps": steps}, path)
    return head.eval(), steps


def _train(head: Peer, seconds: float) -> int:
    """Seconds are the processor's: a busy machine takes none of them away. The lessons' making does not count."""
    torch.manual_seed(_SEED)
    optimiser = torch.optim.Adam(head.parameters(), lr=_RATE)
    spent = 0.0
    for steps, lesson in enumerate(training_batches(_SEED, 0), start=1):
        began = time.process_time()
        for group in optimiser.param_groups:
            group["lr"] = _RATE * max(1.0 - spent / seconds, 0.02)
        loss = _learn(head, optimiser, lesson)
        spent += time.process_time() - began
        if steps % 100 == 0:
            print(f"step {steps}, {spent:.0f} of {seconds:.0f} s, loss {loss:.4f}", flush=True)
        if spent > seconds:
            return steps
    raise AssertionError("lessons never end")


def _learn(head: Peer, optimiser: torch.optim.Optimizer, lesson: Batch) -> float:
    few = lesson.surface[:, torch.randperm(lesson.surface.shape[1])[:POINTS]]
    loss = chamfer_loss(head(lesson.picture), few)
    optimiser.zero_grad()
    loss.backward()  # type: ignore[no-untyped-call]
    optimiser.step()
    return loss.item()
