"""Gather the pages of the documentation site in build/docs: `python docs/make_site.py`, then `zensical build`.

Pages lie where their readers on a code host look for them: docs/, deploy/, clients/, tests/bench/. They are copied into
one folder, and their relative links are rewritten to where their targets lie there. A link to a file of the repository
that is no page becomes its plain name; a link to nothing is an error. The pages of the HTTP API are written from the
gateway's own OpenAPI document.
"""

from __future__ import annotations

import posixpath
import re
import shutil
import sys
from pathlib import Path

from api_pages import PAGES as API_PAGES
from api_pages import api_pages

ROOT = Path(__file__).parents[1]
SITE_PAGES = ROOT / "build" / "docs"

OTHER_PAGES = {
    "deploy/runbook.md": "runbook.md",
    "deploy/README.md": "deployment.md",
    "SECURITY.md": "security-policy.md",
    "CONTRIBUTING.md": "contributing.md",
    "CHANGELOG.md": "changelog.md",
    "clients/unity/README.md": "unity-package.md",
    "clients/godot/README.md": "godot-addon.md",
    "examples/README.md": "examples.md",
    "tests/bench/README.md": "bench/index.md",
}
"""Path in the repository -> path on the site, of the pages that do not lie in docs/ or tests/bench/results/."""
_PICTURES = (".jpg", ".png", ".svg")
_CODE = re.compile(r"^```.*?^```|`[^`\n]+`", re.DOTALL | re.MULTILINE)
_LINK = re.compile(r"(?P<text>!?\[(?:[^\[\]]|\[[^\]]*\])*\])\((?P<target>[^()\s]+)\)")


def site_paths(root: Path = ROOT) -> dict[str, str]:
    """Path in the repository -> path on the site, of every page and picture, those that are written here included."""
    paths = OTHER_PAGES | {f"docs/routes/{name}": f"routes/{name}" for name in API_PAGES}
    for folder, place in (("docs", ""), ("tests/bench", "bench/"), ("tests/bench/results", "bench/")):
        for file in sorted((root / folder).iterdir()):
            name = f"{folder}/{file.name}"
            if file.suffix in _PICTURES or (file.suffix == ".md" and name not in paths):
                paths[name] = place + file.name
    return paths


def page_on_site(text: str, path: str, paths: dict[str, str], root: Path = ROOT) -> tuple[str, list[str]]:
    """Rewrite the links of the page at `path` in the repository. Returns its text and the targets that do not exist."""
    missing: list[str] = []
    here = posixpath.dirname(paths[path])

    def rewritten(link: re.Match[str]) -> str:
        target, _, anchor = link["target"].partition("#")
        if not target or re.match(r"[a-z]+:|/", target):
            return link[0]
        there = posixpath.normpath(posixpath.join(posixpath.dirname(path), target))
        if there in paths:
            return f"{link['text']}({posixpath.relpath(paths[there], here or '.')}{'#' if anchor else ''}{anchor})"
        if not (root / there).exists():
            missing.append(link["target"])
        return link["text"].strip("[]") if "`" in link["text"] else f"`{there}`"

    pieces, end = [], 0
    for code in _CODE.finditer(text):
        pieces += [_LINK.sub(rewritten, text[end : code.start()]), code[0]]
        end = code.end()
    pieces.append(_LINK.sub(rewritten, text[end:]))
    return "".join(pieces), missing


def write_site(folder: Path, paths: dict[str, str]) -> list[str]:
    """Write all pages and pictures into the folder. Returns a sentence for each link that leads nowhere."""
    shutil.rmtree(folder, ignore_errors=True)
    faults: list[str] = []
    written = {f"docs/routes/{name}": text for name, text in api_pages()}
    for path, place in paths.items():
        target = folder / place
        target.parent.mkdir(parents=True, exist_ok=True)
        if target.suffix != ".md":
            shutil.copyfile(ROOT / path, target)
            continue
        text, missing = page_on_site(written.get(path) or (ROOT / path).read_text(), path, paths)
        target.write_text(text)
        faults += [f"{path}: the link {each} leads to no file" for each in missing]
    return faults


def main() -> None:
    """Write the site's pages; end with exit code 1 and the list where a link leads to no file."""
    if faults := write_site(SITE_PAGES, site_paths()):
        sys.exit("\n".join(faults))


if __name__ == "__main__":
    main()
