"""Known depth of training's views; its patterns are tested with the data sets."""

import numpy as np
import torch

from depthcli.lab.training.augment import Views
from depthcli.lab.training.config import PromptConfig
from depthcli.lab.training.prompts import drawn_prompt, drawn_prompts

COUNT, HEIGHT, WIDTH = 24, 96, 128


def _views() -> Views:
    rows, columns = torch.meshgrid(torch.arange(HEIGHT), torch.arange(WIDTH), indexing="ij")
    depth_m = torch.arange(1, COUNT + 1).view(-1, 1, 1, 1) + rows / 100
    boxes = ((rows // 12 + columns // 16) % 2).float().expand(COUNT, 3, -1, -1)
    return Views(boxes, depth_m, (columns < WIDTH // 2).expand(COUNT, 1, -1, -1))


def test_each_view_has_points_of_its_measured_depth_and_the_seed_decides_them() -> None:
    config = PromptConfig(exact=1, jitter_px=0, missing=0)
    views = _views()
    found = drawn_prompts(views, config, np.random.SeedSequence(3))
    known = found > 0
    assert known.any(dim=3).any(dim=2).sum() > COUNT / 2  # a far view has none of a depth camera
    assert torch.equal(found[known], views.depth_m[known])
    assert views.valid_mask is not None
    assert not known[~views.valid_mask].any()
    assert torch.equal(found, drawn_prompts(views, config, np.random.SeedSequence(3)))
    assert not torch.equal(found, drawn_prompts(views, config, np.random.SeedSequence(4)))
    nothing = views._replace(valid_mask=torch.zeros_like(views.valid_mask))
    assert not drawn_prompts(nothing, config, np.random.SeedSequence(3)).any()


def test_config_decides_patterns_sizes_and_how_many_are_exact() -> None:
    random = np.random.default_rng(0)
    config = PromptConfig(("uniform", "lidar"), (5, 50), lines=(64, 99), exact=0.25, missing=0.5)
    drawn = [drawn_prompt(config, random) for _ in range(400)]
    exact = [not (one.noise or one.wrong or one.has_kinect_noise) for one in drawn]
    assert 0.25 < np.mean(exact) < 0.5
    assert abs(np.mean([one.part != (0, 0, 1, 1) for one in drawn]) - 0.5) < 0.1
    sizes = {
        pattern: {one.size for one in drawn if one.pattern == pattern}
        for pattern in config.patterns
    }
    assert sizes["lidar"] == {64, 99}
    ranges_m = [one.range_m for one in drawn]
    assert 2.5 < min(ranges_m) < 2.6
    assert 7.8 < max(ranges_m) < 8
    assert min(sizes["uniform"]) in {5, 6}
    assert 45 < max(sizes["uniform"]) <= 50
