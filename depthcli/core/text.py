"""Text that others wrote, such as names of files, made fit for one line."""

from __future__ import annotations


def one_line(text: str) -> str:
    """Text with everything that is not printable escaped: file names may hold any byte."""
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)
