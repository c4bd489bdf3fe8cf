"""Checking the row to compare with every other, before anything is scored."""

from collections import Counter
from collections.abc import Collection, Sequence

from depthcli.errors import UsageError
from depthcli.evaluation.predictors.base import Predictor
from depthcli.evaluation.predictors.trivial import TRIVIAL_NAMES
from depthcli.evaluation.run import entry_for
from depthcli.evaluation.table import EvalOptions, EvalTask
from depthcli.metrics.choices import Averaging


def check_row(name: str, rows: Collection[str]) -> None:
    """Check that there is a row of this name.

    Raises:
        UsageError: there is none.
    """
    if name not in rows:
        raise UsageError(f"--against {name} is not a row; choose from {', '.join(rows)}")


def check_against(
    name: str, task: EvalTask, predictors: Sequence[Predictor], options: EvalOptions
) -> None:
    """Check that a row can be compared with another, image by image.

    Raises:
        UsageError: there is no such row or no other of its alignment, two rows have one name, the
            average is over pooled pixels, or no alignment suits a predictor.
    """
    if options.protocol.averaging is Averaging.POOLED:
        raise UsageError("--against compares means over images: remove --average pooled")
    trivial = TRIVIAL_NAMES if task.has_trivial(options) else ()
    names = [*trivial, *(predictor.name for predictor in predictors)]
    check_row(name, names)
    most_common, count = Counter(names).most_common(1)[0]
    if count > 1:
        raise UsageError(f"--against needs rows of different names: {most_common} is given twice")
    aligned = {p.name: set(entry_for(p, options.alignments).alignments) for p in predictors}
    own = aligned.pop(name, set())
    if not trivial and not own & set().union(*aligned.values()):
        raise UsageError(f"--against {name}: there is no other row of its alignment; add one")
