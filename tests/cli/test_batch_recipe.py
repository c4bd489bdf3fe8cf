"""What a batch's outputs follow from."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import TYPE_CHECKING

import pytest
from tiny import write_model

from depthcli.cli.arguments.camera import choose_camera
from depthcli.cli.arguments.formats import Colormap, ExrChannel, Near
from depthcli.cli.arguments.writing import writer_options
from depthcli.core.picture_limit import PictureLimit
from depthcli.inference.pipeline import load
from depthcli.io.writers.formats import Format
from depthcli.jobs.batch.recipe import Recipe

if TYPE_CHECKING:
    from pathlib import Path

    from depthcli.jobs.batch.manifest import Origin

LOOKS = writer_options(
    png_scale=None,
    png_normalize=False,
    exr_channel=ExrChannel.Z,
    half=False,
    colormap=Colormap.INFERNO,
    near=Near.WARM,
    vmin=None,
    vmax=None,
    legend=False,
    side_by_side=False,
)
RECIPE = Recipe(
    (Format.PNG16,), LOOKS, choose_camera(None, None, None), PictureLimit(1000), ("a=1", "b=2")
)


def origin(folder: Path, recipe: Recipe = RECIPE, **card: object) -> Origin:
    return recipe.origin(load(write_model(folder / "model", **card)))


@pytest.mark.parametrize(
    "changed",
    [
        RECIPE._replace(provider_options=("a=1",)),
        RECIPE._replace(provider_options=("a=1", "b=3")),
        RECIPE._replace(formats=(Format.PNG16, Format.NPY)),
        RECIPE._replace(camera=choose_camera(300.0, None, None)),
        *(
            RECIPE._replace(looks=replace(LOOKS, **{field.name: "other"}))
            for field in fields(LOOKS)
        ),
    ],
)
def test_every_option_of_the_outputs_counts(tmp_path: Path, changed: Recipe) -> None:
    assert origin(tmp_path, changed).options_sha256 != origin(tmp_path).options_sha256


def test_the_order_of_the_provider_s_options_does_not(tmp_path: Path) -> None:
    turned = RECIPE._replace(provider_options=("b=2", "a=1"))
    assert origin(tmp_path, turned) == origin(tmp_path)


@pytest.mark.parametrize(
    "card",
    [{"output__shift": 6.0}, {"input__mean": [0.4]}, {"camera": {"hfov_deg": 60.0}}],
)
def test_a_model_is_more_than_its_weights(tmp_path: Path, card: dict[str, object]) -> None:
    before, after = origin(tmp_path), origin(tmp_path, **card)
    assert before.model_sha256 == after.model_sha256
    assert before != after
