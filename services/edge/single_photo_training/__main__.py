"""`python -m services.edge.guess --head pixels --steps 20000 --out DIR`: train a head, or go on where it stopped."""

from __future__ import annotations

import argparse
from pathlib import Path

import torch

from services.edge.guess.train import Training, train


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m services.edge.guess", description=__doc__)
    parser.add_argument("--head", choices=["pixels", "anchor-udf", "implicit"], required=True)
    parser.add_argument("--steps", type=int, required=True)
    parser.add_argument("--out", type=Path, required=True, help="folder of the checkpoint and the weights")
    parser.add_argument("--device", default="cpu", help="cpu or cuda:0")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--start", default="", help="folder of trained weights to begin from")
    given = parser.parse_args()
    train(Training(given.head, given.steps, given.seed, given.start), given.out, torch.device(given.device))


if __name__ == "__main__":
    main()
