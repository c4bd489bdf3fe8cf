"""Runs of Weights & Biases, offline, and of MLflow, in files; TensorBoard is in test_callbacks."""

import json
from pathlib import Path

import pytest
from helpers.rooms import EFFICIENT, write_rooms

from depthcli.core.options import Tracker
from depthcli.jobs.train import TrainRequest, train
from depthcli.training.callbacks import Callback


def _train(folder: Path, tracker: Tracker) -> Path:
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
    out = _train(tmp_path, Tracker.WANDB)
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
    out = _train(tmp_path, Tracker.MLFLOW)
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
