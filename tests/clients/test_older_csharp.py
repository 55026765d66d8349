"""Newer C# in the notation that Mono's compiler reads."""

from __future__ import annotations

import pytest

from tests.support.clients.older_csharp import as_older_csharp


@pytest.mark.parametrize(
    ("newer", "older"),
    [
        ("static List<int> all = new();", "static List<int> all = new List<int>();"),
        ("first ??= other.First;", "first = first ?? (other.First);"),
        ("if (instance is null)", "if ((object)instance == null)"),
        ("if (made is Resource { IsOnly: true })", "if ((made as Resource)?.IsOnly == true)"),
        ("f(out var _, out var _)", "f(out var discarded0, out var discarded1)"),
        ("public interface A\n{\n public bool On { get; }\n}", "public interface A\n{\n bool On { get; }\n}"),
        ("fixed (T* all = values)\n UnsafeUtility.MemCpy(all, from, 4)",
         "if (values.Length > 0) UnsafeUtility.MemCpy(UnsafeUtility.AddressOf(ref values[0]), from, 4)"),
        ("public uint Write<T>(in T val) where T : unmanaged { return 0; }", ""),
        ("public uint Write<T>(T[] all) where T : unmanaged { return 1; }",
         "public uint Write<T>(T[] all) => throw new NotSupportedException();"),
    ],
)  # fmt: skip
def test_newer_notation_becomes_older(newer: str, older: str) -> None:
    assert as_older_csharp(newer) == older


@pytest.mark.parametrize(
    "text", ["// the value is null, an interface to it", "public class A { public bool On; }", "a = b ?? c;"]
)
def test_other_text_stays(text: str) -> None:
    assert as_older_csharp(text) == text
