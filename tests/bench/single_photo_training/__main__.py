"""`python -m tests.bench.single_photo_training --out DIR`: train all heads from nothing, or resume their training.

The files HEAD.pt are those that the bench reads: pixels.pt belongs to `single_photo_network/weights`, the fields to
`single_photo_training/weights`.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path

import torch

from capture2vr.edge.errors import EdgeError
from tests.bench.single_photo_training.real_things import fingerprint, mesh_files, read_things
from tests.bench.single_photo_training.train import SHIPPED, train


def main() -> int:
    """Train the heads; returns the exit status."""
    parser = argparse.ArgumentParser(prog="python -m tests.bench.single_photo_training", description=__doc__)
    parser.add_argument("--head", choices=[each.head for each in SHIPPED], help="only this one; its backbone is in DIR")
    parser.add_argument("--steps", type=int, help="the most steps of each head")
    parser.add_argument("--out", type=Path, required=True, help="folder of the checkpoints and the weights")
    parser.add_argument("--device", default="cpu", help="cpu or cuda:0")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--meshes", type=Path, help="folder of meshes, y up, which every other picture shows")
    args = parser.parse_args()
    try:
        things = read_things(mesh_files(args.meshes)) if args.meshes else []
    except EdgeError as error:
        print(f"{error}; {'; '.join(error.hints)}", file=sys.stderr)
        return 2
    meshes = fingerprint(things) if things else ""
    for training in SHIPPED:
        if args.head in (None, training.head):
            print(f"{training.head}:", flush=True)
            training = replace(training, steps=args.steps or training.steps, seed=args.seed, meshes=meshes)
            try:
                train(training, args.out, torch.device(args.device), things=things, report=_print)
            except OSError as error:
                reason = f"{error.filename or args.out}: {error.strerror or error}"
                print(f"{reason}; mend that and run it again: it goes on from the last checkpoint", file=sys.stderr)
                return 1
    return 0


def _print(line: str) -> None:
    print(line, flush=True)


if __name__ == "__main__":
    sys.exit(main())
