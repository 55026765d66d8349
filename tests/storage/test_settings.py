"""Which store a service gets."""

from __future__ import annotations

from pathlib import Path

import pytest

from capture2vr.process.strict_settings import SettingsError
from capture2vr.storage.bucket import main
from capture2vr.storage.catalogue.publish import KeyElsewhere, publish
from capture2vr.storage.catalogue.signing import generate_key
from capture2vr.storage.local import LocalStore
from capture2vr.storage.s3 import S3Store
from capture2vr.storage.settings import StorageSettings, open_policy, open_store
from tests.support.bundles import bundle, listed


def test_a_folder_is_the_default(tmp_path: Path) -> None:
    store = open_store(StorageSettings(root=tmp_path))
    assert isinstance(store, LocalStore)
    assert store.url("assets/a") == "/v1/files/assets/a"


def test_s3_from_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    variables = {
        "KIND": "s3",
        "ENDPOINT": "http://store:9000",
        "PUBLIC_ENDPOINT": "https://s3.example",
        "BUCKET": "things",
    }
    for name, value in (variables | {"ACCESS_KEY": "key", "SECRET_KEY": "very secret"}).items():
        monkeypatch.setenv(f"STORAGE_{name}", value)
    settings = StorageSettings()
    store = open_store(settings)
    assert isinstance(store, S3Store)
    assert store.url("assets/a") == "https://s3.example/things/assets/a"
    assert "very secret" not in str(settings.describe())


def test_a_secret_key_is_read_from_its_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "secret"
    for variable, given in {"KIND": "s3", "ACCESS_KEY": "me", "SECRET_KEY": "", "SECRET_KEY_FILE": str(file)}.items():
        monkeypatch.setenv(f"STORAGE_{variable}", given)
    with pytest.raises(SettingsError, match=f"^STORAGE_SECRET_KEY_FILE: .*No such file.*{file}"):
        open_store(StorageSettings())
    file.write_text("hush\n")
    assert isinstance(open_store(StorageSettings()), S3Store)


@pytest.mark.parametrize(
    ("name", "value"), [("ENDPOINT", "store:9000"), ("PUBLIC_ENDPOINT", "s3.example"), ("BUCKET", "my things")]
)
def test_what_s3_cannot_be_asked_at_is_an_error_that_names_the_variable(
    name: str, value: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    for variable, given in {"KIND": "s3", "ENDPOINT": "http://store:9000", name: value}.items():
        monkeypatch.setenv(f"STORAGE_{variable}", given)
    with pytest.raises(SettingsError, match=f"STORAGE_{name}"):
        StorageSettings()
    with pytest.raises(SystemExit, match=f"bucket: STORAGE_{name}"):
        main()


def test_half_a_pair_of_keys_is_an_error() -> None:
    with pytest.raises(SettingsError, match="STORAGE_SECRET_KEY"):
        open_store(StorageSettings(kind="s3", access_key="key"))


def test_a_worker_publishes_with_the_keys_of_its_settings(tmp_path: Path) -> None:
    public = generate_key(tmp_path / "key")
    settings = StorageSettings(root=tmp_path / "objects", signing_key=(str(tmp_path / "key"),))
    store, policy = open_store(settings), open_policy(settings)
    publish(bundle(), store, key="dress", job="job_1", collection="mine", policy=policy)
    assert list(listed(store, "mine", believed=(public,))) == ["dress"]
    with pytest.raises(KeyElsewhere, match="in collection mine, not in other"):
        publish(bundle(), store, key="dress", job="job_2", collection="other", policy=policy)
