"""C# 8 and 9 written as the C# 7.3 that Mono's compiler reads: only notation, of code that is not ours to change."""

from __future__ import annotations

import re
from collections.abc import Callable

_NAME = r"[\w.]+"
_TYPE = r"[\w.]+(?:<[\w.<>, ]+>)?(?:\[\])?"
_REWRITTEN = (
    (re.compile(rf"({_TYPE}) ({_NAME}) = new\(\)"), r"\1 \2 = new \1()"),
    (re.compile(rf"({_NAME}) \?\?= ([^;]+);"), r"\1 = \1 ?? (\2);"),
    (re.compile(rf"({_NAME}) is null(?=\s*(?:\)|&&|\|\|))"), r"(object)\1 == null"),
    (re.compile(rf"({_NAME}) is ({_NAME}) {{ (\w+): true }}"), r"(\1 as \2)?.\3 == true"),
    # Pointers to a type that is a parameter, by what the engine has for whoever cannot write them.
    (re.compile(r"\bT : unmanaged\b"), "T : struct"),
    (re.compile(r"\bsizeof\(T\)"), "UnsafeUtility.SizeOf<T>()"),
    (re.compile(r"\bT val;"), "T val = default(T);"),
    (re.compile(r"&val\b"), "UnsafeUtility.AddressOf(ref val)"),
    (
        re.compile(r"\bfixed \(T\* (\w+) = (\w+)\)\s+UnsafeUtility.MemCpy\(\1, "),
        r"if (\2.Length > 0) UnsafeUtility.MemCpy(UnsafeUtility.AddressOf(ref \2[0]), ",
    ),
)
_INTERFACE = re.compile(r"^[ \t]*(?:\w+ )*interface \w+[^{]*\{", re.MULTILINE)
_WRITE = re.compile(r"public uint Write<T>\(([^)]*)\) where T : struct\s*\{")
_REFUSAL = " => throw new NotSupportedException();"
_DISCARD = re.compile(r"\bout var _\b")


def as_older_csharp(source: str) -> str:
    """Return a source file with the same meaning, in the notation of C# 7.3.

    What writes values into binary catalogues, as only Unity's editor does, refuses to.
    """
    for newer, older in _REWRITTEN:
        source = newer.sub(older, source)
    source = _blocks(source, _INTERFACE, lambda head, body: head + re.sub(r"\bpublic ", "", body))
    source = _blocks(source, _WRITE, lambda head, body: "" if "in T " in head else head.split(" where")[0] + _REFUSAL)
    return _with_named_discards(source)


def _with_named_discards(source: str) -> str:
    """Give each discarded argument a name of its own: Mono's compiler takes two in a method for one variable."""
    parts = _DISCARD.split(source)
    named = (f"out var discarded{number}{part}" for number, part in enumerate(parts[1:]))
    return parts[0] + "".join(named)


def _blocks(source: str, head: re.Pattern[str], rewrite: Callable[[str, str], str]) -> str:
    """Rewrite each block whose head, up to its opening brace, is found."""
    done, place = "", 0
    for found in head.finditer(source):
        end = _closing_brace(source, found.end()) + 1
        done += source[place : found.start()] + rewrite(found[0], source[found.end() : end])
        place = end
    return done + source[place:]


def _closing_brace(source: str, start: int) -> int:
    """Return where the block ends whose opening brace is before `start`."""
    depth = 1
    for place in range(start, len(source)):
        depth += {"{": 1, "}": -1}.get(source[place], 0)
        if depth == 0:
            return place
    return len(source)
