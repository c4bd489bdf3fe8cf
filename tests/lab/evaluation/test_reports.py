"""Reports and their figures."""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest
from helpers.small_set import Playback, SmallSet, noisy, small_set
from helpers.watched import Watched

from depthcli._version import __version__
from depthcli.core.types import DepthKind, DepthMap
from depthcli.errors import UsageError
from depthcli.io.formats.preview import PreviewWriter
from depthcli.lab.datasets.base import ALL_PAIRS, Split, SplitName
from depthcli.lab.evaluation.figures import Figure, choose_images, draw_figures
from depthcli.lab.evaluation.page import Page, html_page, report_page
from depthcli.lab.evaluation.protocol import EvalProtocol
from depthcli.lab.evaluation.report import EvalReport, ImageScores, ReportRow, Source
from depthcli.lab.evaluation.task import EvalTask
from depthcli.lab.options import Alignment

NAMES = ("abs_rel", "sq_rel", "rmse", "rms_log", "log10", "d1", "d2", "d3", "silog")
SCORES = dict(zip(NAMES, (0.125, 0.0625, 0.5, 0.25, 0.1, 0.75, 0.875, 1.0, 12.345), strict=True))
SCORES |= {"dbe_acc": 1.5, "dbe_comp": 2.255, "edge_f1": 0.5}
MODEL = ReportRow(
    "a\nb",
    Source.MODEL,
    Alignment.MEDIAN,
    2,
    SCORES,
    empty_count=1,
    note="a\nb was trained on 1",
    model_sha256="ab12",
    images=(ImageScores("0001", SCORES), ImageScores("0002", {})),
    train_overlap=1,
    stated="metric, m",
    pixel_count=900,
)
PRINTED = ReportRow("CUT (paper)", Source.PUBLISHED, None, 449, {"abs_rel": 0.345})
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
    facts = document.pop("metrics")
    assert [name for name, metric in facts.items() if metric["higher_is_better"]] == list(
        NAMES[5:8]
    )
    assert facts["rmse"]["unit"] == "metres"
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
                "scores": SCORES,
                "images_trained_on": 1,
                "note": "a\nb was trained on 1",
                "model_sha256": "ab12",
                "per_image": [{"id": "0001"} | SCORES, {"id": "0002"} | dict.fromkeys(NAMES)],
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


CELL = (240, 180)
TITLE, GAP = 26, 4


def _task(scenes: list[str], shape: tuple[int, int] = (12, 16)) -> EvalTask:
    dataset = replace(small_set(len(scenes), shape=shape), scenes=tuple(scenes))
    test = tuple(range(len(scenes)))
    return EvalTask(dataset, Split(SplitName.VAL, (), test, 0, len(test)), test)


def _pixels(figure: Figure) -> np.ndarray:
    pixels = cv2.imdecode(np.frombuffer(figure.png, np.uint8), cv2.IMREAD_COLOR)
    return pixels[..., ::-1]


def _cell(sheet: np.ndarray, row: int, column: int) -> np.ndarray:
    top = TITLE + row * (CELL[1] + GAP)
    left = GAP + column * (CELL[0] + GAP)
    return sheet[top : top + CELL[1], left : left + CELL[0]].astype(int)


def test_images_are_spread_over_the_scenes() -> None:
    scenes = [f"kitchen_{i:04d}" for i in range(9)] + ["living_room_0001a", "office_0003"]
    task = _task(scenes)
    assert choose_images(task, (), 2) == (2, 8)
    assert choose_images(task, (), 100) == tuple(range(len(scenes)))
    assert len(choose_images(task)) == 6
    assert choose_images(_task(["b", "a", "b", "a"]), (), 2) == (0, 3)


def test_named_images_keep_their_order_and_must_be_compared() -> None:
    task = _task(["a_1", "b_1", "c_1"])
    assert choose_images(task, ["0002", "0000"]) == (2, 0)
    with pytest.raises(UsageError):
        choose_images(task, ["0009"])


def test_holes_of_the_truth_are_no_depth() -> None:
    task = _task(["a_1"], (120, 160))
    dataset = task.dataset
    dataset.depths_m[:] = np.linspace(1, 8, 160, dtype=np.float32)
    dataset.depths_m[0, :60] = 0
    gray, _ = draw_figures(task, (0,), [("noisy", Playback(noisy(dataset)))])
    assert (_cell(_pixels(gray), 0, 2)[:80] == 96).all()
    dataset.depths_m[:] = 0
    empty, _ = draw_figures(task, (0,), [("noisy", Playback(noisy(dataset)))])
    assert (_cell(_pixels(empty), 0, 2) == 96).all()


class _Coloured(SmallSet):
    """Images of random colours."""

    def image(self, i: int) -> np.ndarray:
        shape = (*self.depths_m.shape[1:], 3)
        return np.random.default_rng(i).integers(0, 256, shape, np.uint8)


def test_every_cell_is_a_preview_in_the_range_of_its_rows_truth() -> None:
    """At the size of a cell, so that no pixel is resized but those of the smaller prediction."""
    task = _task(["a_1", "b_1"], CELL[::-1])
    dataset = _Coloured(**vars(task.dataset))
    shares = np.random.default_rng(3).uniform(0.2, 1, dataset.depths_m.shape)
    dataset.depths_m[:] *= shares.astype(np.float32)  # from 0.1 m on, with holes
    metric = Playback(noisy(dataset))
    inverse = np.random.default_rng(7).uniform(0, 1, (60, 90)).astype(np.float32)
    other = Playback(dict.fromkeys(dataset.ids, inverse), DepthKind.INVERSE)
    watched = Watched()
    gray, coloured = draw_figures(
        replace(task, dataset=dataset), (1, 0), [("a", metric), ("b", other)], watched
    )
    assert watched.stages == {"drawing images": (2, 2)}
    for row, i in enumerate((1, 0)):
        truth_m = dataset.depths_m[i]
        valid = truth_m > 0
        near, far = np.percentile(truth_m[valid], (2, 98))
        sized = cv2.resize(inverse, CELL, interpolation=cv2.INTER_AREA)
        fitted, masked = np.full((2, *truth_m.shape), np.nan, np.float32)
        fit = np.polyfit(sized[valid].astype(float), 1 / truth_m[valid].astype(float), 1)
        fitted[valid] = 1 / np.polyval(fit, sized[valid])
        masked[valid] = truth_m[valid]
        maps = [DepthMap(values) for values in (metric.maps[dataset.ids[i]], fitted, masked)]
        image = np.repeat(dataset.image(i).max(2)[..., None], 3, 2)
        for sheet, colormap in ((_pixels(gray), "gray"), (_pixels(coloured), "inferno")):
            assert np.array_equal(_cell(sheet, row, 0), image)
            writer = PreviewWriter(colormap=colormap, vmin=float(near), vmax=float(far))
            for column, depth in enumerate(maps, 1):
                cell = _cell(sheet, row, column)
                assert np.abs(cell - writer.render(depth).astype(int)).max() <= 3 * (column == 2)


def test_page_escapes_names_and_notes() -> None:
    figure = Figure("x", "<b>caption</b>", b"png")
    table = [["row"], ["<script>"]]
    page = html_page(Page("a < b", "c & d", table, ["'note'"], models=["m<b> 12"]), [figure])
    assert f"<footer>depthcli {__version__}<br>m&lt;b&gt; 12</footer>" in page
    assert "<script>" not in page
    assert "&lt;script&gt;" in page
    assert "<b>caption" not in page
    assert "a &lt; b" in page
    assert "data:image/png;base64,cG5n" in page
    assert page.count("<table>") == 1
