"""Held-out pairs: their scores, by the protocol of the evaluation, and what is drawn of them."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import torch
import torch.nn.functional as F  # noqa: N812
from helpers.rooms import EFFICIENT, PAPER, Rooms, rooms
from lightning_fabric import Fabric

from depthcli.core.types import DepthMap
from depthcli.io.formats.preview import percentiles
from depthcli.metrics.depth import PixelSums
from depthcli.metrics.pixels import DepthPixels
from depthcli.training.callbacks import Validation, sample_path, write_samples
from depthcli.training.config import OutputConfig
from depthcli.training.networks.build import build_generator

CPU = torch.device("cpu")


def _many(count: int) -> Rooms:
    """The rooms again and again, ever nearer, with a large hole in each."""
    six = rooms()
    which = np.arange(count) % len(six)
    depths_m = six.depths_m[which] * np.linspace(1, 0.5, count, dtype=np.float32)[:, None, None]
    depths_m[:, 5:17, 9:30] = 0
    return Rooms(six.images[which], depths_m, tuple(f"den_{i}" for i in range(count)))


def _generator(config: Any) -> Any:
    torch.manual_seed(0)
    generator = build_generator(config.generator)
    for weight in generator.get_submodule("head").parameters():
        torch.nn.init.normal_(weight, std=0.1)
    return generator


@pytest.mark.parametrize("config", [PAPER, EFFICIENT], ids=["resnet", "efficient"])
def test_scores_are_means_over_the_pairs_at_the_truths_size(config: Any) -> None:
    dataset, generator = _many(19), _generator(config)
    positions = list(range(18, 0, -1))
    validation = Validation(dataset, positions, config)
    found = validation.score(generator.train(), CPU)
    assert generator.training  # as it was
    each = []
    for row, position in enumerate(positions):
        with torch.no_grad():
            raw = generator.eval()(validation.inputs([row]))
        depth_m = torch.from_numpy(config.output.codec.decode(raw.numpy()))
        grown_m = F.interpolate(depth_m, (48, 64), mode="bilinear", align_corners=False)[0, 0]
        pixels = DepthPixels.of(dataset.depth_m(position), grown_m.numpy())
        each.append(dict(PixelSums.of(pixels).scores().items()))
    for name, value in found.items():
        wanted = np.mean([scores[name] for scores in each])
        assert value == pytest.approx(wanted, rel=1e-4), name
    assert len(validation) == 18
    again = validation.score(generator, CPU)
    assert not generator.training
    assert dict(again.items()) == pytest.approx(dict(found.items()))


def test_depth_counts_to_ten_metres_or_as_far_as_the_output_goes() -> None:
    far = replace(rooms(), depths_m=rooms().depths_m * 2.2)  # about 9 m
    found = {}
    for max_m in (5.0, 10.0, 20.0):
        config = replace(EFFICIENT, output=OutputConfig("log", 0.4, max_m))
        validation = Validation(far, [0, 1], config)
        raw = torch.full((1, 1, 16, 32), 1.0)  # as far as it goes
        found[max_m] = validation.score(_Constant(raw), CPU)["rmse"]
    kept = [d[d < 10] for d in far.depths_m[:2]]
    for max_m in (5.0, 10.0):
        wanted = np.mean([np.sqrt(np.mean((d - max_m) ** 2)) for d in kept])
        assert found[max_m] == pytest.approx(wanted, rel=1e-4)
    wanted = np.mean([np.sqrt(np.mean((d - 20.0) ** 2)) for d in far.depths_m[:2]])
    assert found[20.0] == pytest.approx(wanted, rel=1e-4)


@dataclass(frozen=True)
class _Scaled(Rooms):
    """Rooms whose depth is that of another camera."""

    scales: tuple[float, ...] = ()


@pytest.mark.parametrize("positions", [[0, 1], [4, 1]])
def test_depth_of_other_cameras_is_compared_in_true_metres(positions: list[int]) -> None:
    """Also its limit of 10 m: half of the second picture is 12 m away, and learned as 6 m."""
    true = rooms()
    true.depths_m[1, :, 32:] = 12
    scales = (2.0, 0.5, 1.0, 1.0, 0.25, 1.0)
    factors = np.array(scales, np.float32)[:, None, None]
    dataset = _Scaled(true.images, true.depths_m * factors, scales=scales)
    network = _Constant(torch.zeros(1, 1, 16, 32))
    learned_m = float(EFFICIENT.output.codec.decode(0.0))
    rmse = []
    for i in positions:
        truth_m = true.depths_m[i][true.depths_m[i] < 10]
        rmse.append(np.sqrt(np.mean((truth_m - learned_m / scales[i]) ** 2)))
    scores = Validation(dataset, positions, EFFICIENT).score(network, CPU)
    assert scores["rmse"] == pytest.approx(np.mean(rmse), rel=1e-4)


class _Constant(torch.nn.Module):
    """Says the same of every picture."""

    def __init__(self, raw: torch.Tensor) -> None:
        super().__init__()
        self.raw = raw

    def forward(self, gray: torch.Tensor) -> torch.Tensor:
        return self.raw.expand(len(gray), -1, -1, -1)


def _shades(depth_m: np.ndarray, ends_m: tuple[float, float]) -> np.ndarray:
    """Inverse depth between two depths as colours, by a plain loop."""
    near_m, far_m = ends_m
    shares = np.zeros(depth_m.shape, np.uint8)
    for place, value_m in np.ndenumerate(depth_m):
        share = (1 / value_m - 1 / far_m) / (1 / near_m - 1 / far_m)
        shares[place] = round(255 * min(max(share, 0), 1))
    return np.asarray(cv2.applyColorMap(shares, cv2.COLORMAP_INFERNO))


@pytest.mark.parametrize(("count", "rows"), [(1, [0]), (3, [0, 1, 2]), (11, [0, 2, 4, 6, 8, 10])])
def test_samples_are_input_output_and_truth_of_six_pairs(
    tmp_path: Path, count: int, rows: list[int]
) -> None:
    """Over the whole list, in the colours of the truth's range, gray where it was not measured."""
    dataset, generator = _many(count), _generator(EFFICIENT)
    validation = Validation(dataset, range(count), EFFICIENT)
    fabric = Fabric(accelerator="cpu", devices=1)
    write_samples(tmp_path, 7, validation, generator, fabric)
    assert [p.name for p in tmp_path.rglob("*.jpg")] == ["epoch-0007.jpg"]
    lines = []
    for row in rows:
        gray = (validation.inputs([row])[0, 0].numpy() + 1) * 127.5
        truth_m = cv2.resize(validation.store.depth_m[row, 0].float().numpy(), (64, 32))
        assert validation.store.valid_mask is not None
        valid_mask = validation.store.valid_mask[row][None].float()
        measured = F.interpolate(valid_mask, (32, 64), mode="bilinear")[0, 0].numpy() >= 0.5
        ends_m = percentiles(DepthMap(truth_m[measured][None]))
        raw = validation.raw(generator, [row], CPU)[0, 0].numpy()
        output_m = cv2.resize(EFFICIENT.output.codec.decode(raw), (64, 32))
        truth, output = _shades(truth_m, ends_m), _shades(output_m, ends_m)
        truth[~measured] = 96
        lines.append(np.hstack([np.uint8(np.repeat(gray[..., None], 3, 2)), output, truth]))
    encoded = cv2.imencode(".jpg", np.vstack(lines))[1]
    wanted = np.asarray(cv2.imdecode(encoded, cv2.IMREAD_COLOR), float)
    found = cv2.imread(str(sample_path(tmp_path, 7)))
    assert found.shape == wanted.shape == (32 * len(rows), 3 * 64, 3)
    assert np.abs(found - wanted).mean() < 0.5
