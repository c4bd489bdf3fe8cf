"""What a batch's outputs follow from."""

from dataclasses import fields, replace
from pathlib import Path

import pytest
from helpers.tiny import write_model

from depthcli.core.camera import Intrinsics
from depthcli.inference.loading import SessionLoader
from depthcli.io.formats.table import Format, WriterOptions
from depthcli.io.manifest import CacheKey
from depthcli.jobs.batch.tasks import BatchOptions
from depthcli.jobs.batch.workers import WorkerSpec

WRITING = WriterOptions()
OPTIONS = BatchOptions()
SETTINGS = {"a": "1", "b": "2"}


def cache_key(
    folder: Path,
    options: BatchOptions = OPTIONS,
    settings: dict[str, str] = SETTINGS,
    **card: object,
) -> CacheKey:
    session = SessionLoader(write_model(folder / "model", **card)).load()
    loader = SessionLoader(provider_options=settings)
    return WorkerSpec(loader, session.model.sha256, options, folder).key(session)


@pytest.mark.parametrize(
    "changed",
    [
        BatchOptions(formats=(Format.PNG16, Format.NPY)),
        BatchOptions(camera=Intrinsics(300.0)),
        *(BatchOptions(writing=replace(WRITING, **{field.name: 7})) for field in fields(WRITING)),
    ],
)
def test_every_option_of_the_outputs_counts(tmp_path: Path, changed: BatchOptions) -> None:
    assert cache_key(tmp_path, changed).options_sha256 != cache_key(tmp_path).options_sha256


@pytest.mark.parametrize("changed", [{"a": "1"}, {"a": "1", "b": "3"}])
def test_options_of_the_provider_count(tmp_path: Path, changed: dict[str, str]) -> None:
    assert cache_key(tmp_path, settings=changed) != cache_key(tmp_path)


def test_the_order_of_the_provider_s_options_does_not(tmp_path: Path) -> None:
    assert cache_key(tmp_path, settings={"b": "2", "a": "1"}) == cache_key(tmp_path)


@pytest.mark.parametrize(
    "card",
    [{"output__shift": 6.0}, {"input__mean": [0.4]}, {"camera": {"hfov_deg": 60.0}}],
)
def test_a_model_is_more_than_its_weights(tmp_path: Path, card: dict[str, object]) -> None:
    before, after = cache_key(tmp_path), cache_key(tmp_path, **card)
    assert before.model_sha256 == after.model_sha256
    assert before != after
