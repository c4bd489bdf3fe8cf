"""The batch job: its results, its options, and what its outputs depend on."""

import json
import subprocess
import sys
from collections.abc import Callable, Generator, Iterable, Sequence
from contextlib import closing
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.batches import NAMES, images, outputs, request
from helpers.command_line import Cli
from helpers.tiny import write_model
from helpers.videos import flat_frames, write_mp4
from helpers.watched import Watched

from depthcli.core.camera import Intrinsics
from depthcli.core.options import GPU_BATCH
from depthcli.errors import UsageError
from depthcli.inference.loading import SessionLoader
from depthcli.io.formats.table import Format, WriterOptions
from depthcli.io.manifest import FAILED, OK, CacheKey
from depthcli.jobs.batch.plan import plan_folder
from depthcli.jobs.batch.run import Batch, dry_run
from depthcli.jobs.batch.tasks import BatchOptions, BatchResult, BatchTask
from depthcli.jobs.batch.workers import WorkerSpec


def test_a_library_s_batch_prints_nothing_and_gives_what_the_shell_gives(
    cli: Cli, capfd: pytest.CaptureFixture[str]
) -> None:
    images(cli.folder)
    (cli.folder / "in" / "bad.png").write_bytes(b"")
    write_mp4(cli.folder / "in" / "clip.mp4", [np.full((48, 64, 3), 90, np.uint8)] * 2)
    batch = Batch(request(cli.folder))
    results = list(batch)
    assert capfd.readouterr() == ("", "")
    assert [result.row.status for result in results] == [OK, FAILED, OK, OK, OK]
    assert [name for name, _ in batch.tally.failures] == ["bad.png"]
    model = str(cli.folder / "model")
    words = ("--out", "shell", "--model", model, "--provider", "cpu")
    cli("batch", cli.folder / "in", *words, code=1)
    assert outputs(cli.folder / "out") == outputs(cli.folder / "shell")
    mine, theirs = (
        [{**json.loads(line), "seconds": 0} for line in (cli.folder / out).open()]
        for out in ("out/manifest.jsonl", "shell/manifest.jsonl")
    )
    assert mine == theirs


def test_a_batch_that_is_left_goes_on(tmp_path: Path) -> None:
    images(tmp_path)
    with closing(Batch(request(tmp_path))) as batch:
        first = next(batch)
    names = {first.row.input, *(result.row.input for result in batch.late)}
    assert batch.tally.completed == len(names)
    stale = next(tmp_path.rglob("*.depth.png")).with_name(".depthcli-0123456789abcdef.png")
    stale.touch()
    resumed = Batch(request(tmp_path))
    assert not stale.exists()  # before anything is written: it may have filled the disk
    again = list(resumed)
    assert {result.row.input for result in again if result.is_kept} == names
    assert [result.row.input for result in again] == list(NAMES)
    assert all(result.is_kept for result in Batch(request(tmp_path)))
    other = request(tmp_path, options=BatchOptions(writing=WriterOptions(png_scale=256.0)))
    assert not any(result.is_kept for result in Batch(other))


class LastFirst:
    """An engine that does chunks from the last to the first, one by one."""

    def run(
        self,
        spec: WorkerSpec,
        chunks: Iterable[Sequence[BatchTask]],
        videos: Iterable[BatchTask],
        record: Callable[[Sequence[BatchResult]], None],
    ) -> Generator[BatchResult, None, None]:
        """Work off chunks."""
        assert not list(videos)
        worker = spec.build()
        done = []
        for chunk in reversed(list(chunks)):
            done.append(worker.work(chunk))
            record(done[-1])
        for results in reversed(done):
            yield from results


@pytest.mark.parametrize(
    ("provider", "asked", "sizes"),
    [
        ("cpu", None, [1] * (GPU_BATCH + 1)),
        ("cpu", GPU_BATCH - 1, [GPU_BATCH - 1, 2]),
        ("cuda", None, [GPU_BATCH, 1]),
    ],
)
def test_images_at_once_are_one_or_several_on_a_gpu_or_as_many_as_asked(
    tmp_path: Path, provider: str, asked: int | None, sizes: list[int]
) -> None:
    counts: list[int] = []

    class Sized(LastFirst):
        def run(
            self, spec: WorkerSpec, chunks: Iterable[Sequence[BatchTask]], *rest: Any
        ) -> Generator[BatchResult, None, None]:
            held = list(chunks)
            counts.extend(map(len, held))
            return super().run(spec, held, *rest)

    (tmp_path / "in").mkdir()
    for number in range(GPU_BATCH + 1):
        (tmp_path / "in" / f"{number}.png").write_bytes(b"no image")
    job = replace(request(tmp_path), batch_size=asked)
    session = job.model.load()
    session.provider = provider
    assert len(list(Batch(job, session, engine=Sized()))) == GPU_BATCH + 1
    assert counts == sizes


def test_recorded_results_are_in_the_manifest_after_close(tmp_path: Path) -> None:
    images(tmp_path)
    with closing(Batch(request(tmp_path), engine=LastFirst())) as batch:
        assert next(batch).row.input == NAMES[0]
    late = [(result.row.input, result.row.status) for result in batch.late]
    assert late == [("z.png", OK), ("hall/b.png", OK)]
    assert batch.tally.done == len(NAMES)
    lines = (tmp_path / "out" / "manifest.jsonl").read_text().splitlines()
    assert [json.loads(line)["input"] for line in lines] == list(NAMES)


def test_outputs_do_not_go_behind_http(tmp_path: Path) -> None:
    images(tmp_path)
    with pytest.raises(UsageError):
        plan_folder(str(tmp_path / "in"), "https://host/out")


def test_batch_of_images_loads_no_video_library() -> None:
    code = (
        "import sys, depthcli.jobs.batch.run; print(*{'av', 'tarfile', 'pyarrow'} & {*sys.modules})"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, check=True)
    assert done.stdout.split() == []


def test_pixel_limit_holds_in_dry_run_and_batch(tmp_path: Path) -> None:
    images(tmp_path)
    write_mp4(tmp_path / "in" / "clip.mp4", flat_frames([9, 99]))
    asked = request(tmp_path, options=BatchOptions(max_pixels=24 * 32))
    would = {name: error for _, name, _, error in dry_run(asked, asked.model.load())}
    became = {result.row.input: result.row.error for result in Batch(asked)}
    assert [name for name in NAMES if would[name] is None] == ["a.png"]
    assert {name: would[name] for name in NAMES} == {name: became[name] for name in NAMES}
    assert "max_pixels" in str(became["clip.mp4"])


def test_session_warning_is_printed_once_a_batch(tmp_path: Path) -> None:
    images(tmp_path)
    (tmp_path / "in" / "a.cr2").touch()
    job = request(tmp_path)
    session = job.model.load()
    session.warnings = ("runs on cpu",)
    batch = Batch(job, session)
    assert batch.warnings == (*job.plan.warnings, "runs on cpu")
    assert len(batch.warnings) == 2
    assert not any(result.row.warnings for result in batch)


def test_the_frames_of_a_batch_s_videos_are_told(tmp_path: Path) -> None:
    write_mp4(tmp_path / "in" / "clip.mp4", flat_frames([9, 99, 200]))
    watched = Watched()
    list(Batch(request(tmp_path), progress=watched))
    assert watched.begun == [("clip.mp4", 3, "frames")]
    assert watched.counts == [[1, 1, 1]]


DEFAULTS = WriterOptions()
PLAIN = BatchOptions()
SETTINGS = {"a": "1", "b": "2"}


def cache_key(
    folder: Path, options: BatchOptions = PLAIN, settings: dict[str, str] = SETTINGS, **card: object
) -> CacheKey:
    session = SessionLoader(write_model(folder / "model", **card)).load()
    session.provider_options = settings
    return WorkerSpec(SessionLoader(), session.model.sha256, options, folder).key(session)


@pytest.mark.parametrize(
    "changed",
    [
        BatchOptions(formats=(Format.PNG16, Format.NPY)),
        BatchOptions(camera=Intrinsics(300.0)),
        *(BatchOptions(writing=replace(DEFAULTS, **{field.name: 3})) for field in fields(DEFAULTS)),
    ],
)
def test_every_option_of_the_outputs_counts(tmp_path: Path, changed: BatchOptions) -> None:
    assert cache_key(tmp_path, changed).options_sha256 != cache_key(tmp_path).options_sha256


@pytest.mark.parametrize(
    ("settings", "is_equal"),
    [({"a": "1"}, False), ({"a": "1", "b": "3"}, False), ({"b": "2", "a": "1"}, True)],
)
def test_options_of_the_provider_count_in_any_order(
    tmp_path: Path, settings: dict[str, str], is_equal: bool
) -> None:
    assert (cache_key(tmp_path, settings=settings) == cache_key(tmp_path)) is is_equal


@pytest.mark.parametrize(
    "card", [{"output__shift": 6.0}, {"input__mean": [0.4]}, {"camera": {"hfov_deg": 60.0}}]
)
def test_a_model_is_more_than_its_weights(tmp_path: Path, card: dict[str, object]) -> None:
    before, after = cache_key(tmp_path), cache_key(tmp_path, **card)
    assert before.model_sha256 == after.model_sha256
    assert before != after
