"""A worker's capabilities: its device, the presets that it offers with their memory, and those that it cannot offer."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from capture2vr.edge.api import edge_pb2 as pb

POINTS_VERSION = 13
"""Version of the archives of prepared points (jobs/points_archive.py). Workers compare theirs before any are sent."""


@dataclass(frozen=True, slots=True)
class Capabilities:
    """Capabilities that a worker announces to gateways, and checks requests against.

    device          for people: "cpu, 2 cores", "cuda:0 NVIDIA H100"
    presets         presets on offer, the default first
    memory_bytes    memory that all fits together may take; 0: not limited
    withheld        presets that are not offered, because even their smallest fit takes more than that
    points_version  version of the prepared points that it takes; 0: it takes captures only
    central         address of the worker that fits fields for it, or ""
    unavailable     presets that only central has, while that takes no jobs
    ktx2            whether it can encode textures as KTX2; otherwise targets that want KTX2 are refused
    """

    device: str
    presets: tuple[pb.Preset, ...]
    memory_bytes: int = 0
    withheld: tuple[pb.Preset, ...] = ()
    points_version: int = 0
    central: str = ""
    unavailable: tuple[pb.Preset, ...] = ()
    ktx2: bool = False

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(preset.name for preset in self.presets)

    def has(self, preset: str) -> bool:
        """Return whether this worker offers the preset."""
        return preset in self.names

    def trains(self, preset: str) -> bool:
        """Whether a refined version may follow the preview with this preset; False for an unknown one."""
        return any(each.trained for each in (*self.presets, *self.unavailable) if each.name == preset)

    def with_central(self, central: str, presets: Sequence[pb.Preset], *, takes_jobs: bool) -> Capabilities:
        """Add the presets of central after this worker's own; a withheld preset that central has is offered too.

        takes_jobs  whether central takes jobs now; if not, its presets are `unavailable`
        """
        theirs = tuple(each for each in presets if not self.has(each.name))
        names = {each.name for each in theirs}
        withheld = tuple(each for each in self.withheld if each.name not in names)
        if not takes_jobs:
            return replace(self, central=central, withheld=withheld, unavailable=theirs)
        return replace(self, central=central, withheld=withheld, presets=(*self.presets, *theirs))
