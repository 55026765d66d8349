"""KTX2: the colours come back with all their mips, the same bytes each time, and nothing of the encoder runs on."""

from __future__ import annotations

import json
import struct
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from capture2vr.cli.local.run import RunOptions, run_capture
from capture2vr.edge.api import edge_pb2 as pb
from capture2vr.edge.errors import Cancelled, EdgeError
from capture2vr.edge.export.glb import to_glb
from capture2vr.edge.export.ktx2 import VERSION, Ktx2Encoder, Ktx2Error, Ktx2Header
from capture2vr.edge.field.device import find_device
from capture2vr.edge.jobs.available_presets import known_presets
from capture2vr.edge.jobs.fit_job import FieldFitter
from capture2vr.edge.jobs.job_task import Machine
from capture2vr.edge.jobs.reconstruct_job import Reconstructor
from capture2vr.edge.srgb import to_linear, to_srgb
from capture2vr.edge.worker.job_request import ReconstructionRequest, RefusedError
from capture2vr.edge.worker.memory_budget import MemoryBudget
from capture2vr.errors import BadInput
from capture2vr.order.job_options import JobOptions
from capture2vr.storage.memory import MemoryStore
from tests.edge.export.test_glb import PACKINGS, PICTURED
from tests.referees.glb_reader import Glb
from tests.referees.gltf.validator import Validator, validator  # noqa: F401 - a fixture is used by its name
from tests.referees.ktx2.encoder import ktx2, unpacked  # noqa: F401 - a fixture is used by its name
from tests.support.patience import CANCEL_S


def photo_like(side: int, seed: int = 0) -> np.ndarray:
    """(side,side,3) a colour that changes slowly, and shades of it that do so from texel to texel."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:side, :side][..., None] / 20
    colour = 128 + 60 * np.sin(x + rng.uniform(0, 6, 3)) * np.cos(y + rng.uniform(0, 6, 3))
    return (colour + rng.normal(0, 8, (side, side, 1))).clip(0, 255).astype(np.uint8)


def described(content: bytes) -> tuple[int, int, int]:
    """Colour model, primaries and transfer function, from the file's data format descriptor."""
    (start,) = struct.unpack_from("<I", content, 48)
    model, primaries, transfer = content[start + 12 : start + 15]
    return model, primaries, transfer


@pytest.mark.slow
def test_equal_pictures_give_equal_bytes_and_the_colours_come_back(
    ktx2: Ktx2Encoder,  # noqa: F811
    tmp_path: Path,
) -> None:
    picture = photo_like(64)
    content = ktx2(picture)
    assert content == ktx2(picture)
    assert Ktx2Header.of(content) == Ktx2Header(vk_format=0, width=64, height=64, levels=7, supercompression=1)
    assert described(content) == (163, 1, 2)  # ETC1S, primaries of BT.709, sRGB
    seen = unpacked(content, tmp_path)
    assert (seen.alpha, seen.etc1s) == (False, True)
    assert [level.shape[:2] for level in seen.levels] == [(64 >> level, 64 >> level) for level in range(7)]
    assert np.abs(seen.levels[0].astype(int) - picture).mean() < 4
    assert len(content) < picture.size / 4


@pytest.mark.slow
@settings(max_examples=3, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.integers(0, 7), st.integers(0, 2**32 - 1))
def test_any_side_has_all_its_mips(ktx2: Ktx2Encoder, power: int, seed: int) -> None:  # noqa: F811
    side = 1 << power
    header = Ktx2Header.of(ktx2(photo_like(side, seed)))
    assert (header.width, header.height, header.levels) == (side, side, power + 1)


@pytest.mark.slow
def test_mips_average_light_and_bring_in_nothing_from_the_opposite_edge(
    ktx2: Ktx2Encoder,  # noqa: F811
    tmp_path: Path,
) -> None:
    picture = np.zeros((64, 64, 3), np.uint8)
    picture[:, :32] = (np.indices((64, 32)).sum(axis=0) % 2 * 255)[..., None]  # a fine board beside black
    small = unpacked(ktx2(picture), tmp_path).levels[3]
    grey = int(to_srgb(np.full(1, to_linear(np.uint8(255)) / 2))[0])
    assert np.abs(small[:, :3].astype(int) - grey).max() < 16  # 188: codes would give 128
    assert small[:, 7].max() < 8


def test_cancelling_kills_node(ktx2: Ktx2Encoder) -> None:  # noqa: F811
    seen: list[psutil.Process] = []

    def stop(fraction: float) -> None:
        seen.extend(each for each in psutil.Process().children(recursive=True) if each.name() == "node")
        if seen:
            raise Cancelled

    noise = np.random.default_rng(0).integers(0, 256, (1024, 1024, 3), dtype=np.uint8)
    began = time.monotonic()
    with pytest.raises(Cancelled):
        ktx2(noise, stop)
    assert time.monotonic() - began < CANCEL_S
    assert len(seen) == 1
    assert not seen[0].is_running()


def test_it_ends_when_it_takes_too_long(ktx2: Ktx2Encoder) -> None:  # noqa: F811
    with pytest.raises(Ktx2Error, match="took more than 0 s") as caught:
        ktx2(photo_like(64), most_seconds=0.0)
    assert caught.value.code == "KTX2_FAILED"


def folder_with(tmp_path: Path, version: str, program: str = "") -> Path:
    """As npm leaves it."""
    package = tmp_path / "node_modules" / "ktx2-encoder"
    (package / "dist" / "node").mkdir(parents=True)
    (package / "package.json").write_text(json.dumps({"version": version, "type": "module"}))
    (package / "dist" / "node" / "index.js").write_text(program)
    return tmp_path


def test_an_encoder_that_fails_is_an_error_with_its_reason(ktx2: Ktx2Encoder, tmp_path: Path) -> None:  # noqa: F811
    thrown = "export class NodeBasisEncoder { async init() { throw new Error('no memory\\nat all'); } }"
    with pytest.raises(Ktx2Error, match="ktx2-encoder ended with status 1: no memory at all") as caught:
        Ktx2Encoder.at(folder_with(tmp_path, VERSION, thrown))(photo_like(8))
    assert "without -ktx2" in caught.value.hints[0]


def test_a_picture_that_it_does_not_take_is_an_error(ktx2: Ktx2Encoder) -> None:  # noqa: F811
    with pytest.raises(Ktx2Error, match=r"ktx2-encoder ended with status 1: .*it returned no data"):
        ktx2(np.zeros((0, 4, 3), np.uint8))


@pytest.mark.parametrize(
    ("version", "node", "why"),
    [
        (None, True, "npm has not installed ktx2-encoder in"),
        ("0.5.9", True, f"has ktx2-encoder 0.5.9, version {VERSION} is needed"),
        (VERSION, False, "`node` is not on the PATH"),
    ],
)
def test_what_is_missing_is_named_with_what_to_do(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, version: str | None, node: bool, why: str
) -> None:
    bin_folder = tmp_path / "bin"
    bin_folder.mkdir()
    if node:
        (bin_folder / "node").write_text("")
        (bin_folder / "node").chmod(0o755)
    monkeypatch.setenv("PATH", str(bin_folder))
    with pytest.raises(EdgeError, match=why) as caught:
        Ktx2Encoder.at(folder_with(tmp_path, version) if version else tmp_path)
    assert caught.value.code == "KTX2_UNAVAILABLE"
    assert f"npm install --prefix FOLDER ktx2-encoder@{VERSION}" in caught.value.hints[0]


def test_run_looks_for_the_encoder_before_it_reads_the_capture(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    capture = tmp_path / "capture.ply"
    capture.write_bytes(b"nothing that could be read")
    for folder, why in (("", "EDGE_KTX2 is not set"), (str(tmp_path), "npm has not installed")):
        monkeypatch.setenv("EDGE_KTX2", folder)
        with pytest.raises(BadInput, match=why):
            run_capture(capture, tmp_path / "out", RunOptions(JobOptions("draft", target="web-ktx2"), device="cpu"))


def test_a_worker_with_an_encoder_takes_such_jobs(ktx2: Ktx2Encoder) -> None:  # noqa: F811
    header = pb.Header(job="job_1", asset_key="dress", target="web-ktx2")
    presets, memory = known_presets(None), MemoryBudget(1 << 40)
    machine = Machine("cpu", memory.total_bytes, ktx2)
    work = Reconstructor(FieldFitter(MemoryStore(), presets, find_device("cpu"), memory, machine=machine))
    assert ReconstructionRequest.of(header, work.offer).options.target == "web-ktx2"
    with pytest.raises(RefusedError, match="KTX2_UNAVAILABLE"):
        ReconstructionRequest.of(header, replace(work.offer, ktx2=False))


@pytest.mark.parametrize("content", [b"", b"\xabKTX 20\xbb\r\n\x1a\n", b"\xff\xd8" + bytes(100)])
def test_what_is_no_ktx2_is_said(content: bytes) -> None:
    with pytest.raises(ValueError, match="not a KTX2 file"):
        Ktx2Header.of(content)


@pytest.fixture(scope="module")
def packed(ktx2: Ktx2Encoder) -> bytes:  # noqa: F811
    """A picture."""
    return ktx2(photo_like(32))


@pytest.mark.slow
@pytest.mark.parametrize("packing", PACKINGS)
def test_a_glb_with_ktx2_has_no_other_picture_and_says_that_it_must_be_known(packing: Any, packed: bytes) -> None:
    asset = replace(PICTURED["one-sided"], ktx2=packed)
    content = to_glb(asset, packing, unlit=True)
    glb = Glb.of(content)
    assert glb.image == packed
    (image,), (texture,) = glb.document["images"], glb.document["textures"]
    assert image["mimeType"] == "image/ktx2"
    assert texture == {"sampler": 0, "extensions": {"KHR_texture_basisu": {"source": 0}}}
    assert {"KHR_texture_basisu"} <= set(glb.document["extensionsRequired"]) < set(glb.document["extensionsUsed"])
    assert glb.document["bufferViews"][image["bufferView"]]["byteOffset"] % 4 == 0
    assert asset.jpeg not in content
    plain = Glb.of(to_glb(replace(asset, ktx2=None), packing, unlit=True))
    assert "KHR_texture_basisu" not in json.dumps(plain.document)
    assert np.array_equal(glb.uv, plain.uv)


# The validator does not know the extension, and what only the extension reads is to it unused, and no picture.
BEYOND_KHRONOS = (
    "UNSUPPORTED_EXTENSION /extensionsUsed/",
    "VALUE_NOT_IN_LIST /images/0/mimeType",
    "UNUSED_OBJECT /images/0",
    "UNUSED_OBJECT /buffers/0",
    "IMAGE_UNRECOGNIZED_FORMAT /images/0",
)


def test_khronos_finds_no_fault_beyond_the_extension_that_it_does_not_know(
    validator: Validator,  # noqa: F811
    packed: bytes,
    tmp_path: Path,
) -> None:
    files = {packing: tmp_path / f"{packing}.glb" for packing in PACKINGS}
    for packing, file in files.items():
        file.write_bytes(to_glb(replace(PICTURED["one-sided"], ktx2=packed), packing))
    for packing, verdict in zip(files, validator(*files.values()), strict=True):
        assert (verdict.errors, verdict.warnings) == (0, 2), packing
        assert [each for each in verdict.messages if not each.startswith(BEYOND_KHRONOS)] == []
