"""Runs of two steps over tiny rooms, from given weights or beside extra pairs."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from lightning_fabric import Fabric
from rooms import EFFICIENT, room_data, write_rooms

from depthcli.datasets.paired_folder import open_paired_folder
from depthcli.training.callbacks import Callback
from depthcli.training.config.schema import LossConfig
from depthcli.training.loop import Limits, fit

if TYPE_CHECKING:
    from pathlib import Path

    from depthcli.training.checkpoint import RunProgress
    from depthcli.training.config.schema import TrainConfig

SUPERVISED = replace(
    EFFICIENT,
    loss=LossConfig(0, 0, 0, 0, 0, 1, 0, 0),
    output=replace(EFFICIENT.output, coding="log"),
    optim=replace(EFFICIENT.optim, batch_size=4),
)
"""L1 alone."""

BARE = replace(SUPERVISED, generator=replace(SUPERVISED.generator, norm="none"))
"""L1 alone, without batch norm."""


def train_two_steps(
    config: TrainConfig,
    folder: Path,
    start: Path | None = None,
    extra: Path | None = None,
    title: str = "rooms",
) -> RunProgress:
    """Two more steps of the run in a folder."""
    data = room_data()._replace(title=title)
    if extra is not None:
        data = data._replace(extra=open_paired_folder(extra))
    fabric = Fabric(accelerator="cpu", devices=1)
    return fit(
        config, data, folder, fabric, Callback(), Limits(steps=2), start=[start] if start else ()
    )


def write_extra(folder: Path, prefix: str = "photo-") -> Path:
    """A folder of extra pairs, the six rooms under names that begin so."""
    write_rooms(folder)
    (folder / "index.csv").unlink()
    for file in [*folder.glob("*/*.png")]:
        file.rename(file.with_name(prefix + file.name))
    return folder
