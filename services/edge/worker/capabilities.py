"""What a worker offers: its device, its presets with the memory that each may take, and what it must withhold."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from services.edge.api import edge_pb2 as pb
from services.edge.mesh.ktx2 import Encode


@dataclass(frozen=True, slots=True)
class Offer:
    """Told to gateways, and what requests are checked against.

    device          for people: "cpu, 2 cores", "cuda:0 NVIDIA H100"
    presets         the default first
    memory_bytes    what fits may take together; 0: nobody counts
    withheld        presets that exist, but whose smallest fit takes more than that
    points_version  of the prepared points that it takes; 0: captures only
    central         address of the worker that fits for it, or ""
    away            presets that only that one has, which takes no jobs now
    ktx2            packs textures as KTX2, for targets that ask for it; None: they are refused
    """

    device: str
    presets: tuple[pb.Preset, ...]
    memory_bytes: int = 0
    withheld: tuple[pb.Preset, ...] = ()
    points_version: int = 0
    central: str = ""
    away: tuple[pb.Preset, ...] = ()
    ktx2: Encode | None = None

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(preset.name for preset in self.presets)

    def has(self, preset: str) -> bool:
        """Whether it is on offer."""
        return preset in self.names

    def trains(self, preset: str) -> bool:
        """Whether a refined version may follow the preview; False for what is unknown."""
        return any(each.trained for each in (*self.presets, *self.away) if each.name == preset)

    def joined(self, central: str, presets: Sequence[pb.Preset], *, takes_jobs: bool) -> Offer:
        """This offer with that of its central, behind its own; what central can fit need not be withheld."""
        theirs = tuple(each for each in presets if not self.has(each.name))
        names = {each.name for each in theirs}
        withheld = tuple(each for each in self.withheld if each.name not in names)
        if not takes_jobs:
            return replace(self, central=central, withheld=withheld, away=theirs)
        return replace(self, central=central, withheld=withheld, presets=(*self.presets, *theirs))
