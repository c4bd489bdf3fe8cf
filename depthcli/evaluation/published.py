"""The paper's own table, for comparison.

Source: Table I of "Depth Map Estimation from a Single 2D Image": 449 test images of NYU Depth v2,
pairs 1001-1449. The numbers are as printed, not measured here.
"""

from depthcli.evaluation.choices import Source
from depthcli.evaluation.report import ReportRow
from depthcli.metrics.accumulate import Scores

PUBLISHED_COUNT = 449
MISPRINT = (
    "log10 of CycleGAN is a misprint in the paper: log10·ln10 / rms_log is .80 in every other row, "
    "which puts it near .1435"
)


def _published_row(name: str, note: str = "", **scores: float) -> ReportRow:
    return ReportRow(
        name=f"{name} (paper)",
        source=Source.PUBLISHED,
        alignment=None,
        image_count=PUBLISHED_COUNT,
        scores=Scores.of(**scores),
        note=note,
    )


# fmt: off
PUBLISHED: tuple[ReportRow, ...] = (
    _published_row("CycleGAN", abs_rel=.3483, rmse=1.2226, rms_log=.4096, log10=.1164,
         d1=.4401, d2=.7248, d3=.8793, note=MISPRINT),
    _published_row("CUT", abs_rel=.3450, rmse=1.1969, rms_log=.4048, log10=.1421,
         d1=.4335, d2=.7317, d3=.8875),
    _published_row("FastCUT", abs_rel=.3385, rmse=1.2501, rms_log=.4091, log10=.1426,
         d1=.4420, d2=.7331, d3=.8821),
    _published_row("DCLGAN", abs_rel=.3384, rmse=1.1894, rms_log=.3993, log10=.1398,
         d1=.4434, d2=.7414, d3=.8903),
    _published_row("SimDCL", abs_rel=.3483, rmse=1.1881, rms_log=.4080, log10=.1427,
         d1=.4380, d2=.7300, d3=.8855),
    _published_row("HnegSRC", abs_rel=.3514, rmse=1.2163, rms_log=.4105, log10=.1437,
         d1=.4328, d2=.7244, d3=.8812),
    _published_row("Proposed", abs_rel=.2727, rmse=.9712, rms_log=.3363, log10=.1164,
         d1=.5296, d2=.8154, d3=.9331),
)
# fmt: on
