"""Dividing a batch among independent processes."""

import hashlib
import os
import re
from dataclasses import dataclass
from typing import Self

from depthcli.errors import UsageError


@dataclass(frozen=True, slots=True)
class Shard:
    """One of ``count`` parts; every input is in exactly one of them.

    The part is ``1 + H % count``, H being the first eight bytes of the SHA-256 of the input's name
    as a big-endian number: it depends on the name alone, on any machine and in any version.
    """

    number: int = 1  #: 1 to ``count``
    count: int = 1  #: how many parts there are; 1 for a batch that is not divided

    @classmethod
    def parse(cls, word: str) -> Self:
        """From ``2/4``.

        Raises:
            UsageError: it is something else, or there is no such part.
        """
        numbers = re.fullmatch(r"([0-9]{1,9})/([0-9]{1,9})", word)
        shard = cls(*map(int, numbers.groups())) if numbers else cls(0, 0)
        if not 1 <= shard.number <= shard.count:
            raise UsageError(f"--shard {word} is not I/N with I from 1 to N, such as 2/4")
        return shard

    def holds(self, name: str) -> bool:
        """Whether an input of this name, with ``/`` between its parts, is in this part."""
        if self.count == 1:
            return True
        digest = hashlib.sha256(os.fsencode(name)).digest()
        return int.from_bytes(digest[:8], "big") % self.count == self.number - 1

    @property
    def tag(self) -> str:
        """Infix for names of files that belong to this part."""
        return f"-{self.number}-of-{self.count}" if self.count > 1 else ""


WHOLE = Shard()
