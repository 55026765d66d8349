"""Adam (Kingma and Ba 2015, arXiv:1412.6980) by PyTorch's fused kernel, without PyTorch's optimiser classes.

`torch.optim.Adam` imports PyTorch's compiler when it is made first: 1.3 s and 80 MB of every process that trains.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import torch
from torch import Tensor
from torch.optim.adam import adam

_EPSILON = 1e-8  # PyTorch's default


class Adam:
    """The moments of some parameters, all on one device; `step` moves the parameters along their gradients.

    rate   tensor of one number, read at every step: a captured CUDA graph reads it from a fixed address
    betas  decay per step of the mean of the gradients and of the mean of their squares
    """

    def __init__(self, parameters: Iterable[Tensor], rate: Tensor, betas: tuple[float, float] = (0.9, 0.999)) -> None:
        self._parameters, self._rate, self._betas = list(parameters), rate, betas
        self._means = [torch.zeros_like(each, requires_grad=False) for each in self._parameters]
        self._squares = [torch.zeros_like(each, requires_grad=False) for each in self._parameters]
        self._steps = [torch.zeros((), device=each.device) for each in self._parameters]

    @torch.no_grad()
    def step(self) -> None:
        """Update the parameters by one optimizer step. Parameters without a gradient are not changed."""
        state = zip(self._parameters, self._means, self._squares, self._steps, strict=True)
        moved = [(each, each.grad, *moments) for each, *moments in state if each.grad is not None]
        parameters, gradients, means, squares, steps = map(list, zip(*moved, strict=True))
        beta1, beta2 = self._betas
        adam(
            parameters,
            gradients,
            means,
            squares,
            [],
            steps,
            fused=True,
            amsgrad=False,
            beta1=beta1,
            beta2=beta2,
            lr=self._rate,
            weight_decay=0.0,
            eps=_EPSILON,
            maximize=False,
        )

    def zero_grad(self) -> None:
        """Drop the gradients."""
        for each in self._parameters:
            each.grad = None

    def state_dict(self) -> dict[str, Any]:
        """Return the moments and the numbers of steps, for a checkpoint; the tensors are those in use."""
        return {"means": self._means, "squares": self._squares, "steps": self._steps}

    @torch.no_grad()
    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore the optimizer's state from a checkpoint."""
        for name, mine in self.state_dict().items():
            for tensor, saved in zip(mine, state[name], strict=True):
                tensor.copy_(saved)
