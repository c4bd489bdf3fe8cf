"""Batches whose images are processed by several processes of this machine."""

import multiprocessing
import os
import re
import signal
import subprocess
import threading
import time
from dataclasses import replace
from pathlib import Path

import pytest
from helpers.batches import kept, outputs, request
from helpers.command_line import Cli
from helpers.tiny import endless_onnx, synthetic_image, write_image, write_model

from depthcli.errors import EngineError, ModelError
from depthcli.inference.loading import SessionLoader
from depthcli.jobs.batch.run import Batch, BatchRequest
from depthcli.jobs.batch.workers import WorkerProcesses, WorkerSpec, process_count

MANY = 200


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with many images ``in`` it."""
    first = write_image(tmp_path / "in" / "000.png", synthetic_image(24, 32)).read_bytes()
    for number in range(1, MANY):
        (tmp_path / "in" / f"{number:03}.png").write_bytes(first)
    (tmp_path / "in" / "100.png").write_bytes(b"no image")
    return tmp_path


def in_processes(folder: Path, out: str = "out") -> BatchRequest:
    """A batch by 5 workers in two processes."""
    return replace(request(folder, out), workers=5, may_spawn=True)


@pytest.mark.parametrize(
    ("workers", "images", "processes"),
    [(4, MANY, 1), (5, MANY, 2), (16, MANY, 4), (16, MANY - 1, 1)],
)
def test_processes_are_for_many_images_on_more_than_four_cores(
    workers: int, images: int, processes: int
) -> None:
    assert process_count(workers, range(images)) == processes


def test_processes_give_the_outputs_of_threads_in_order_and_end(folder: Path) -> None:
    batch = Batch(in_processes(folder))
    names = [next(batch).row.input]
    assert len(multiprocessing.active_children()) == 2
    names += [result.row.input for result in batch]
    assert names == sorted(names)
    assert batch.tally.failures[0][0] == "100.png"
    assert batch.tally.done == MANY
    assert not multiprocessing.active_children()
    list(Batch(request(folder, "threads")))
    assert outputs(folder / "out") == outputs(folder / "threads")


def test_a_script_that_uses_the_library_starts_no_processes(folder: Path) -> None:
    """Each would import the script, and run it again."""
    batch = Batch(replace(request(folder), workers=5))
    next(batch)
    assert not multiprocessing.active_children()
    batch.close()


def test_a_killed_process_ends_the_batch_which_resumes(folder: Path) -> None:
    batch = Batch(in_processes(folder))
    next(batch)
    multiprocessing.active_children()[0].kill()
    with pytest.raises(EngineError, match=r"ended while it processed .*\d\d\d\.png"):
        list(batch)
    assert not multiprocessing.active_children()
    rows = list(Batch(in_processes(folder)))
    assert len(rows) == MANY
    assert rows[0].is_kept


def test_errors_of_a_process_are_those_of_its_worker(folder: Path) -> None:
    request_ = in_processes(folder)
    spec = WorkerSpec(request_.model, "0" * 64, request_.options, request_.plan.out)
    here = request_.model.load()
    worker = replace(spec, model_sha256=here.model.sha256).build(here)
    with (
        WorkerProcesses(spec, 1, 1, worker) as processes,
        pytest.raises(ModelError, match="began with"),
    ):
        processes.work(())


def test_processes_stop_with_the_session(folder: Path) -> None:
    loader = SessionLoader(write_model(folder / "endless", endless_onnx()), "cpu")
    session = loader.load()
    batch = Batch(replace(in_processes(folder), model=loader), session)
    threading.Timer(2, session.stop).start()
    with pytest.raises((ModelError, EngineError)):  # the latter if its process still starts
        next(batch)
    assert not multiprocessing.active_children()


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_to_the_whole_group_is_no_error(
    cli: Cli, folder: Path, number: signal.Signals
) -> None:
    """Slurm and systemd send one to all processes of a job; Ctrl-C came while theirs started."""
    model = request(folder).model.model
    assert model
    words = ("-o", folder / "out", "--workers", "5", "--json", "--model", model)
    process = subprocess.Popen(
        cli.command("batch", folder / "in", *words),
        env=cli.environment,
        start_new_session=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stdout
    children = Path(f"/proc/{process.pid}/task/{process.pid}/children")  # two, and their tracker
    while number == signal.SIGINT and len(children.read_text().split()) < 3:
        pass
    if number == signal.SIGTERM:
        process.stdout.readline()
    else:
        time.sleep(0.3)  # they import
    os.killpg(process.pid, number)
    stderr = process.communicate()[1]
    assert process.returncode == 128 + number
    assert not re.search("Traceback|Interrupt|worker", stderr)
    done = [name for name, is_kept in kept(folder).items() if is_kept]
    assert done or number == signal.SIGINT
    assert len(done) < MANY
