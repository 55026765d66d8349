"""What a worker offers: the product's presets, an operator's own, and none that its memory cannot hold."""

from __future__ import annotations

from pathlib import Path

import pytest

from capture2vr.edge.api import edge_pb2 as pb
from capture2vr.edge.errors import EdgeError
from capture2vr.edge.field.device import Device, find_device
from capture2vr.edge.generated.server import GeneratorServer
from capture2vr.edge.jobs.available_presets import capabilities_of, known_presets
from capture2vr.edge.jobs.fit_job import FieldFitter
from capture2vr.edge.jobs.job_task import Machine
from capture2vr.edge.preset import memory_bytes
from capture2vr.edge.worker.job_request import ReconstructionRequest, RefusedError
from capture2vr.edge.worker.memory_budget import MemoryBudget
from capture2vr.storage.memory import MemoryStore

CPU = Device("cpu", "cpu, 2 cores")
PLENTY = 1 << 50


def test_the_automatic_choice_is_the_default_and_every_preset_states_its_bound() -> None:
    known = known_presets(None)
    offer = capabilities_of(known, CPU, PLENTY)
    assert offer.names[:6] == ("auto", "draft", "standard", "fine", "splats", "scene")
    told = {preset.name: preset for preset in offer.presets}
    assert told["auto"].trained
    assert not told["draft"].trained
    assert told["standard"].memory_bytes == memory_bytes(known["standard"], known["standard"].most_points)
    assert told["auto"].memory_bytes == max(told[name].memory_bytes for name in ("draft", "standard", "fine", "scene"))
    assert offer.withheld == ()


def test_what_never_fits_is_withheld_and_what_trains_nothing_is_not() -> None:
    known = known_presets(None)
    offer = capabilities_of(known, CPU, memory_bytes(known["draft"], 0))
    assert {"auto", "draft"} <= set(offer.names)
    assert "standard" in {preset.name for preset in offer.withheld}


def test_a_generators_preset_is_offered_where_there_is_one_and_never_for_central() -> None:
    known, memory = known_presets(None), MemoryBudget(PLENTY)
    without = FieldFitter(MemoryStore(), known, CPU, memory).offer
    machine = Machine("cpu", PLENTY, generator=GeneratorServer("http://127.0.0.1:1"))
    having = FieldFitter(MemoryStore(), known, CPU, memory, machine=machine).offer
    assert set(having.names) - set(without.names) == {"generate"}
    assert not having.trains("generate")
    assert not without.with_central("central:1", having.presets, takes_jobs=True).has("generate")
    header = pb.Header(job="job_1", asset_key="dress", preset="generate")
    assert ReconstructionRequest.of(header, having).options.preset == "generate"
    with pytest.raises(RefusedError, match=r"GENERATOR_ABSENT.*EDGE_GENERATOR"):
        ReconstructionRequest.of(header, without)


def test_an_operators_presets_stand_behind_the_products(tmp_path: Path) -> None:
    (tmp_path / "ours.toml").write_text('summary = "ours"\nresolution = 64\n[fit]\nsteps = 10\n')
    (tmp_path / "readme.txt").write_text("not a preset")
    known = known_presets(tmp_path)
    assert list(known)[-1] == "ours"
    assert known["ours"].resolution == 64


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("ours.toml", "colour = 1", "colour"),
        ("ours.toml", "= =", "'ours' cannot be read"),
        ("draft.toml", "", "the product has a preset 'draft' already"),
    ],
)
def test_a_preset_that_is_none_stops_the_start(tmp_path: Path, name: str, text: str, said: str) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(EdgeError, match=said) as error:
        known_presets(tmp_path)
    assert error.value.code == "PRESET_INVALID"


def test_a_folder_that_is_none_stops_the_start(tmp_path: Path) -> None:
    with pytest.raises(EdgeError, match="there is no folder"):
        known_presets(tmp_path / "absent")


def test_the_cpu_is_told_with_its_cores() -> None:
    device = find_device("cpu")
    assert (device.name, device.memory_bytes) == ("cpu", 0)
    assert device.description.startswith("cpu, ")


def test_a_gpu_that_is_not_there_is_named() -> None:
    import torch

    if torch.cuda.is_available():
        pytest.skip("this machine has one")
    assert find_device("auto").name == "cpu"
    with pytest.raises(EdgeError, match="there is no cuda:3: ") as error:
        find_device("cuda:3")
    assert error.value.code == "DEVICE_ABSENT"
    with pytest.raises(EdgeError, match="devices are named"):
        find_device("cuda:x")


@pytest.mark.gpu
def test_a_gpu_is_told_with_its_name_and_memory() -> None:
    import torch

    if not torch.cuda.is_available():
        pytest.skip("there is no GPU")
    device = find_device("auto")
    assert device == find_device("cuda")
    assert device.description.startswith("cuda:0 ")
    assert device.memory_bytes > 1 << 30
