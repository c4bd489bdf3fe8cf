"""Networks whose low frequencies come from another network."""

from pathlib import Path

import numpy as np
import pytest
import torch
from helpers.small import RESNET, small_network, write_checkpoint
from torch import nn

from depthcli.datasets.training_data import NYU_PAPER
from depthcli.errors import UsageError
from depthcli.export.onnx import ExportOptions, export_checkpoint
from depthcli.inference.session import Session
from depthcli.models.catalog import find_model
from depthcli.training.networks.two_scale import TwoScaleGenerator


class _Fixed(nn.Module):
    def __init__(self, raw: torch.Tensor) -> None:
        super().__init__()
        self.raw = raw

    def forward(self, _: torch.Tensor) -> torch.Tensor:
        return self.raw


def test_mean_over_a_window_is_that_of_the_coarse_map() -> None:
    random = torch.Generator().manual_seed(0)
    fine, coarse = (torch.rand(2, 1, *size, generator=random) for size in ((24, 40), (12, 20)))
    seen = TwoScaleGenerator(_Fixed(fine), _Fixed(coarse))(torch.zeros(2, 1, 48, 80))
    for picture in range(2):
        pooled = fine[picture, 0].reshape(12, 2, 20, 2).mean((1, 3))
        difference = coarse[picture, 0] - pooled
        mean = torch.stack(
            [
                difference[max(0, y - 8) : y + 9, max(0, x - 8) : x + 9].mean()
                for y in range(12)
                for x in range(20)
            ]
        ).reshape(1, 1, 12, 20)
        wanted = fine[picture, 0] + nn.functional.interpolate(mean, (24, 40), mode="bilinear")[0, 0]
        torch.testing.assert_close(seen[picture, 0], wanted)


def test_an_export_runs_both_and_states_both(tmp_path: Path) -> None:
    networks = [small_network(seed=seed) for seed in (1, 2)]
    ids = [{"data": NYU_PAPER, "train_ids": (number,)} for number in ("0003", "0004")]
    fine, coarse = (
        write_checkpoint(tmp_path / f"{i}.ckpt", networks[i], **ids[i]) for i in range(2)
    )
    done = export_checkpoint(fine, tmp_path / "m.onnx", ExportOptions(coarse=coarse))
    image = np.random.default_rng(0).uniform(-1, 1, (2, 1, 36, 48)).astype(np.float32)
    with torch.no_grad():
        wanted = TwoScaleGenerator(*networks)(torch.from_numpy(image))[:, 0].numpy()
    found = Session(find_model(done.path), provider="cpu").run(image)
    np.testing.assert_allclose(found, wanted, atol=1e-3)
    training = done.card.training
    assert (training["coarse"], training["validation"]) == (f"{NYU_PAPER}, 12 steps", {})
    assert training["nyu_train_ids"] == "0003-0004"


def test_networks_of_other_units_or_kinds_are_refused(tmp_path: Path) -> None:
    fine = write_checkpoint(tmp_path / "fine.ckpt", data=NYU_PAPER, hfov_deg=60.0)
    of_another_camera = write_checkpoint(tmp_path / "a.ckpt", data=NYU_PAPER, hfov_deg=70.0)
    of_another_kind = write_checkpoint(
        tmp_path / "b.ckpt", small_network(RESNET), RESNET, data=NYU_PAPER, hfov_deg=60.0
    )
    for coarse in (of_another_camera, of_another_kind):
        with pytest.raises(UsageError):
            export_checkpoint(fine, tmp_path / "m.onnx", ExportOptions(coarse=coarse))
    assert not (tmp_path / "m.onnx").exists()
