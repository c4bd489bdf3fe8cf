"""Ready cards against depth of the authors' code, of a small image and a network of few weights.

``benchmarks/verify_cards.py --write`` makes the files: the authors' packages are not needed here.
"""

import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from depthcli.core.camera import CameraSource, Intrinsics
from depthcli.core.options import DepthMask, Upsampling, UpsamplingOptions
from depthcli.core.types import Frame
from depthcli.inference.pipeline import Pipeline
from depthcli.inference.session import Session
from depthcli.inference.transforms import coarse_depth, metric_scale, prepare, prompt_input
from depthcli.known.points import KnownDepth
from depthcli.models.card import ModelCard
from depthcli.models.catalog import Model, ready_fields, ready_names

KEPT = Path(__file__).parents[1] / "reference" / "cards"
NAMES = sorted(path.stem for path in KEPT.glob("*.npz"))
STEP = 24  # of the pixels that are kept at the network's size
MOST = 1e-3  # mean difference by standard deviation, as in the benchmark


def opened(name: str) -> tuple[Session, Frame, Mapping[str, npt.NDArray[np.float32]]]:
    arrays = np.load(KEPT / f"{name}.npz")
    fields = ready_fields(name)
    if "known" in arrays:
        rows, columns = arrays["known"].shape
        fields["input"]["known_depth"] |= {"width": columns, "height": rows}
    fields |= {"onnx": {"opset": 18, "ir": 8} | fields.get("onnx", {})}
    card = ModelCard.from_json(json.dumps(fields))
    data = arrays["onnx"].tobytes()
    path = Path(f"{name}.onnx")
    model = Model(path=path, card=card, sha256="", size_bytes=len(data), data=data)
    return Session(model, provider="cpu"), Frame(arrays["picture"]), arrays


def known_points(arrays: Mapping[str, npt.NDArray[np.float32]], frame: Frame) -> KnownDepth | None:
    """Points at the centres of the pixels of known depth, a map of the whole image."""
    if "known" not in arrays:
        return None
    depth_m = arrays["known"]
    (y, x), (rows, columns) = np.indices(depth_m.shape), depth_m.shape
    at = (x + 0.5) * frame.width / columns - 0.5, (y + 0.5) * frame.height / rows - 0.5
    return KnownDepth.of_table(np.stack([*at, depth_m], axis=-1).reshape(-1, 3))


def assert_same(ours: npt.NDArray[np.float32], theirs: npt.NDArray[np.float32]) -> None:
    has = np.isfinite(theirs)
    assert ours.shape == theirs.shape
    assert has.any()
    assert np.abs(ours[has] - theirs[has]).mean() <= MOST * theirs[has].std()


@pytest.mark.parametrize("name", NAMES)
def test_output_at_the_size_of_the_network_is_that_of_the_authors(name: str) -> None:
    session, frame, arrays = opened(name)
    batch, layout = prepare(session.model.card.input, frame)
    assert batch.shape[2:] == tuple(arrays["size"])
    points = known_points(arrays, frame)
    card = session.model.card
    prompts = None if points is None else [prompt_input(card, points, frame, layout)]
    ours = session.run(batch, prompts)[0]
    z = ours[..., 2] if ours.ndim > arrays["raw"].ndim else ours
    assert_same(z[::STEP, ::STEP], arrays["raw"].reshape(arrays["raw"].shape[-2:]))
    if "metres" in arrays:
        camera = Intrinsics(float(arrays["focal_px"]))
        scale = metric_scale(session.model.card, frame, layout, camera)
        metres = coarse_depth(session.model.card.output, ours, layout) * scale
        assert_same(metres[::STEP, ::STEP], arrays["metres"])


@pytest.mark.parametrize(
    "name", [name for name in NAMES if "full" in np.load(KEPT / f"{name}.npz")]
)
def test_depth_of_an_image_is_that_of_the_authors(name: str) -> None:
    session, frame, arrays = opened(name)
    focal_px = float(arrays["focal_px"]) if "focal_px" in arrays else None
    mask = DepthMask.MODEL if "has" in arrays else DepthMask.NONE
    pipeline = Pipeline(session, UpsamplingOptions(Upsampling.MODEL, mask=mask))
    depth = pipeline.predict(frame, Intrinsics(focal_px), known_points(arrays, frame)).depth
    everywhere = np.ones(depth.values.shape, bool)
    has = next((arrays[name] for name in ("has", "at") if name in arrays), everywhere)
    assert_same(np.where(has, depth.values, np.nan), np.where(has, arrays["full"], np.nan))
    if "has" in arrays:
        assert np.mean(np.isfinite(depth.values) != has) < 0.02
    if "hfov_deg" in arrays:
        assert depth.provenance.camera_source is CameraSource.MODEL


def test_cards_without_a_comparison_say_why() -> None:
    cards = {name: ready_fields(name).get("verification", {}) for name in ready_names()}
    compared = {name for name, check in cards.items() if "difference" in check}
    assert all(check.get("why_none") for name, check in cards.items() if name not in compared)
    assert len(compared) >= 12
