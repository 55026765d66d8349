"""`import capture2vr`: quick, typed, and complete; what is public is what `__all__` names."""

from __future__ import annotations

import ast
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

import capture2vr
from tests.support.repository import ROOT

FACE = ROOT / "services" / "__init__.py"
HEAVY = {"torch", "numpy", "scipy", "trimesh", "httpx", "pydantic", "rich", "typer", "cv2", "asyncio", "typing"}

_RIGHT = """
from typing import assert_type
import numpy as np
from capture2vr import Client, Mesh, Reconstruction, RemoteJob, mesh_from_points, reconstruct
assert_type(mesh_from_points(np.zeros((100, 3)), preset="draft", fill="all"), Mesh)
assert_type(reconstruct("photos", cut="object").save("out").name, str)
assert_type(reconstruct("photos").refined, Mesh | None)
with Client("http://127.0.0.1:8080") as client:
    assert_type(client.wait(client.start(client.upload("scan.ply"), "dress", label="Dress")), RemoteJob)
"""
_WRONG = {
    "capture2vr.reconstrukt('photos')": "attr-defined",
    "capture2vr.reconstruct('photos', cut='objekt')": "arg-type",
    "capture2vr.reconstruct('photos', cat='object')": "call-arg",
    "capture2vr.Client().start(1, 'dress')": "arg-type",
    "capture2vr.mesh_from_points([[0, 0, 0]]).vertexes": "attr-defined",
}


def _python(code: str, **options: object) -> str:
    command = [sys.executable, "-P", "-c", code]
    ended = subprocess.run(command, capture_output=True, text=True, **options)  # type: ignore[call-overload]
    assert ended.returncode == 0, ended.stderr
    return str(ended.stdout)


def test_the_import_loads_nothing_but_itself() -> None:
    loaded = set(_python("import capture2vr, sys; print(*sys.modules)", env={"PYTHONPATH": str(ROOT)}).split())
    assert loaded & HEAVY == set()
    assert {name for name in loaded if name.startswith("capture2vr")} == {"capture2vr"}


def test_every_public_name_is_there_and_no_other_is_listed() -> None:
    for name in capture2vr.__all__:
        assert getattr(capture2vr, name) is not None
    assert set(capture2vr.__all__) <= set(dir(capture2vr))
    assert capture2vr.__all__ == sorted(capture2vr.__all__)
    with pytest.raises(AttributeError, match="'capture2vr' has no attribute 'nonsense'"):
        capture2vr.nonsense  # type: ignore[attr-defined]  # noqa: B018


def test_type_checkers_and_the_interpreter_are_told_the_same() -> None:
    imports = [each for each in ast.walk(ast.parse(FACE.read_text())) if isinstance(each, ast.ImportFrom)]
    told = {each.module: tuple(alias.name for alias in each.names) for each in imports}
    del told["__future__"], told["importlib"]
    assert told == capture2vr._MODULES
    assert {"__version__", *(name for names in told.values() for name in names)} == set(capture2vr.__all__)


def test_who_has_no_numpy_is_told_what_to_install_and_has_the_client() -> None:
    code = """
import sys
sys.modules |= dict.fromkeys(("numpy", "torch", "boto3", "cryptography"))
import capture2vr
print(capture2vr.Client.__name__, capture2vr.CaptureError.__name__)
try:
    capture2vr.mesh_from_points
except ImportError as error:
    print(error)
"""
    told = _python(code, env={"PYTHONPATH": str(ROOT)}).splitlines()
    assert told == ["Client CaptureError", "capture2vr.mesh_from_points needs numpy: pip install 'capture2vr[edge]'"]


def test_all_errors_are_one_tree() -> None:
    errors = [each for each in map(capture2vr.__getattribute__, capture2vr.__all__) if isinstance(each, type)]
    errors = [each for each in errors if issubclass(each, BaseException)]
    assert len(errors) == 7
    assert all(issubclass(each, capture2vr.Capture2vrError) for each in errors)


@pytest.mark.slow
def test_a_type_checker_sees_the_types_from_outside(tmp_path: Path) -> None:
    (tmp_path / "right.py").write_text(_RIGHT)
    (tmp_path / "wrong.py").write_text("import capture2vr\n" + "\n".join(_WRONG) + "\n")
    options = ("--strict", "--follow-imports=silent", "--ignore-missing-imports", "--config-file=")
    command = [sys.executable, "-m", "mypy", *options, "right.py", "wrong.py"]
    checked = subprocess.run(
        command, capture_output=True, text=True, cwd=tmp_path, env={"MYPYPATH": str(ROOT), "PATH": "/usr/bin:/bin"}
    )
    found = [line for line in checked.stdout.splitlines() if ": error: " in line]
    assert [line.split(":")[0] for line in found] == ["wrong.py"] * len(_WRONG), checked.stdout + checked.stderr
    for line, (statement, code) in zip(found, _WRONG.items(), strict=True):
        assert f"[{code}]" in line, statement


@pytest.mark.slow
def test_the_wheel_has_one_package_which_is_typed_and_works_where_only_it_is(tmp_path: Path) -> None:
    build = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(tmp_path)]
    subprocess.run(build, cwd=ROOT, check=True, capture_output=True)
    (wheel,) = tmp_path.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
        archive.extractall(tmp_path / "site")
    assert {name.split("/")[0] for name in names if ".dist-info" not in name} == {"capture2vr"}
    assert "capture2vr/py.typed" in names
    code = "import capture2vr; print(capture2vr.__file__); print(capture2vr.mesh_from_points.__module__)"
    told = _python(code, env={"PYTHONPATH": str(tmp_path / "site")}, cwd=tmp_path).splitlines()
    assert told == [str(tmp_path / "site" / "capture2vr" / "__init__.py"), "capture2vr.library.reconstruct"]
