"""The models that ship: their cards are true, and they say what they said when released."""

import hashlib
import json
import platform
import re
from dataclasses import replace
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import onnx
import pytest

import depthcli
from depthcli.core.camera import Anchor
from depthcli.core.types import Frame
from depthcli.known.points import KnownDepth
from depthcli.lab.datasets import base as id_ranges
from depthcli.lab.evaluation.report import mean_of_images
from depthcli.lab.evaluation.saved import read_report
from depthcli.lab.metrics.boundary import boundary_scores
from depthcli.models.card import ModelCard

ROOT = Path(__file__).parents[1]
REFERENCE = Path(__file__).parent / "reference"
MODELS = ("default", "fast", "float", "prompted", "sharp")
REFERENCES = {
    ("default", "bilinear"): REFERENCE / "default-room.npy",
    ("default", "guided"): REFERENCE / "default-room-guided.npy",
    ("fast", "bilinear"): REFERENCE / "fast-room.npy",
    ("float", "bilinear"): REFERENCE / "float-room.npy",
    ("prompted", "bilinear"): REFERENCE / "prompted-room.npy",
    ("sharp", "bilinear"): REFERENCE / "sharp-room.npy",
}
LOSSY_M = {
    "default": 0.11,
    "fast": 0.1,
    "float": 0.02,
    "prompted": 0.1,
    "sharp": 0.15,
}  # int8 sums are rounded elsewhere on other processors, and by onnxruntime before 1.27


@pytest.fixture(scope="module", params=MODELS)
def model(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@cache
def _true_m() -> np.ndarray:
    """The exact depth of docs/room.jpg, which was rendered: (480, 640) metres."""
    return depthcli.read_depth(REFERENCE / "room-depth.png", png_scale=1000).values


@cache
def _depth(model: str, **detail: Any) -> depthcli.DepthMap:
    pipeline = depthcli.load_model(
        ROOT / "models" / model, provider="cpu", detail=depthcli.UpsamplingOptions(**detail)
    ).pipeline
    image = depthcli.read_image(ROOT / "docs" / "room.jpg")
    return pipeline.predict(image, anchors=_points(model, _true_m())).depth


def _points(model: str, depth_m: np.ndarray) -> KnownDepth | None:
    """48 pixels of (480, 640) metres, for the network that takes known depth."""
    if model != "prompted":
        return None
    y, x = (axis.ravel() for axis in np.mgrid[40:480:80, 40:640:80])
    return KnownDepth(x, y, depth_m[y, x].astype(np.float64))


@pytest.mark.parametrize(("model", "upsampling"), sorted(REFERENCES))
def test_reproduces_its_stored_output(model: str, upsampling: str) -> None:
    seen_m = _depth(model, upsampling=upsampling).values[::8, ::8]
    assert np.abs(seen_m - np.load(REFERENCES[model, upsampling])).max() < LOSSY_M[model]


def test_the_expected_error_is_that_of_its_release_and_changes_no_depth() -> None:
    unsure = _depth("default", error=True)
    assert np.abs(unsure.error[::8, ::8] - np.load(REFERENCE / "error-room.npy")).max() < 0.03
    assert 0.05 < unsure.error.min() < unsure.error.max() < 0.5
    np.testing.assert_array_equal(unsure.values, _depth("default").values)


def test_sharp_has_the_metres_of_default_and_finer_edges() -> None:
    plain, sharp = (_depth(model) for model in ("default", "sharp"))
    true_m, everywhere = _true_m(), np.ones((480, 640), np.bool_)
    scores = [boundary_scores(true_m, depth.values, everywhere) for depth in (plain, sharp)]
    assert scores[1].dbe_comp < 0.95 * scores[0].dbe_comp  # px
    assert np.median(sharp.values) == pytest.approx(np.median(plain.values), rel=0.05)


@pytest.mark.parametrize("path", sorted((ROOT / "docs" / "results").glob("val-*.json")), ids=str)
def test_shipped_reports_have_the_scores_of_each_image(path: Path) -> None:
    """A reader compares new ones with them: docs/evaluation.md."""
    report = read_report(path)
    assert report.image_count == 134
    for row in report.rows:
        assert len(row.images) == 134
        assert mean_of_images(row.images) == pytest.approx(row.scores, abs=2e-6)


def _platform() -> str:
    """What floating-point sums are rounded by: processor, instructions and libraries."""
    info = Path("/proc/cpuinfo")
    words = set(info.read_text().split()) if info.is_file() else set()
    flags = words & {"GenuineIntel", "AuthenticAMD", "avx2", "avx512f", "avx512_vnni", "amx_int8"}
    libraries = [f"{name} {version(name)}" for name in ("onnxruntime", "numpy")]
    return ", ".join([platform.machine(), *sorted(flags), *libraries, f"OpenCV {cv2.__version__}"])


def test_gives_the_bytes_that_it_gave_on_the_same_platform(model: str) -> None:
    hashes = json.loads((REFERENCE / "hashes.json").read_text()).get(_platform())
    if hashes is None or model not in hashes:
        pytest.skip(f"no hashes were recorded on {_platform()}")
    pixels = np.random.default_rng(0).integers(0, 256, (240, 320, 3), np.uint8)  # decoders differ
    pipeline = depthcli.load_model(ROOT / "models" / model, provider="cpu").pipeline
    points = _points(model, np.linspace((1,) * 640, (3,) * 640, 480))
    points = points and replace(points, x=points.x // 2, y=points.y // 2)
    values_m = pipeline.predict(Frame(pixels), anchors=points).depth.values
    assert hashlib.sha256(values_m.tobytes()).hexdigest() == hashes[model]


def test_upsampling_is_guided_by_default() -> None:
    seen_m = _depth("default").values[::8, ::8]
    assert np.abs(seen_m - np.load(REFERENCES["default", "guided"])).max() < LOSSY_M["default"]
    assert np.abs(seen_m - np.load(REFERENCES["default", "bilinear"])).max() > 0.1


def test_the_float_model_is_the_default_one_in_more_bits() -> None:
    plain = MODELS[:3]
    default_m, fast_m, float_m = (_depth(model, upsampling="bilinear").values for model in plain)
    assert 0 < np.abs(default_m - float_m).mean() < 0.04 * float_m.mean()
    assert np.abs(fast_m - float_m).mean() < 0.1 * float_m.mean()  # another training
    sizes = [(ROOT / "models" / model / "model.onnx").stat().st_size for model in plain]
    assert max(sizes[:2]) < 0.6 * sizes[2]
    for model in MODELS[:2]:  # on GPUs the float one takes the place of the int8 ones
        card = ModelCard.from_json((ROOT / "models" / model / "card.json").read_bytes())
        assert card.float_model == "float"


def test_sees_the_rendered_room(model: str) -> None:
    """It is no photograph, and larger than most rooms of the training set."""
    depth, true_m = _depth(model), _true_m()
    assert depth.values.shape == true_m.shape == (480, 640)
    scale = np.median(depth.values / true_m)
    assert 0.5 < scale < 1.2
    ratio = depth.values / scale / true_m
    assert (np.maximum(ratio, 1 / ratio) < 1.25).mean() > 0.7
    floor, far_wall = depth.values[440:, 250:400].mean(), depth.values[230:300, 330:430].mean()
    assert floor < 0.8 * far_wall


def test_readme_states_how_far_its_room_is_off() -> None:
    text = " ".join((ROOT / "README.md").read_text().split())
    match = re.search(
        r"true median depth is ([\d.]+) m: the model estimates ([\d.]+) m, and ([\d.]+) m with two "
        r"known distances \(`--anchor (\S+) --anchor (\S+)`\)",
        text,
    )
    assert match
    depth, true_m = _depth("default"), _true_m()
    words = [match[i].split(",") for i in (4, 5)]
    points = [Anchor(int(x), int(y), float(depth_m)) for x, y, depth_m in words]
    fitted = depthcli.load_model(provider="cpu").predict(ROOT / "docs/room.jpg", anchors=points)
    assert fitted.model == "prompted"  # as of the command
    found_m = [np.median(true_m), np.median(depth.values), np.median(fitted.values)]
    assert found_m == pytest.approx([float(match[i]) for i in (1, 2, 3)], abs=0.03)
    for point in points:
        assert true_m[point.y, point.x] == pytest.approx(point.depth_m, abs=0.01)


def test_card_is_true(model: str) -> None:
    folder = ROOT / "models" / model
    card = ModelCard.from_json((folder / "card.json").read_bytes())
    data = (folder / "model.onnx").read_bytes()
    assert card.sha256 == hashlib.sha256(data).hexdigest()
    assert card.size_bytes == len(data) <= 25_000_000
    numbers = id_ranges.parse(card.training["nyu_train_ids"])
    assert len(numbers) == card.training["pairs"]
    assert max(numbers) < 1000
    assert {"data", "method", "steps", "seed"} <= card.training.keys()
    assert {"protocol", "split", "abs_rel", "rmse", "d1"} <= card.scores.keys()


def test_graph_is_folded_and_loads_in_old_runtimes(model: str) -> None:
    graph = onnx.load(ROOT / "models" / model / "model.onnx")
    assert "BatchNormalization" not in {node.op_type for node in graph.graph.node}
    assert graph.ir_version <= 8
    assert all(entry.version <= 17 for entry in graph.opset_import if not entry.domain)


def test_takes_any_size_and_batch(model: str) -> None:
    session = depthcli.load_model(ROOT / "models" / model, provider="cpu").pipeline.session
    for shape in ((3, 1, 144, 192), (1, 1, 192, 144), (1, 1, 288, 384)):
        assert session.run(np.zeros(shape, np.float32)).shape[0] == shape[0]


def test_generators_of_the_comparison_are_those_of_their_cards() -> None:
    for folder in (ROOT / "docs" / "results" / "generators").iterdir():
        data = (folder / "model.onnx").read_bytes()
        assert len(data) <= 2_000_000
        card = ModelCard.from_json((folder / "card.json").read_bytes())
        assert hashlib.sha256(data).hexdigest() == card.sha256
