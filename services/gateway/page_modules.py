"""The JavaScript modules of a page, named in the page itself: no module waits until its importer has come."""

from __future__ import annotations

import json
import re
from functools import lru_cache
from pathlib import Path

# `import … from './x'`, `import './x'` and `export … from './x'` where a statement begins; not `import('./x')`.
# In minified modules that is behind another one, or a comment.
_IMPORT = re.compile(
    r"""(?:^|;|\*/)(?:import|export)\b(?!\s*\()(?:[^'"();]*?\bfrom)?\s*['"](\.[^'"]+)['"]""", re.MULTILINE
)
_LATER = re.compile(r"""\bimport\(\s*['"](\.[^'"]+)['"]""")
_ADDRESS = re.compile(r'"/web/([\w./-]+\.js)"')
_ENTRY = re.compile(r'( *)<script type="module" src="/web/([^"]+)"(?: data-later="/web/([^"]+)")?></script>')


def name_modules(html: str, web: Path) -> str:
    """Return a page with a `modulepreload` link for each module that its script imports.

    A script may load another one later: `data-later` names it. That one and all its modules are listed in an element
    with the id "later", as JSON, for the script to preload them when it is time.

    web: the folder whose files have the addresses /web/…
    """

    web = web.resolve()  # imports are resolved: a release is often reached by a link

    def name(found: re.Match[str]) -> str:
        indent, entry, later = found.groups()
        now = static_imports(web / entry)
        lines = [f'<link rel="modulepreload" fetchpriority="low" href="{_address(each, web)}">' for each in now]
        if later:
            then = [web / later, *static_imports(web / later)]
            addresses = [_address(each, web) for each in then if each not in now and each != web / entry]
            lines.append(f'<script id="later" type="application/json">{json.dumps(addresses)}</script>')
        return "\n".join(indent + line for line in [*lines, f'<script type="module" src="/web/{entry}"></script>'])

    return _ENTRY.sub(name, html)


def static_imports(module: Path) -> list[Path]:
    """Return all modules that a module imports statically, directly or through others: the nearest first, each once.

    module: JavaScript, with relative addresses in its imports. Raises FileNotFoundError for an import of no file.
    """
    found = {module: None}  # a dict for its order
    nearest = [module]
    while nearest:
        imports = dict.fromkeys(each for importer in nearest for each in _imports_of(importer))
        nearest = [each for each in imports if each not in found]
        found |= dict.fromkeys(nearest)
    return [each for each in found if each != module]


def modules_of_page(html: str, web: Path) -> list[Path]:
    """Return all modules that a page loads, at once or later, third parties' excepted.

    html: of `name_modules`, which names those that are loaded at once; `import('./x')` in a module names others
    """
    web = web.resolve()
    nearest = [web / address for address in dict.fromkeys(_ADDRESS.findall(html))]
    found: dict[Path, None] = {}
    while nearest:
        found |= dict.fromkeys(nearest)
        later = [module for each in nearest for module in (*_imports_of(each), *_later_imports(each))]
        nearest = [each for each in dict.fromkeys(later) if each not in found]
    return [each for each in found if each.parent.name != "vendor"]


def _later_imports(module: Path) -> list[Path]:
    return [(module.parent / name).resolve() for name in _LATER.findall(module.read_text(encoding="utf-8"))]


def _imports_of(module: Path) -> tuple[Path, ...]:
    now = module.stat()
    return _read_imports(module, now.st_mtime_ns, now.st_size)


@lru_cache(maxsize=512)
def _read_imports(module: Path, modified_ns: int, size: int) -> tuple[Path, ...]:
    """Read a module's own imports, again only when it has changed: the 3D library is a megabyte."""
    text = module.read_text(encoding="utf-8")
    return tuple((module.parent / found[1]).resolve(strict=True) for found in _IMPORT.finditer(text))


def _address(module: Path, web: Path) -> str:
    return f"/web/{module.relative_to(web).as_posix()}"
