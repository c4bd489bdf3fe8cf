"""Callbacks and loggers of training."""

import json
import math
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import torch
import torch.nn.functional as F  # noqa: N812
from helpers.rooms import EFFICIENT, PAPER, Rooms, rooms, write_rooms
from helpers.runs import inside, write_run
from lightning_fabric import Fabric

from depthcli.core.types import DepthMap
from depthcli.io.formats.preview import percentiles
from depthcli.lab.jobs.train import TrainRequest, train
from depthcli.lab.metrics.depth import DepthPixels, PixelSums
from depthcli.lab.options import Tracker
from depthcli.lab.training.callbacks import (
    Callback,
    Validation,
    append_log,
    sample_path,
    truncate_log,
    write_samples,
)
from depthcli.lab.training.checkpoint import METRICS_LOG
from depthcli.lab.training.networks.build import build_generator
from depthcli.lab.training.provenance import TrainState


def _steps(path: Path) -> list[int]:
    return [json.loads(line)["step"] for line in path.read_text().splitlines()]


def test_a_line_has_the_losses_and_scores_of_its_epoch(tmp_path: Path) -> None:
    path, scores = tmp_path / METRICS_LOG, {"rmse": 0.5, "d1": math.nan}
    append_log(path, TrainState(4, 2, 12.3456, scores), {"l1": 0.25})
    assert path.read_bytes().endswith(b"}\n")
    assert json.loads(path.read_bytes()) == {
        "epoch": 2,
        "step": 4,
        "seconds": 12.3,
        "losses": {"l1": 0.25},
        "scores": {"rmse": 0.5, "d1": None},
    }
    path.write_bytes(b'[4]\n{"epoch": 1}\n' + path.read_bytes())
    truncate_log(path, 4)
    assert _steps(path) == [4]


@pytest.mark.parametrize("share", [0, 0.01, 0.5, 0.99, 1])
def test_torn_line_is_dropped(tmp_path: Path, share: float) -> None:
    path = tmp_path / METRICS_LOG
    append_log(path, TrainState(step=2), {"l1": 0.5})
    whole = path.read_bytes()
    path.write_bytes(whole + whole[: int(share * (len(whole) - 1))])
    truncate_log(path, 2)
    append_log(path, TrainState(step=4), {"l1": 0.5})
    assert _steps(path)[0] == 2
    assert _steps(path)[-1] == 4


def _train(folder: Path, *more: str) -> subprocess.CompletedProcess[str]:
    words = ["train", "proposed", "--preset", "bundled", "--config", "tiny.toml"]
    words += ["--data", "data", "--out", "run", "--accelerator", "cpu", "--threads", "1"]
    words += ["--set", "optim.warmup_steps=2", "--set", "validate_every=1"]
    return inside(folder, *words, "--log", "tensorboard", *more)


def test_tensorboard_has_every_step_once_though_a_killed_run_repeats_some(tmp_path: Path) -> None:
    write_run(tmp_path)
    assert _train(tmp_path, "--max-minutes", "0").returncode == 0
    early = (tmp_path / "run" / "last.ckpt").read_bytes()
    for _ in range(2):
        (tmp_path / "run" / "last.ckpt").write_bytes(early)
        done = _train(tmp_path, "--json")
        assert done.returncode == 0, done.stderr
        assert len(done.stdout.splitlines()) == 2  # whoever else is told, is told as well
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator  # noqa: PLC0415

    events = EventAccumulator(str(tmp_path / "run" / "tensorboard")).Reload()
    assert set(events.Tags()["scalars"]) > {"loss/l1", "loss/gradient", "held_out/d1"}
    assert [e.step for e in events.Scalars("loss/l1")] == [1, 2, 3, 4]
    rates = [e.value for e in events.Scalars("learning_rate")]
    assert rates == pytest.approx([5e-4, 1e-3 * 0.853553, 5e-4, 1e-3 * 0.146447], rel=1e-4)
    assert len(list((tmp_path / "run" / "tensorboard").iterdir())) == 3  # one per session
    log = (tmp_path / "run" / "metrics.jsonl").read_text().splitlines()
    last = json.loads(log[-1])
    assert events.Scalars("loss/l1")[-1].value == pytest.approx(last["losses"]["l1"])
    assert events.Scalars("held_out/rmse")[-1].value == pytest.approx(last["scores"]["rmse"])
    grids = events.Images("samples")
    assert [(grid.step, grid.width, grid.height) for grid in grids] == [(2, 192, 48), (4, 192, 48)]


def test_without_the_package_one_line_says_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_run(tmp_path)
    monkeypatch.setitem(sys.modules, "torch.utils.tensorboard", None)
    done = _train(tmp_path, "--quiet")
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (3, "", 1)
    assert "'depthcli[tensorboard]'" in done.stderr
    assert not (tmp_path / "run").exists()


CPU = torch.device("cpu")


def _many(count: int) -> Rooms:
    """The rooms again and again, ever nearer, with a large hole in each."""
    six = rooms()
    indices = np.arange(count) % len(six)
    depths_m = six.depths_m[indices] * np.linspace(1, 0.5, count, dtype=np.float32)[:, None, None]
    depths_m[:, 5:17, 9:30] = 0
    return Rooms(six.images[indices], depths_m, tuple(f"den_{i}" for i in range(count)))


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
    means = validation.score(generator.train(), CPU)
    assert generator.training  # as it was
    each = []
    for row, position in enumerate(positions):
        with torch.no_grad():
            raw = generator.eval()(validation.inputs([row]))
        depth_m = torch.from_numpy(config.output.codec.decode(raw.numpy()))
        grown_m = F.interpolate(depth_m, (48, 64), mode="bilinear", align_corners=False)[0, 0]
        pixels = DepthPixels.of(dataset.depth_m(position), grown_m.numpy())
        each.append(dict(PixelSums.of(pixels).scores().items()))
    for name, value in means.items():
        expected = np.mean([scores[name] for scores in each])
        assert value == pytest.approx(expected, rel=1e-4), name
    assert len(validation) == 18
    again = validation.score(generator, CPU)
    assert not generator.training
    assert dict(again.items()) == pytest.approx(dict(means.items()))


@pytest.mark.parametrize("positions", [[0, 1], [4, 1]])
def test_depth_of_other_cameras_is_compared_in_true_metres(positions: list[int]) -> None:
    """Also its limit of 10 m: half of the second image is 12 m away, and learned as 6 m."""
    true = rooms()
    true.depths_m[1, :, 32:] = 12
    scales = (2.0, 0.5, 1.0, 1.0, 0.25, 1.0)
    factors = np.array(scales, np.float32)[:, None, None]
    dataset = replace(true, depths_m=true.depths_m * factors, scales=scales)
    network = _Constant(torch.zeros(1, 1, 16, 32))
    learned_m = float(EFFICIENT.output.codec.decode(0.0))
    rmse = []
    for i in positions:
        truth_m = true.depths_m[i][true.depths_m[i] < 10]
        rmse.append(np.sqrt(np.mean((truth_m - learned_m / scales[i]) ** 2)))
    scores = Validation(dataset, positions, EFFICIENT).score(network, CPU)
    assert scores["rmse"] == pytest.approx(np.mean(rmse), rel=1e-4)


class _Constant(torch.nn.Module):
    """Says the same of every image."""

    def __init__(self, raw: torch.Tensor) -> None:
        super().__init__()
        self.raw = raw

    def forward(self, gray: torch.Tensor) -> torch.Tensor:
        return self.raw.expand(len(gray), -1, -1, -1)


def _shades(depth_m: np.ndarray, ends_m: tuple[float, float]) -> np.ndarray:
    """Inverse depth between two depths as colours."""
    near, far = (1 / end_m for end_m in ends_m)
    shares = ((1 / depth_m - far) / (near - far)).clip(0, 1)
    return np.asarray(cv2.applyColorMap(np.uint8(np.rint(255 * shares)), cv2.COLORMAP_INFERNO))


@pytest.mark.parametrize(("count", "rows"), [(1, [0]), (3, [0, 1, 2]), (11, [0, 2, 4, 6, 8, 10])])
def test_samples_are_input_output_truth_of_six(tmp_path: Path, count: int, rows: list[int]) -> None:
    """Over the whole list, in the colours of the truth's range, gray where it was not measured."""
    dataset, generator = _many(count), _generator(EFFICIENT)
    validation = Validation(dataset, range(count), EFFICIENT)
    fabric = Fabric(accelerator="cpu", devices=1)
    write_samples(tmp_path, 7, validation, generator, fabric)
    assert [p.name for p in tmp_path.rglob("*.jpg")] == ["epoch-0007.jpg"]
    lines = []
    for row in rows:
        gray = (validation.inputs([row])[0, 0].numpy() + 1) * 127.5
        depth_m = torch.from_numpy(dataset.depth_m(row))[None, None]
        truth_m = F.interpolate(depth_m, (32, 64), mode="nearest")[0, 0].numpy()
        measured = truth_m > 0
        ends_m = percentiles(DepthMap(truth_m[measured][None]))
        raw = validation.raw(generator, [row], CPU)[0, 0].numpy()
        output_m = cv2.resize(EFFICIENT.output.codec.decode(raw), (64, 32))
        truth = np.where(measured[..., None], _shades(truth_m.clip(0.1), ends_m), np.uint8(96))
        output = _shades(output_m, ends_m)
        lines.append(np.hstack([np.uint8(np.repeat(gray[..., None], 3, 2)), output, truth]))
    encoded = cv2.imencode(".jpg", np.vstack(lines))[1]
    expected = np.asarray(cv2.imdecode(encoded, cv2.IMREAD_COLOR), float)
    image = cv2.imread(str(sample_path(tmp_path, 7)))
    assert image.shape == expected.shape == (32 * len(rows), 3 * 64, 3)
    assert np.abs(image - expected).mean() < 0.5


def _logged(folder: Path, tracker: Tracker) -> Path:
    """A run that is stopped once and resumed."""
    data, out = write_rooms(folder / "data"), folder / "run"
    for minutes in (0, 1):
        request = TrainRequest(
            EFFICIENT, data, out, minutes=minutes, accelerator="cpu", threads=1, trackers=(tracker,)
        )
        train(request, Callback())
    return out


def test_wandb_has_losses_scores_samples(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    wandb = pytest.importorskip("wandb")
    monkeypatch.setenv("WANDB_MODE", "offline")
    out = _logged(tmp_path, Tracker.WANDB)
    wandb.teardown()  # its process writes the files
    name = (out / "wandb.id").read_text().strip()
    first, second = sorted((out / "wandb").glob(f"offline-run-*-{name}"))
    assert (first / f"run-{name}.wandb").stat().st_size > 0
    content = (second / f"run-{name}.wandb").read_bytes()
    last = json.loads((out / "metrics.jsonl").read_text().splitlines()[-1])
    assert {"l1", "gradient"} == set(last["losses"])
    for part, values in (("loss", last["losses"]), ("held_out", last["scores"])):
        for key, value in values.items():  # numbers are stored as JSON
            assert f"{part}/{key}".encode() in content
            assert json.dumps(value).encode() in content
    samples = (path.name.split("_")[1] for path in second.glob("files/media/images/samples_*.jpg"))
    assert sorted(samples) == ["2", "4", "6"]


@pytest.mark.parametrize("store", ["database", "files"])
def test_mlflow_has_every_step_settings_scores_and_samples(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, store: str
) -> None:
    mlflow = pytest.importorskip("mlflow")
    where = f"sqlite:///{tmp_path / 'run' / 'mlflow.db'}"
    monkeypatch.delenv("MLFLOW_TRACKING_URI", raising=False)
    if store == "files":
        where = (tmp_path / "files").as_uri()
        monkeypatch.setenv("MLFLOW_TRACKING_URI", where)
        monkeypatch.setenv("MLFLOW_ALLOW_FILE_STORE", "true")
    out = _logged(tmp_path, Tracker.MLFLOW)
    client = mlflow.MlflowClient(where)
    run = client.get_run((out / "mlflow.id").read_text().strip())
    assert (run.info.run_name, run.info.status) == ("run", "FINISHED")
    assert run.data.params["loss.l1"] == str(EFFICIENT.loss.l1)
    history = client.get_metric_history(run.info.run_id, "loss/l1")
    assert [value.step for value in history] == [1, 2, 3, 4, 5, 6]
    last = json.loads((out / "metrics.jsonl").read_text().splitlines()[-1])
    assert run.data.metrics["held_out/rmse"] == pytest.approx(last["scores"]["rmse"])
    samples = client.list_artifacts(run.info.run_id, "samples")
    assert len(samples) == 3
