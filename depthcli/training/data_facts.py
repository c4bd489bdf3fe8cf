"""What the data of a run state before its first step; without Fabric, which loads for seconds."""

from depthcli.datasets.base import DepthDataset
from depthcli.datasets.fingerprint import data_fingerprint
from depthcli.datasets.splits import held_out_scenes
from depthcli.datasets.training_data import TrainingData
from depthcli.training.checkpoint import RunProgress
from depthcli.training.config.schema import DataConfig, TrainConfig
from depthcli.training.seen_pairs import extra_pairs


def data_facts(config: TrainConfig, data: TrainingData) -> RunProgress:
    """What the data give of a run's progress, before its first step."""
    dataset = data.dataset
    train_rows, held_out = train_val_split(dataset, config.data)
    return RunProgress(
        train_ids=tuple(dataset.ids[i] for i in train_rows),
        held_out_ids=tuple(dataset.ids[i] for i in held_out),
        data=data.title,
        hfov_deg=data.hfov_deg,
        extra=data.extra_title,
        extra_pairs=extra_pairs(data),
        aspect=data.aspect,
        fingerprints=tuple(data_fingerprint(part) for part in (dataset, data.extra) if part),
    )


def train_val_split(dataset: DepthDataset, data: DataConfig) -> tuple[list[int], list[int]]:
    """Positions of the training pairs and of the held-out ones; scenes are not split."""
    if not data.holdout_every:
        return list(range(len(dataset))), []
    held_out = held_out_scenes(dataset.scenes, data.holdout_every, data.holdout_offset)
    inside = [scene in held_out for scene in dataset.scenes]
    train_rows = [i for i, held in enumerate(inside) if not held]
    return train_rows, [i for i, held in enumerate(inside) if held]
