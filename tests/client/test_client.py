"""`Client` against a real gateway with a real worker's server: its examples, and what goes wrong."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import capture2vr
from capture2vr.cli.remote.assets import keep
from capture2vr.cli.remote.push import push_capture
from capture2vr.client import client as client_module
from capture2vr.client.client import Client
from capture2vr.client.nouns import UploadProgress
from capture2vr.errors import BadInput, Capture2vrError, GatewayError, JobFailed, VerificationError
from capture2vr.storage.store import list_all
from tests.support.clouds import sphere_points
from tests.support.doctests import run_examples
from tests.support.gateway_of_zips import Served, gateway_of_zips


@pytest.fixture
def served(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Served]:
    for variable in ("XDG_STATE_HOME", "XDG_CACHE_HOME"):
        monkeypatch.setenv(variable, str(tmp_path / variable))
    monkeypatch.delenv("CAPTURE2VR_KEY", raising=False)
    with gateway_of_zips(tmp_path) as served:
        yield served


@pytest.fixture
def cloud(tmp_path: Path) -> Path:
    """A folder with the file of a cloud."""
    folder = tmp_path / "captures"
    folder.mkdir()
    np.save(folder / "sphere.npy", sphere_points(600))
    return folder


@pytest.mark.slow
def test_the_examples_of_the_docstrings(served: Served, cloud: Path) -> None:
    with Client(served.url) as client:
        capture = client.upload(cloud / "sphere.npy")
        job = client.wait(client.start(capture, "sphere"))
        job = client.wait(client.start(capture, "ball", label="A ball"))
        names = {"client": client, "gateway": served, "folder": cloud, "capture": capture, "job": job}
        assert run_examples(client_module, capture2vr=capture2vr, **names) > 10


@pytest.mark.slow
def test_what_the_callers_hear_of_and_what_goes_wrong(served: Served, cloud: Path, tmp_path: Path) -> None:
    heard: list[UploadProgress] = []
    with Client(f"{served.url}/") as client:
        capture = client.upload(cloud / "sphere.npy", progress=heard.append)
        assert (capture.kind, capture.files) == ("points", {"sphere.npy": "ok"})
        assert [each.stage for each in heard[:1]] == ["UPLOADING"]
        assert heard[-1].fraction == 1.0
        with pytest.raises(GatewayError, match="there is no preset 'magic'") as refused:
            client.start(capture, "sphere", preset="magic")
        assert (refused.value.code, refused.value.status, refused.value.retryable) == ("PRESET_UNKNOWN", 422, False)
        assert refused.value.hints

        events = list(client.follow(client.start(capture, "sphere")))
        assert [each.published for each in events if each.published] == ["preview", "refined"]
        assert [each.fraction for each in events] == sorted(each.fraction for each in events)
        assert any("distance" in each.losses for each in events)
        assert events[-1].state == "SUCCEEDED"
        assert [(each.key, each.version) for each in client.assets()] == [("sphere", 2)]
        assert list(client.assets(label="square")) == []

        served.script["fail"] = "CAPTURE_DEGENERATE"
        with pytest.raises(JobFailed, match="as it was told") as failed:
            client.wait(client.start(capture, "flat"))
        assert failed.value.code == "CAPTURE_DEGENERATE"

        names = (each.name for each in list_all(served.store, ""))
        (mesh,) = (name for name in names if "mesh." in name and b"refined" in served.store.get(name))
        served.store.delete(mesh)
        with pytest.raises(VerificationError) as broken:
            client.pull("sphere", tmp_path / "out", cache=tmp_path / "empty")
        assert broken.value.code == "FILE_MISSING"
        assert not (tmp_path / "out").exists()


def test_what_is_held_back_is_kept(
    served: Served, cloud: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    served.script["grade"] = "shoot again"
    with Client(served.url) as client:
        job = client.wait(client.start(client.upload(cloud / "sphere.npy"), "sphere"))
        assert (job.grade, job.held, job.version) == ("shoot again", True, 2)
        assert job.because.startswith("the surface is in shreds")
        assert list(client.assets()) == []
        with pytest.raises(BadInput, match=r"held back.*capture2vr keep sphere"):
            client.pull("sphere", tmp_path / "out")
        assert client.keep("sphere") == 3
        assert [(each.key, each.grade) for each in client.assets()] == [("sphere", "shoot again")]
        assert client.pull("sphere", tmp_path / "out").version == 3
        with pytest.raises(BadInput, match="no newer version than 3"):
            client.keep("sphere")
    push_capture(cloud / "sphere.npy", served.url, key="ball")
    said = " ".join(capsys.readouterr().err.split())
    assert "Shoot again: the surface is in shreds" in said
    assert "`capture2vr keep ball --version 2` publishes it" in said
    keep("ball", served.url, version=None)
    assert "ball is published, as version 3" in capsys.readouterr().err


def test_a_gateway_that_is_not_there_and_arguments_that_cannot_be_right(tmp_path: Path) -> None:
    (tmp_path / "a.npy").write_bytes(b"")
    with Client("http://127.0.0.1:9", key="") as client:
        for ask in (
            lambda: client.upload(tmp_path / "a.npy"),
            lambda: client.job("job_1"),
            lambda: list(client.jobs()),
            lambda: list(client.assets()),
            lambda: client.pull("shoe", tmp_path / "out"),
        ):
            with pytest.raises(GatewayError, match=r"http://127\.0\.0\.1:9 cannot be reached") as failure:
                ask()
            assert failure.value.retryable
            assert failure.value.status == 0
        for wrong in (
            lambda: client.upload(tmp_path / "b.npy"),
            lambda: client.start("cap_1", "a/b"),
            lambda: client.start("cap_1", "a", collection="../b"),
            lambda: client.job("../assets/shoe"),
            lambda: client.start("", "shoe"),
            lambda: client.pull("../shoe", tmp_path / "out"),
        ):
            with pytest.raises(BadInput) as refused:
                wrong()
            assert not isinstance(refused.value, GatewayError)
    with pytest.raises(Capture2vrError, match="is not an access key"):
        Client(key="c2v_ä")
    with pytest.raises(GatewayError, match="cannot be reached"):
        Client("http://a:b")
