"""Known depth that training draws for a batch, beside what is drawn for one image."""

from typing import Any

import numpy as np
import pytest
import torch

from depthcli.datasets.prompts import Pattern, Prompt
from depthcli.training.augment import Views
from depthcli.training.config import PromptConfig
from depthcli.training.prompts import drawn_prompt, drawn_prompts

COUNT, HEIGHT, WIDTH = 24, 96, 128
ROWS, COLUMNS = np.mgrid[:HEIGHT, :WIDTH].astype(np.float32)
STEP_M = np.where(COLUMNS < 61, 2, 3) + ROWS / 100
BOXES = ((ROWS // 12 + COLUMNS // 16) % 2) * (1 + COLUMNS / 50)


def _views() -> Views:
    depth_m, image = (
        torch.from_numpy(np.repeat(one[None, None], COUNT, 0)).float() for one in (STEP_M, BOXES)
    )
    return Views(image, depth_m, None)


def _drawn(pattern: Pattern, size: int, seed: int = 0, **changes: Any) -> torch.Tensor:
    ends = size, size
    config = PromptConfig(
        (pattern.value,),
        ends,
        ends,
        (size,),
        ends,
        jitter_px=0,
        missing=0,
        **{"exact": 1} | changes,
    )
    return drawn_prompts(_views(), config, np.random.SeedSequence(seed))[:, 0]


@pytest.mark.parametrize(
    ("pattern", "size"),
    [(Pattern.UNIFORM, 500), (Pattern.LIDAR, 4), (Pattern.CAMERA, 16), (Pattern.CORNERS, 20)],
)
def test_there_are_as_many_exact_points_as_of_one_image(pattern: Pattern, size: int) -> None:
    found = _drawn(pattern, size)
    known = found > 0
    assert torch.equal(found[known], _views().depth_m[:, 0][known])
    assert torch.equal(found, _drawn(pattern, size))
    assert not torch.equal(found, _drawn(pattern, size, seed=1)) or pattern is Pattern.CORNERS
    random = np.random.default_rng(0)
    wanted = [Prompt(pattern, size).draw(STEP_M, BOXES, random) > 0 for _ in range(30)]
    assert float(known.sum() / COUNT) == pytest.approx(np.mean(wanted) * STEP_M.size, rel=0.25)


def test_places_are_those_of_one_image() -> None:
    random = np.random.default_rng(0)
    corners = Prompt(Pattern.CORNERS, 20).draw(STEP_M, BOXES, random) > 0
    assert ((_drawn(Pattern.CORNERS, 20)[0] > 0).numpy() & corners).sum() >= 18
    y, x = np.nonzero((_drawn(Pattern.LIDAR, 1)[0] > 0).numpy())
    slope, first = np.polyfit(x, y, 1)
    assert np.abs(y - (first + slope * x)).max() < 1
    y, x = np.nonzero((_drawn(Pattern.CAMERA, 16)[0] > 0).numpy())
    assert (len(np.unique(x)), len(np.unique(y))) == (16, 12)
    beside = np.abs(x - 64) <= 4
    assert 0 < beside.sum() < 0.6 * 2 * 12
    assert (~beside).sum() == 14 * 12


def test_errors_are_as_large_as_stated() -> None:
    def errors(**changes: Any) -> torch.Tensor:
        found, truth = _drawn(Pattern.UNIFORM, 10_000, exact=0, **changes), _views().depth_m[:, 0]
        return (found / truth - 1)[found > 0]

    none: dict[str, Any] = {"noise": 0.0, "kinect": 0.0, "wrong": (0.0,), "shifted": 0.0}
    assert not errors(**none).any()
    wrong = errors(**none | {"wrong": (0.25,)}).abs()
    assert float((wrong > 0.1).float().mean()) == pytest.approx(0.25, abs=0.02)
    kinect = errors(**none | {"kinect": 1.0})
    assert float(kinect.std()) == pytest.approx(0.0050, rel=0.2)
    assert 0 < float((errors(**none | {"shifted": 1.0}).abs() > 0.1).float().mean()) < 0.05


def test_config_decides_how_many_are_exact() -> None:
    random = np.random.default_rng(0)
    drawn = [drawn_prompt(PromptConfig(exact=0.25, missing=0.5), random) for _ in range(400)]
    exact = [not (one.noise or one.wrong or one.has_kinect_noise) for one in drawn]
    assert 0.25 < np.mean(exact) < 0.5
    assert np.mean([one.part != (0, 0, 1, 1) for one in drawn]) == pytest.approx(0.5, abs=0.1)
