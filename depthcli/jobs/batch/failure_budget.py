"""How much may fail before a batch is given up."""

import re
from dataclasses import dataclass
from typing import Self

from depthcli.errors import UsageError
from depthcli.jobs.batch.tally import Tally


@dataclass(frozen=True, slots=True)
class FailureBudget:
    """Failures that are allowed: of all inputs, or of the last hundred that were worked on.

    The share is one of the last hundred from the first input on: those to come count as done. So a
    run that goes wrong from its beginning and one that goes wrong after days stop equally soon.
    """

    most: int
    is_share: bool = False

    @classmethod
    def parse(cls, word: str) -> Self:
        """From ``20`` or ``20%``.

        Raises:
            UsageError: it is something else, or more than 100%.
        """
        found = re.fullmatch(r"([0-9]{1,9})(%?)", word)
        if found is None or (found[2] and int(found[1]) > 100):  # noqa: PLR2004 - per cent
            raise UsageError(
                f"--max-failures {word} is not a number or a percentage, such as 20 or 5%"
            )
        return cls(int(found[1]), bool(found[2]))

    def reason(self, tally: Tally) -> str | None:
        """Why a batch has to stop; None while it may go on."""
        if (sum(tally.recent_failed) if self.is_share else len(tally.failures)) <= self.most:
            return None
        plain = "1 input" if self.most == 1 else f"{self.most} inputs"
        which = f"{self.most}% of the last 100 inputs" if self.is_share else plain
        return f"more than {which} failed"
