"""A release from a tagged commit to what a stranger verifies, with a key that is thrown away."""

from __future__ import annotations

import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
import tarfile
import zipfile
from importlib.util import find_spec
from pathlib import Path

import pytest

from capture2vr.cli.up import free_port
from release.project import project_version
from tests.conftest import missing
from tests.support.network.vulnerability_service import VulnerabilityService, serving
from tests.support.patience import HANG_S
from tests.support.release_project import commit_all, git, make_key
from tests.support.repository import ROOT

pytestmark = pytest.mark.slow

VERSION = project_version(ROOT)
_NOT_COPIED = shutil.ignore_patterns(".git", ".venv", "node_modules", "dist", "data", "__pycache__", ".*_cache")


@pytest.fixture(scope="module")
def checkout(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """This checkout as a repository of its own, at a commit that is tagged for release."""
    for program in ("git", "ssh-keygen", "npm"):
        if shutil.which(program) is None:
            missing(program)
    root = tmp_path_factory.mktemp("release") / "checkout"
    shutil.copytree(ROOT, root, symlinks=True, ignore=_NOT_COPIED)
    git(root.parent, "init", "--quiet", "--initial-branch=main", str(root))
    commit_all(root, "The release before")
    git(root, "tag", "v0.0.9")
    changelog = (root / "CHANGELOG.md").read_text()
    (root / "CHANGELOG.md").write_text(
        re.sub(rf"^## {VERSION} \(.*\)$", f"## {VERSION} (2030-12-31)", changelog, flags=re.M)
    )
    (root / "release" / "allowed_signers").write_text(make_key(root.parent / "key"))
    if find_spec("meshoptimizer") is None:  # no C++ compiler has built it; a release without it is refused
        project = (root / "pyproject.toml").read_text()
        (root / "pyproject.toml").write_text(re.sub(r"^fast = .*$", "", project, flags=re.M))
    commit_all(root, "This release")
    git(root, "tag", f"v{VERSION}")
    return root


def _run(root: Path, *arguments: str, **variables: str) -> subprocess.CompletedProcess[str]:
    """`python -m release` of that checkout."""
    environment = {**os.environ, "PYTHONPATH": str(root), "PYTHONDONTWRITEBYTECODE": "1", **variables}
    command = [sys.executable, "-m", *arguments]
    return subprocess.run(command, cwd=root, env=environment, capture_output=True, text=True, timeout=HANG_S)


@pytest.fixture(scope="module")
def released(checkout: Path) -> Path:
    """The folder with the release's files."""
    with serving(VulnerabilityService()) as service:
        ended = _run(checkout, "release", "publish", "--key", str(checkout.parent / "key"), **service.environment)
    assert ended.returncode == 0, ended.stderr
    return checkout / "dist"


def test_what_could_not_be_audited_is_no_release(checkout: Path) -> None:
    nowhere = f"http://127.0.0.1:{free_port()}"
    services = {"PIP_AUDIT_OSV_URL": nowhere, "npm_config_registry": nowhere}
    ended = _run(checkout, "release", "publish", "--key", str(checkout.parent / "key"), **services)
    assert ended.returncode == 1
    assert ended.stderr.count("not audited: ") == 2
    assert "try again where both services can be reached" in ended.stderr
    assert not (checkout / "dist").exists()


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _files(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


def test_a_release_has_its_files(released: Path) -> None:
    names = {f"capture2vr-{VERSION}{suffix}" for suffix in ("-py3-none-any.whl", ".tar.gz", ".cdx.json")}
    assert _files(released) == names | {"RELEASE-NOTES.md", "SHA256SUMS", "SHA256SUMS.sig"}


def test_the_notes_tell_changes_files_sbom_and_what_is_known_to_be_vulnerable(checkout: Path, released: Path) -> None:
    notes = (released / "RELEASE-NOTES.md").read_text()
    assert notes.startswith(
        f"# capture2vr {VERSION}\n\n2030-12-31, commit `{git(checkout, 'rev-parse', 'HEAD').strip()}`"
    )
    assert "1 commit since `v0.0.9`" in notes
    assert "## Added\n\n- [Captures](docs/formats.md): photos" in notes
    for suffix in ("-py3-none-any.whl", ".tar.gz", ".cdx.json"):
        path = released / f"capture2vr-{VERSION}{suffix}"
        assert f"| `{path.name}` | {path.stat().st_size:,} | `{_sha256(path)}` |" in notes
    sbom = released / f"capture2vr-{VERSION}.cdx.json"
    assert f"lists {len(json.loads(sbom.read_text())['components'])} components" in notes
    assert f"sha256 is\n`{_sha256(sbom)}`" in notes
    assert re.search(r"^- pip-audit: \d+ packages of constraints.txt, no known vulnerability$", notes, re.M)
    assert "$" not in notes


def _as_a_stranger(released: Path, checkout: Path, folder: Path) -> subprocess.CompletedProcess[str]:
    """Run the notes' own commands on copies of the files."""
    shutil.copytree(released, folder, dirs_exist_ok=True)
    shutil.copy(checkout / "release" / "allowed_signers", folder)
    return _verify(folder)


def _verify(folder: Path) -> subprocess.CompletedProcess[str]:
    (script,) = re.findall(r"^```bash\n(.*?)^```", (folder / "RELEASE-NOTES.md").read_text(), re.DOTALL | re.MULTILINE)
    return subprocess.run(["bash", "-euc", script], cwd=folder, capture_output=True, text=True, timeout=HANG_S)


def test_a_stranger_verifies_it_with_the_commands_of_the_notes(released: Path, checkout: Path, tmp_path: Path) -> None:
    verified = _as_a_stranger(released, checkout, tmp_path)
    assert verified.returncode == 0, verified.stderr
    assert 'Good "capture2vr-release" signature for capture2vr with ED25519 key' in verified.stdout
    assert verified.stdout.count(": OK") == 4


@pytest.mark.parametrize("name", ["RELEASE-NOTES.md", f"capture2vr-{VERSION}.cdx.json", "SHA256SUMS", "SHA256SUMS.sig"])
def test_a_file_that_was_altered_is_noticed(name: str, released: Path, checkout: Path, tmp_path: Path) -> None:
    shutil.copytree(released, tmp_path, dirs_exist_ok=True)
    shutil.copy(checkout / "release" / "allowed_signers", tmp_path)
    content = (tmp_path / name).read_text()
    (tmp_path / name).write_text(content.replace("a", "b", 1))
    assert _verify(tmp_path).returncode != 0


def test_the_same_tree_gives_the_same_bytes_elsewhere(released: Path, checkout: Path, sbom: str) -> None:
    """The SBOM of this checkout was made by another process in another folder; wheel and source are built again."""
    if find_spec("meshoptimizer") is not None:
        assert (released / f"capture2vr-{VERSION}.cdx.json").read_text() == sbom
    (checkout / "README.md").touch()
    again = checkout.parent / "again"
    assert _run(checkout, "hatchling", "build", "-d", str(again)).returncode == 0
    assert {path.name: _sha256(path) for path in again.iterdir()} == {
        name: _sha256(released / name) for name in _files(again)
    }


def test_the_source_distribution_has_what_git_tracks(released: Path, checkout: Path) -> None:
    with tarfile.open(released / f"capture2vr-{VERSION}.tar.gz") as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
    tracked = {name for name in git(checkout, "ls-files").splitlines() if not name.startswith(".ci/")}
    assert names - {"PKG-INFO"} == tracked - {"capture2vr"}  # the link, for which the wheel has a name of its own


def test_the_wheel_starts_and_brings_the_licences_of_what_is_inside(released: Path) -> None:
    wheel = released / f"capture2vr-{VERSION}-py3-none-any.whl"
    command = [sys.executable, "-c", "from capture2vr.cli.main import main; main()", "version"]
    environment = {**os.environ, "PYTHONPATH": str(wheel)}
    ended = subprocess.run(command, cwd=released, env=environment, capture_output=True, text=True, timeout=HANG_S)
    assert ended.stdout == f"{VERSION}\n", ended.stderr
    names = zipfile.ZipFile(wheel).namelist()
    ours = {path.relative_to(ROOT).as_posix() for path in (ROOT / "capture2vr/web/vendor").glob("*.LICENSE")}
    assert ours <= set(names)
    assert {name.partition("/")[0] for name in names} == {"capture2vr", f"capture2vr-{VERSION}.dist-info"}
