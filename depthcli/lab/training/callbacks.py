"""The interface of callbacks, and what each run does: metrics log, validation, sample images."""

import json
import math
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import torch
import torch.nn.functional as F  # noqa: N812
from lightning_fabric import Fabric
from torch import Tensor, nn

from depthcli.core.types import DepthMap
from depthcli.io.formats.preview import PreviewWriter, percentiles
from depthcli.io.storage.atomic import append_whole, atomic_path
from depthcli.lab.datasets.base import DepthDataset
from depthcli.lab.metrics import depth as metrics
from depthcli.lab.training.augment import Views
from depthcli.lab.training.config import TrainConfig
from depthcli.lab.training.data import PairStore, drawn_prompts, whole_images
from depthcli.lab.training.networks.prompted import coded_prompt
from depthcli.lab.training.provenance import TrainState

_BATCH_SIZE = 16  # of validation
_SAMPLES = 6


class Callback:
    """Called during training. The base class does nothing."""

    def on_train_start(self, warnings: tuple[str, ...]) -> None:
        """Called before the first step of a session with doubts about the run, one line each."""

    def on_step_end(self, state: TrainState, steps: int, losses: dict[str, float]) -> None:
        """Called after each step; ``steps`` is their total number."""

    def on_epoch_end(self, state: TrainState) -> None:
        """Called after each epoch, once it is validated and saved."""

    def close(self) -> None:
        """Called at the end, also of a run that fails."""


def append_log(path: Path, state: TrainState, losses: dict[str, float]) -> None:
    """Add the line of an epoch to a run's metrics log, one JSON object per epoch."""
    line = {
        "epoch": state.epoch,
        "step": state.step,
        "seconds": round(state.seconds, 1),
        "losses": losses,
        "scores": metrics.finite_or_none(state.scores),
    }
    with path.open("ab", buffering=0) as file:
        append_whole(file, json.dumps(line).encode() + b"\n")


def truncate_log(path: Path, step: int) -> None:
    """Remove lines after a step, which the resumed run writes again, and an incomplete line."""
    content = path.read_bytes() if path.exists() else b""
    lines = b"".join(line + b"\n" for line in content.splitlines() if _step(line) <= step)
    if lines != content:
        with atomic_path(path) as temporary:
            temporary.write_bytes(lines)


def _step(line: bytes) -> float:
    try:
        return float(json.loads(line)["step"])
    except (ValueError, TypeError, KeyError):
        return math.inf


class Validation:
    """Scores a generator on held-out pairs; ground truth is read at full size."""

    def __init__(
        self, dataset: DepthDataset, positions: Sequence[int], config: TrainConfig
    ) -> None:
        self.dataset, self.positions, self.config = dataset, tuple(positions), config
        self.store = PairStore(dataset, positions, config.data)
        #: factor by which the depth of each pair was multiplied for the network's camera
        self.scales = [dataset.pairs[i].scale for i in positions]

    def __len__(self) -> int:
        return len(self.positions)

    def inputs(self, rows: Sequence[int]) -> Tensor:
        """Network inputs (B, 1, H, W) in [-1, 1] of some of the pairs."""
        return whole_images(self.store, self.config.data, torch.tensor(list(rows)))

    def _prompts(self, rows: Sequence[int]) -> tuple[Tensor, ...]:
        """Known depth and its mask as training draws them, the same in every epoch; or none."""
        config, size = self.config, (self.config.data.height, self.config.data.width)
        prompts, mask = [], self.store.valid_mask
        for row in rows if config.generator.prompt else ():
            depth_m = F.interpolate(self.store.depth_m[[row]].float(), size, mode="nearest")
            if mask is not None:
                depth_m *= F.interpolate(mask[[row]].float(), size, mode="nearest")
            views = Views(self.inputs([row]), depth_m, None)
            prompts.append(drawn_prompts(views, config.prompt, np.random.SeedSequence(row)))
        return coded_prompt(torch.cat(prompts), config.output.codec) if prompts else ()

    @torch.no_grad()
    def raw(self, generator: nn.Module, rows: Sequence[int], device: torch.device) -> Tensor:
        """Raw outputs (B, 1, h, w) float32 on the CPU of some of the pairs."""
        was_training = generator.training
        generator.eval()
        inputs = [self.inputs(rows), *self._prompts(rows)]
        raw: Tensor = generator(*(tensor.to(device) for tensor in inputs)).float().cpu()
        generator.train(was_training)
        return raw

    def score(self, generator: nn.Module, device: torch.device) -> metrics.Scores:
        """Mean of every metric over the pairs, at the truth's size, to 10 m or ``output.max_m``.

        By the headline protocol of the evaluation, in true metres also of other cameras.
        """
        sums, codec = list[metrics.PixelSums](), self.config.output.codec
        farthest_m = max(metrics.MAX_DEPTH_M, self.config.output.max_m)
        for start in range(0, len(self), _BATCH_SIZE):
            rows = range(start, min(start + _BATCH_SIZE, len(self)))
            for row, raw in zip(rows, self.raw(generator, rows, device), strict=True):
                scale = self.scales[row]
                truth_m = self.dataset.depth_m(self.positions[row]) / scale
                depth_m = torch.from_numpy(codec.decode(raw.numpy()))
                grown_m = F.interpolate(depth_m[None], truth_m.shape, mode="bilinear")
                predicted_m = grown_m[0, 0].numpy() / scale
                pixels = metrics.DepthPixels.of(truth_m, predicted_m, max_m=farthest_m)
                sums.append(metrics.PixelSums.of(pixels))
        return metrics.mean_scores(sums)


def write_samples(
    folder: Path, epoch: int, validation: Validation, generator: nn.Module, fabric: Fabric
) -> None:
    """Write ``samples/epoch-NNNN.jpg``: input, output and truth, in its range, of up to 6 pairs."""
    rows = np.linspace(0, len(validation) - 1, min(_SAMPLES, len(validation))).astype(int).tolist()
    inputs = validation.inputs(rows).expand(-1, 3, -1, -1).permute(0, 2, 3, 1).numpy()
    images = ((inputs + 1) * 127.5).astype(np.uint8)
    raw = validation.raw(generator, rows, fabric.device).numpy()[:, 0]
    codec = validation.config.output.codec
    lines, size = [], (images.shape[2], images.shape[1])
    for image, output, row in zip(images, raw, rows, strict=True):
        depth_m = validation.dataset.depth_m(validation.positions[row])
        truth_m = np.array(cv2.resize(depth_m, size, interpolation=cv2.INTER_NEAREST), np.float32)
        truth_m[truth_m == 0] = np.nan
        output_m = np.array(cv2.resize(codec.decode(output), size), np.float32)
        render = partial(PreviewWriter().render, spread=percentiles(DepthMap(truth_m)))
        lines.append(np.hstack([image, *map(render, map(DepthMap, (output_m, truth_m)))]))
    encoded = cv2.imencode(".jpg", np.vstack(lines)[..., ::-1])[1]
    with atomic_path(sample_path(folder, epoch)) as temporary:
        temporary.write_bytes(encoded.tobytes())


def sample_path(folder: Path, epoch: int) -> Path:
    """The file with the sample images of an epoch."""
    return folder / "samples" / f"epoch-{epoch:04d}.jpg"
