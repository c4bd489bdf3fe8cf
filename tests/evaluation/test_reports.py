"""A table as text, JSON and CSV, to the letter."""

import json
import math
from dataclasses import replace

import pytest

from depthcli._version import __version__
from depthcli.core.options import Alignment
from depthcli.datasets.base import ALL_PAIRS
from depthcli.evaluation.page import report_page
from depthcli.evaluation.protocol import EvalProtocol
from depthcli.evaluation.report import EvalReport, ImageScores, ReportRow, Source
from depthcli.metrics.boundary import BoundaryScores
from depthcli.metrics.depth import Scores

SCORES = Scores((0.125, 0.0625, 0.5, 0.25, 0.1, 0.75, 0.875, 1.0, 12.345))
EDGES = BoundaryScores(1.5, 2.255, 0.5)
MODEL = ReportRow(
    "a\nb",
    Source.MODEL,
    Alignment.MEDIAN,
    2,
    SCORES,
    empty_count=1,
    note="a\nb was trained on 1",
    model_sha256="ab12",
    images=(ImageScores("0001", SCORES, EDGES), ImageScores("0002", Scores.of())),
    boundary=EDGES,
    train_overlap=1,
    stated="metric, m",
    pixel_count=900,
)
PRINTED = ReportRow("CUT (paper)", Source.PUBLISHED, None, 449, Scores.of(abs_rel=0.345))
REPORT = EvalReport(
    dataset="rooms",
    split="paper",
    image_count=3,
    split_count=449,
    train_count=0,
    protocol=EvalProtocol(boundary=True),
    notes=("a note",),
    rows=(PRINTED, MODEL),
)
TEXT = """\
rooms · paper split, 3 of 449 images · protocol: headline
in-filled depth, full frame at 640×480, 0.001 < g < 10 m, mean of images

row          align   images  pixels  abs_rel  sq_rel    rmse  rms_log   log10      d1      d2      d3  silog  dbe_acc  dbe_comp  edge_f1
CUT (paper)  -          449       -   0.3450       -       -        -       -       -       -       -      -        -         -        -
a\\nb*        median       2     900   0.1250  0.0625  0.5000   0.2500  0.1000  0.7500  0.8750  1.0000  12.35     1.50      2.25   0.5000

higher is better for d1, d2, d3, edge_f1, lower for the others; sq_rel and rmse in metres
predictions: metric, m (a\\nb)
* a\\nb was trained on 1
a note
1 images have no valid pixel and are excluded"""  # noqa: E501
CSV = """\
name,source,align,dataset,split,images,depth,pixels,trained_on,protocol,abs_rel,sq_rel,rmse,rms_log,log10,d1,d2,d3,silog,dbe_acc,dbe_comp,edge_f1
CUT (paper),published,,rooms,paper,449,-,,,headline,0.345,,,,,,,,,,,
"a
b",model,median,rooms,paper,2,"metric, m",900,1,headline,0.125,0.0625,0.5,0.25,0.1,0.75,0.875,1.0,12.345,1.5,2.255,0.5
"""  # noqa: E501
NAMES = ("abs_rel", "sq_rel", "rmse", "rms_log", "log10", "d1", "d2", "d3", "silog")
EDGES_JSON = {"dbe_acc": 1.5, "dbe_comp": 2.255, "edge_f1": 0.5}
SCORES_JSON = dict(zip(NAMES, SCORES.values, strict=True)) | EDGES_JSON


def test_text() -> None:
    page = report_page(REPORT)
    assert page.to_text() == TEXT
    assert page.models == ["a\\nb sha256 ab12"]
    plain = replace(REPORT, protocol=EvalProtocol(), rows=(PRINTED,), notes=())
    assert report_page(plain).to_text().splitlines()[-2:] == [
        "",
        "higher is better for d1, d2, d3, lower for the others; sq_rel and rmse in metres",
    ]


def test_csv() -> None:
    assert REPORT.to_csv() == CSV


def test_json() -> None:
    text = REPORT.to_json()
    document = json.loads(text)
    assert text == json.dumps(document, indent=2)
    protocol = document.pop("protocol")
    assert (
        protocol["description"]
        == "in-filled depth, full frame at 640×480, 0.001 < g < 10 m, mean of images"
    )
    assert "boundary" not in protocol
    assert document == {
        "schema": 1,
        "software": f"depthcli {__version__}",
        "dataset": "rooms",
        "split": {
            "name": "paper",
            "images": 3,
            "images_of_complete_split": 449,
            "training_pairs_of_trivial_rows": 0,
        },
        "rows": [
            {
                "name": "CUT (paper)",
                "source": "published",
                "align": None,
                "images": 449,
                "images_without_valid_pixel": 0,
                "depth": "-",
                "pixels": None,
                "scores": dict.fromkeys(NAMES) | {"abs_rel": 0.345},
            },
            {
                "name": "a\nb",
                "source": "model",
                "align": "median",
                "images": 2,
                "images_without_valid_pixel": 1,
                "depth": "metric, m",
                "pixels": 900,
                "scores": SCORES_JSON,
                "images_trained_on": 1,
                "note": "a\nb was trained on 1",
                "model_sha256": "ab12",
                "per_image": [
                    {"id": "0001"} | SCORES_JSON,
                    {"id": "0002"} | dict.fromkeys(NAMES),
                ],
            },
        ],
        "notes": ["a note"],
    }


@pytest.mark.parametrize(
    ("split", "count", "title"),
    [
        ("val", 449, "rooms · val split, 449 images · protocol: headline"),
        (ALL_PAIRS, 450, "rooms · all pairs, 449 of 450 images · protocol: headline"),
    ],
)
def test_title(split: str, count: int, title: str) -> None:
    assert replace(REPORT, split=split, image_count=449, split_count=count).title == title


def test_a_row_without_edges_has_none_of_their_scores() -> None:
    names = [*NAMES, *EDGES_JSON]
    assert [name for name, _ in PRINTED.items(boundary=True)] == names
    assert all(math.isnan(value) for _, value in list(PRINTED.items(boundary=True))[-3:])
    assert [name for name, _ in MODEL.items(boundary=False)] == list(NAMES)
