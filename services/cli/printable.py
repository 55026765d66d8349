"""Make texts of others safe to print: names of files and things, and what a gateway says."""

from __future__ import annotations


def printable(text: str) -> str:
    """Replace unprintable characters: file names may have line ends, terminal control codes and invalid bytes."""
    return "".join(letter if letter.isprintable() else "\N{REPLACEMENT CHARACTER}" for letter in text)
