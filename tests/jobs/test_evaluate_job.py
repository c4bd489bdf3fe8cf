"""A comparison on NYU Depth v2 by a program: no terminal, no words, one value in and one out."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from helpers.tiny import write_model
from helpers.watched import Watched

from depthcli.core.options import Mask
from depthcli.datasets.base import SplitName
from depthcli.errors import DatasetError
from depthcli.evaluation.evaluate import EvalOptions
from depthcli.evaluation.page import report_page
from depthcli.evaluation.protocol import EvalProtocol
from depthcli.inference.loading import SessionLoader
from depthcli.jobs.evaluate import EvalRequest, ReportFiles, run_evaluation

COUNT = 8


@pytest.fixture
def request_of_val(tmp_path: Path) -> EvalRequest:
    """Eight scenes of one pair, and the tiny model."""
    for name in ("rgb", "depth"):
        (tmp_path / "nyu" / name).mkdir(parents=True)
    rows = ["id,scene,official_split"]
    for i in range(COUNT):
        gray, depth = np.full((480, 640), 20 * i, np.uint8), np.full((480, 640), 2500, np.uint16)
        cv2.imwrite(str(tmp_path / "nyu" / "rgb" / f"{i:04d}.png"), gray)
        cv2.imwrite(str(tmp_path / "nyu" / "depth" / f"{i:04d}.png"), depth)
        rows.append(f"{i:04d},room_{i:04d},train")
    (tmp_path / "nyu" / "index.csv").write_text("\n".join(rows))
    loader = SessionLoader(write_model(tmp_path / "tiny"), "cpu", 1)
    return EvalRequest(
        tmp_path / "nyu",
        (loader,),
        split=SplitName.VAL,
        options=EvalOptions(trivial=False),
        shown_ids=(),
    )


def test_a_program_gets_the_table_and_the_figures(
    request_of_val: EvalRequest, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    watched = Watched()
    done = run_evaluation(request_of_val, watched)
    assert list(watched.stages) == ["comparing images", "drawing pictures"]
    (row,) = done.report.rows
    assert (row.image_count, len(done.figures)) == (1, 2)
    files = ReportFiles(tmp_path / "t.csv", tmp_path / "sheets", tmp_path / "t.html")
    written = list(files.write(report_page(done.report), done.report.to_csv(), done.figures))
    assert [path.name for path in written] == ["depth-gray.png", "depth-colour.png"]
    assert all(path.is_file() for path in (*written, tmp_path / "t.csv", tmp_path / "t.html"))
    assert capsys.readouterr() == ("", "")


def test_missing_raw_depth_is_refused_early(request_of_val: EvalRequest) -> None:
    watched = Watched()
    raw = replace(request_of_val.options, protocol=EvalProtocol(mask=Mask.RAW))
    with pytest.raises(DatasetError):
        run_evaluation(replace(request_of_val, options=raw), watched)
    assert watched.begun == []
