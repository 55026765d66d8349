"""`python -m services.edge.single_photo_training --head pixels --out DIR`: train a head, or resume its training."""

from __future__ import annotations

import argparse
from pathlib import Path

import torch

from services.edge.single_photo_training.train import HeadTraining, train


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m services.edge.single_photo_training", description=__doc__)
    parser.add_argument("--head", choices=["pixels", "anchor-udf", "implicit"], required=True)
    parser.add_argument("--steps", type=int, required=True)
    parser.add_argument("--out", type=Path, required=True, help="folder of the checkpoint and the weights")
    parser.add_argument("--device", default="cpu", help="cpu or cuda:0")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--start", default="", help="folder of trained weights to begin from")
    args = parser.parse_args()
    train(HeadTraining(args.head, args.steps, args.seed, args.start), args.out, torch.device(args.device))


if __name__ == "__main__":
    main()
