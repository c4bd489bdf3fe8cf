"""The number of failures after which a batch is stopped (``--max-failures``)."""

import re
from dataclasses import dataclass
from typing import Self

from depthcli.errors import UsageError
from depthcli.jobs.batch.tally import Tally


@dataclass(frozen=True, slots=True)
class FailureBudget:
    """Allowed failures: among all inputs, or as a percentage of the last hundred processed ones.

    The percentage is of a hundred from the first input on: missing ones count as successful. So a
    run that fails from the start stops as soon as one that starts to fail after days.
    """

    maximum: int
    is_percentage: bool = False

    @classmethod
    def parse(cls, word: str) -> Self:
        """Parse ``20`` or ``20%``.

        Raises:
            UsageError: it is neither, or more than 100%.
        """
        found = re.fullmatch(r"([0-9]{1,9})(%?)", word)
        if found is None or (found[2] and int(found[1]) > 100):  # noqa: PLR2004 - per cent
            raise UsageError(
                f"--max-failures {word} is not a number or a percentage, such as 20 or 5%"
            )
        return cls(int(found[1]), bool(found[2]))

    def reason(self, tally: Tally) -> str | None:
        """Why a batch has to stop; None if it may continue."""
        if (
            sum(tally.recent_failed) if self.is_percentage else len(tally.failures)
        ) <= self.maximum:
            return None
        plain = "1 input" if self.maximum == 1 else f"{self.maximum} inputs"
        which = f"{self.maximum}% of the last 100 inputs" if self.is_percentage else plain
        return f"more than {which} failed"
