"""Reads the licence of an installed distribution, and finds GPL code among the libraries that its wheel bundles."""

from __future__ import annotations

import mmap
import re
from importlib.metadata import Distribution, distribution
from pathlib import Path

UNKNOWN = "unknown"

GPL = "GPL-2.0-or-later"
GPL_BUNDLED = {
    # FFmpeg is linked to these two encoders, which the product never calls. Its decoders are under the LGPL.
    "av": {"x264", "x265"},
    # The same encoder beside libheif. The variants without it decode with a libheif that has known memory errors.
    "pillow-heif": {"x265"},
    # Ceres solves bundle adjustment with it; linked into the one module that the wheel has.
    "pycolmap": {"CHOLMOD/Supernodal"},
}
"""Wheels that say BSD of their own code, and the code under `GPL` that they bundle. It binds who hands on an image with
them in it. A test looks for such code in all wheels."""

# Before metadata had a field for SPDX expressions, licences were told by classifiers, by any words, or by the text.
_CLASSIFIERS = {
    "Apache Software License": "Apache-2.0",
    "BSD License": "BSD",
    "ISC License (ISCL)": "ISC",
    "MIT License": "MIT",
    "Mozilla Public License 2.0 (MPL 2.0)": "MPL-2.0",
}
_WORDS = {
    "3-Clause BSD License": "BSD-3-Clause",
    "Apache 2.0": "Apache-2.0",
    "BSD 3-Clause License": "BSD-3-Clause",
}
_TEXTS = {
    "Permission is hereby granted, free of charge": "MIT",
    "Redistribution and use in source and binary forms": "BSD",
    "Licensed under the Apache License, Version 2.0": "Apache-2.0",
}
_SHARED_OBJECT = re.compile(r"\.(so|dylib|dll|pyd)(\.|$)")
_GPL_LIBRARY = re.compile(r"(?:lib)?(x264|x265|xvidcore|postproc|rubberband|vidstab|fftw3|gsl|readline)(?![a-z])")
# Found in the file that GPL code is linked into: a path in CHOLMOD's error messages, a flag of FFmpeg's build.
_GPL_MARKS = ("CHOLMOD/Supernodal", "--enable-gpl")


def licence_of(name: str) -> str:
    """SPDX expression of an installed distribution's licence, or `UNKNOWN`. Raises PackageNotFoundError."""
    found = distribution(name)
    words = _field(found, "License").strip()
    expression = _field(found, "License-Expression") or _several(words)
    told = expression or _classified(found) or _by_text(words) or _short(words)
    return told or _by_text(_licence_files(found)) or UNKNOWN


def permits(expression: str, accepted: set[str]) -> bool:
    """Whether an SPDX expression lets one choose among accepted licences alone. Of one with parentheses, all count."""
    if "(" in expression:
        return all(licence in accepted for licence in re.split(r"[()]| AND | OR ", expression) if licence.strip())
    return any(all(licence in accepted for licence in each.split(" AND ")) for each in expression.split(" OR "))


def gpl_code_in(name: str) -> set[str]:
    """What the compiled files of an installed distribution bring that is under the GPL, as far as it is known here."""
    files = [file for file in distribution(name).files or () if _SHARED_OBJECT.search(file.name)]
    libraries = {match[1] for file in files if (match := _GPL_LIBRARY.match(file.name))}
    return libraries.union(*(_marks(Path(str(file.locate()))) for file in files))


def _field(found: Distribution, name: str) -> str:
    return str((found.metadata.get_all(name) or [""])[0])


def _classified(found: Distribution) -> str:
    names = (each.rpartition(" :: ")[2] for each in found.metadata.get_all("Classifier", ()) if each[:7] == "License")
    return " AND ".join(sorted({_CLASSIFIERS.get(name, name) for name in names}))


def _licence_files(found: Distribution) -> str:
    names = found.metadata.get_all("License-File", ())
    return "\n".join(found.read_text(f"licenses/{name}") or "" for name in names)


def _several(words: str) -> str:
    return words if re.fullmatch(r"[\w.+-]+( (AND|OR) [\w.+-]+)+", words) else ""


def _by_text(words: str) -> str:
    return next((licence for sentence, licence in _TEXTS.items() if sentence in words), "")


def _short(words: str) -> str:
    return _WORDS.get(words, words if re.fullmatch(r"[\w.+-]+", words) else "")


def _marks(path: Path) -> set[str]:
    if path.stat().st_size == 0:
        return set()
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
        return {mark for mark in _GPL_MARKS if content.find(mark.encode()) >= 0}
