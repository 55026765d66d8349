"""Write PLY files of any elements, with scalars and lists in any order."""

from __future__ import annotations

import struct
from collections.abc import Sequence

CODES = {"char": "b", "uchar": "B", "short": "h", "ushort": "H", "int": "i", "uint": "I", "float": "f", "double": "d"}
Value = float | Sequence[float]


def ply(form: str, elements: Sequence[tuple[str, Sequence[tuple[str, str]], Sequence[Sequence[Value]]]]) -> bytes:
    """A PLY of elements: name, properties (kind or "count kind", name), rows of numbers and lists."""
    order = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}[form]
    head, body = [f"ply\nformat {form} 1.0\n"], bytearray()
    for name, properties, rows in elements:
        head.append(f"element {name} {len(rows)}\n")
        head += [f"property {'list ' if ' ' in kind else ''}{kind} {each}\n" for kind, each in properties]
        for row in rows:
            words: list[str] = []
            for (kind, _), value in zip(properties, row, strict=True):
                *count, item = kind.split()
                values = list(value) if isinstance(value, Sequence) else [value]
                words += [*([str(len(values))] if count else []), *(f"{each:.15g}" for each in values)]
                if order:
                    body += struct.pack(order + CODES[count[0]], len(values)) if count else b""
                    cast = float if item in ("float", "double") else int
                    body += struct.pack(f"{order}{len(values)}{CODES[item]}", *map(cast, values))
            if not order:
                body += " ".join(words).encode() + b"\n"
    return "".join([*head, "end_header\n"]).encode() + bytes(body)
