"""Including and excluding names by glob patterns, as in shells and .gitignore."""

import re
from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple, Self

from depthcli.errors import UsageError
from depthcli.io.listing.skipped import EXCLUDED, NOT_INCLUDED

_STARS = {"**/", "**", "*"}
_TOKEN = re.compile(r"\*\*/|\*\*|\*|\?|\[!?\]?[^\]/]*\]|.", re.DOTALL)


class NameFilter(NamedTuple):
    """Patterns for paths relative to a root, with ``/`` between their parts.

    A pattern without ``/`` is matched with the last part, in any folder; one with ``/`` with the
    whole path. ``*`` and ``?`` do not match ``/``, ``**`` does.
    """

    include: tuple[re.Pattern[str], ...]  #: a file has to match one of these, if there are any
    exclude: tuple[re.Pattern[str], ...]  #: a file or a folder must match none of these
    include_words: tuple[str, ...]  #: ``include`` as the user gave it

    @classmethod
    def of(cls, include: Sequence[str], exclude: Sequence[str]) -> Self:
        """From patterns as the user gives them.

        Raises:
            UsageError: one is not a valid pattern.
        """
        return cls(tuple(map(_compiled, include)), tuple(map(_compiled, exclude)), tuple(include))

    def refusal(self, name: str) -> str | None:
        """Why a file is not wanted, by its own name and its folders'; None if it is wanted."""
        parts = name.split("/")
        above = ("/".join(parts[:count]) for count in range(1, len(parts)))
        if self.excludes(name) or any(map(self.excludes, above)):
            return EXCLUDED
        wanted = not self.include or any(p.fullmatch(name) for p in self.include)
        return None if wanted else NOT_INCLUDED

    def excludes(self, name: str) -> bool:
        """Whether a file or folder is excluded by its own name."""
        return any(pattern.fullmatch(name) for pattern in self.exclude)


ANY = NameFilter((), (), ())
"""Every name."""


def _compiled(pattern: str) -> re.Pattern[str]:
    trimmed = pattern.rstrip("/")
    anywhere = "" if "/" in trimmed else "(?:.*/)?"
    found = _TOKEN.findall(trimmed.removeprefix("/").removeprefix("./"))
    tokens = [
        one for at, one in enumerate(found) if one not in _STARS or found[at - 1 : at] != [one]
    ]
    stars = [at for at, token in enumerate(tokens) if token in _STARS]
    parts = list(map(_expression, tokens))
    for at, after in pairwise(stars):
        if tokens[at] == "*" and tokens[after] != "**/":
            # An atomic group takes the first match of what follows the star; with backtracking,
            # each star would multiply the time that a name takes.
            parts[at], parts[after] = f"(?>{parts[at]}?", f"){parts[after]}"
    try:
        return re.compile(anywhere + "".join(parts), re.DOTALL)
    except re.error as error:
        raise UsageError(f"{pattern!r} is not a valid pattern: {error.msg}") from error


def _expression(token: str) -> str:
    simple = {"**/": "(?:.*/)?", "**": ".*", "*": "[^/]*", "?": "[^/]"}
    if token in simple:
        return simple[token]
    if len(token) > 1:  # a class of characters, [a-z] or [!a-z]
        inner = token[1:-1].replace("\\", "\\\\").replace("[", "\\[")
        return f"[^{inner[1:]}/]" if inner.startswith("!") else f"[{inner}]"
    return re.escape(token)
