"""Writes the .meta file of every asset of the package: Unity takes none from a package without them.

    python clients/unity/Tools~/metas.py

A GUID follows from the path, so that it is the same on every machine and stays when the file's content changes.
"""

from __future__ import annotations

import hashlib
from pathlib import Path

PACKAGE = Path(__file__).resolve().parents[1]

_EMPTY = "  externalObjects: {}\n"
_SCRIPT = "  serializedVersion: 2\n  defaultReferences: []\n  executionOrder: 0\n  icon: {instanceID: 0}\n"
_WEBGL_ONLY = """  serializedVersion: 2
  iconMap: {}
  executionOrder: {}
  defineConstraints: []
  isPreloaded: 0
  isOverridable: 0
  isExplicitlyReferenced: 0
  validateReferences: 1
  platformData:
  - first:
      Any:
    second:
      enabled: 0
      settings: {}
  - first:
      Editor: Editor
    second:
      enabled: 0
      settings:
        DefaultValueInitialized: true
  - first:
      WebGL: WebGL
    second:
      enabled: 1
      settings: {}
"""
_IMPORTERS = {
    ".cs": f"MonoImporter:\n{_EMPTY}{_SCRIPT}",
    ".asmdef": f"AssemblyDefinitionImporter:\n{_EMPTY}",
    ".md": f"TextScriptImporter:\n{_EMPTY}",
    ".xml": f"TextScriptImporter:\n{_EMPTY}",
    ".jslib": f"PluginImporter:\n{_EMPTY}{_WEBGL_ONLY}",
    ".json": f"PackageManifestImporter:\n{_EMPTY}",
}
_FOLDER = f"folderAsset: yes\nDefaultImporter:\n{_EMPTY}"
_TAIL = "  userData: \n  assetBundleName: \n  assetBundleVariant: \n"


def assets() -> list[Path]:
    """Every file and folder that Unity imports: it passes over names with a dot in front or a tilde behind."""
    return sorted(path for path in PACKAGE.rglob("*") if path.suffix != ".meta" and not _hidden(path))


def meta_of(path: Path) -> Path:
    """Where the asset's .meta file is."""
    return path.with_name(path.name + ".meta")


def guid(path: Path) -> str:
    """32 hexadecimal digits."""
    name = f"com.capture2vr.client/{path.relative_to(PACKAGE).as_posix()}"
    return hashlib.sha256(name.encode()).hexdigest()[:32]


def meta(path: Path) -> str:
    """The content of the asset's .meta file. Raises KeyError for a kind of file that the package has none of yet."""
    importer = _FOLDER if path.is_dir() else _IMPORTERS[path.suffix]
    return f"fileFormatVersion: 2\nguid: {guid(path)}\n{importer}{_TAIL}"


def _hidden(path: Path) -> bool:
    return any(part.startswith(".") or part.endswith("~") for part in path.relative_to(PACKAGE).parts)


if __name__ == "__main__":
    for each in assets():
        meta_of(each).write_text(meta(each))
