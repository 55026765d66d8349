"""One photo and a generator: what is sent of the photo, and points of its answer that look like the photo."""

from __future__ import annotations

import io
import json
import struct
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from capture2vr.edge.capture.nouns import Capture
from capture2vr.edge.errors import CaptureError, EdgeError
from capture2vr.edge.generated.server import GeneratorServer
from capture2vr.edge.generated.to_points import generated_points, generator_of
from capture2vr.edge.job_resources import JobResources
from capture2vr.edge.pipeline import reconstruct
from capture2vr.edge.preset import load_preset
from capture2vr.edge.read_capture import read_capture
from capture2vr.storage.bundle import Bundle
from tests.support.photos.generators import boxes, boxes_glb, generator, glb, photo_of
from tests.support.photos.single_photos import photo

GENERATE = load_preset("generate")


def capture_of_boxes() -> Capture:
    """One photo of the boxes, with their mask."""
    rgb, mask = photo_of(boxes(), 300)
    return Capture("image", "jpeg", photos=(replace(photo(rgb), mask=mask),))


def broken(change: Callable[[dict[str, object], bytearray], None]) -> bytes:
    """The GLB of the boxes with another JSON or other numbers."""
    whole = boxes_glb()
    length = struct.unpack_from("<I", whole, 12)[0]
    tree, data = json.loads(whole[20 : 20 + length]), bytearray(whole[28 + length :])
    change(tree, data)
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(data), b"BIN\0") + bytes(data)
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def not_finite(_: dict[str, object], data: bytearray) -> None:
    data[:] = b"\xff\xff\xff\x7f" * (len(data) // 4)


def empty(tree: dict[str, object], _: bytearray) -> None:
    tree.update(meshes=[], nodes=[], scenes=[{"nodes": []}])


def endless_rows(tree: dict[str, object], _: bytearray) -> None:
    for accessor in tree["accessors"]:  # type: ignore[attr-defined]
        accessor["count"] = 2**31


WRONG = {
    "not finite": broken(not_finite),
    "empty": broken(empty),
    "endless rows": broken(endless_rows),
    "noise": b"glTF\x02\0\0\0" + (200).to_bytes(4, "little") + np.random.default_rng(1).bytes(188),
}


@pytest.mark.slow
@pytest.mark.parametrize("fault", WRONG)
def test_a_glb_that_is_no_mesh_ends_the_job_with_a_sentence(fault: str) -> None:
    with generator(glb(WRONG[fault])) as stub, pytest.raises(EdgeError, match=r"GLB file cannot be used: .+") as caught:
        generated_points(capture_of_boxes(), GeneratorServer(stub.url))
    assert (caught.value.code, caught.value.retryable) == ("GENERATOR_FAILED", False)
    assert "the capture is kept" in caught.value.hints[0]


@pytest.mark.essential
@pytest.mark.slow
def test_only_the_object_is_sent_and_the_answer_looks_at_the_camera() -> None:
    with generator(glb(boxes_glb(turn=70, size=0.3, offset=(5, -2, 1)))) as stub:
        points = generated_points(capture_of_boxes(), GeneratorServer(stub.url))
    sent = np.asarray(Image.open(io.BytesIO(stub.fields["image"])))
    assert sent.shape[2] == 4
    assert 0.1 < (sent[..., 3] > 0).mean() < 0.6
    assert not sent[sent[..., 3] == 0].any()
    assert max(np.ptp(points.xyz, axis=0)[:2]) == pytest.approx(1, abs=0.06)
    assert points.rgb is not None
    green, blue = (points.xyz[points.rgb[:, channel] > 150].mean(axis=0) for channel in (1, 2))
    assert green[0] > 0.2 > -0.1 > blue[0]  # as `BOXES` has them: the green one right, the blue one left and in front
    assert green[1] > blue[1]
    assert blue[2] > green[2]
    assert points.scale_confidence == "unknown"
    assert points.confidence.max() <= 0.2
    assert points.warnings[0].startswith("Generated, not measured")
    assert "meets the photo's to 9" in points.warnings[0]


def test_only_one_photo_is_generated_from_and_nobody_is_asked_before(tmp_path: Path) -> None:
    np.savetxt(tmp_path / "scan.xyz", np.random.default_rng(0).normal(size=(300, 3)))
    resources = JobResources(generator=GeneratorServer("http://127.0.0.1:1"))
    with pytest.raises(CaptureError, match="one photo alone, and this capture is of the format xyz") as caught:
        list(reconstruct(read_capture(tmp_path / "scan.xyz"), GENERATE, resources=resources))
    assert caught.value.code == "GENERATOR_ONE_PHOTO"


def test_without_a_generator_its_preset_is_refused() -> None:
    with pytest.raises(EdgeError, match="there is none here") as caught:
        list(reconstruct(capture_of_boxes(), GENERATE))
    assert caught.value.code == "GENERATOR_ABSENT"
    assert "EDGE_GENERATOR" in caught.value.hints[0]
    assert generator_of(load_preset("draft"), GeneratorServer("http://127.0.0.1:1")) is None


@pytest.mark.slow
def test_what_was_generated_says_so_in_manifest_certificate_and_pictures(tmp_path: Path) -> None:
    rgb, mask = photo_of(boxes(), 300)
    cv2.imwrite(str(tmp_path / "boxes.png"), np.dstack([rgb[..., ::-1], np.where(mask, 255, 0)]).astype(np.uint8))
    with generator(glb(boxes_glb(turn=200))) as stub:
        resources = JobResources(generator=GeneratorServer(stub.url))
        steps = reconstruct(
            read_capture(tmp_path), replace(GENERATE, resolution=40, most_points=5_000), resources=resources
        )
        *_, bundle = (step for step in steps if isinstance(step, Bundle))
    manifest = bundle.manifest
    assert manifest["origin"] == manifest["quality"]["origin"] == "generated"
    assert manifest["quality"]["grade"] is None
    assert manifest["preset"] == "generate"
    assert manifest["warnings"][0].startswith("Generated, not measured")
    for name in ("thumbnail.webp", "turning.webp"):
        foot = np.asarray(Image.open(io.BytesIO(bundle.files[name])).convert("RGBA"))[-1]
        assert foot[len(foot) // 2, 3] == 255
        assert foot[len(foot) // 2, :3].max() < 60
