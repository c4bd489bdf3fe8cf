"""Runs of a few steps over tiny rooms, from given weights or beside pseudo labels."""

from dataclasses import replace
from pathlib import Path

from lightning_fabric import Fabric

from depthcli.lab.datasets.folders import open_paired_folder
from depthcli.lab.training.callbacks import Callback
from depthcli.lab.training.config import LossConfig, TrainConfig
from depthcli.lab.training.provenance import TrainState
from depthcli.lab.training.run import fit
from helpers.rooms import EFFICIENT, room_data, write_rooms

SUPERVISED = replace(
    EFFICIENT,
    loss=LossConfig(0, 0, 0, 0, 0, 1, 0, 0),
    output=replace(EFFICIENT.output, coding="log"),
    optim=replace(EFFICIENT.optim, batch_size=4),
)
"""L1 alone."""

BARE = replace(SUPERVISED, generator=replace(SUPERVISED.generator, norm="none"))
"""L1 alone, without batch norm."""


def train_steps(
    config: TrainConfig,
    folder: Path,
    init_weights: Path | None = None,
    pseudo_labels: Path | None = None,
    title: str = "rooms",
    steps: int = 2,
) -> TrainState:
    """Some more steps of the run in a folder."""
    data = room_data()._replace(title=title)
    if pseudo_labels is not None:
        data = data._replace(pseudo_labels=open_paired_folder(pseudo_labels))
    fabric = Fabric(accelerator="cpu", devices=1)
    sources = [init_weights] if init_weights else ()
    return fit(config, data, folder, fabric, Callback(), max_steps=steps, init_weights=sources)


def write_pseudo_labels(folder: Path, prefix: str = "photo-") -> Path:
    """A folder of pseudo labels, the six rooms under names that begin so."""
    write_rooms(folder, prefix=prefix)
    (folder / "index.csv").unlink()
    return folder
