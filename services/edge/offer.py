"""What a worker offers: its device, its presets with the memory that each may take, and what it must withhold."""

from __future__ import annotations

from dataclasses import dataclass

from services.edge.api import edge_pb2 as pb


@dataclass(frozen=True, slots=True)
class Offer:
    """Told to gateways, and what requests are checked against.

    device        for people: "cpu, 2 cores", "cuda:0 NVIDIA H100"
    presets       the default first
    memory_bytes  what fits may take together; 0: nobody counts
    withheld      presets that exist, but whose smallest fit takes more than that
    """

    device: str
    presets: tuple[pb.Preset, ...]
    memory_bytes: int = 0
    withheld: tuple[pb.Preset, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(preset.name for preset in self.presets)
