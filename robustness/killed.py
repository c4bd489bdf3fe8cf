"""Commands that a signal ends at any moment, and what the next run makes of what they left.

    python -m robustness.killed                           # 200 moments, some minutes
    python -m robustness.killed --moments 20 --jobs batch --seed 7

Each job is run once without a break. Then it is started again and again, and gets SIGINT, SIGTERM,
SIGHUP or SIGKILL at a moment that is drawn from the time it took; each eighth time from the very
start of Python, else in a process that has the libraries loaded, forked from this one. It must end
at once with the signal's exit code, without a word of Python's or a library's, and without
temporary files unless it was killed; the same command must then give the bytes of the unbroken run,
and leave nothing hidden. Prints a line for each job and signal; exits with 1 if anything fell
short.
"""

from __future__ import annotations

import argparse
import os
import random
import re
import shutil
import signal
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import NamedTuple

from helpers.command_line import ROOT, Cli, unmeasured
from helpers.tiny import synthetic_image, write_image, write_model
from helpers.videos import flat_frames, write_video

from depthcli.cli.app import main as main_of_depthcli
from robustness.every_call_fails import in_a_fork, load
from robustness.faults import exit_code
from robustness.faulty_commands import COMMANDS, TRAIN, steady, training

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGKILL)
LONGEST_END_S = 20.0
"""Where a whole machine is busy; the command itself is given two seconds."""
NOISE = ("Traceback", "terminate called", "Exception ignored", "Error", "Fatal", "dumped")
CONTINUED = re.compile(
    r"\.depthcli-batch\.jsonl|.*\.depthcli-frames|\.depthcli-[0-9a-f]{8}-[0-9a-f]{16}-[12]\..*"
)
"""Journals, and the frames of a depth video that the next run goes on with."""


class Job(NamedTuple):
    """A command whose outputs go to ``out``, and how often it is chosen."""

    words: tuple[str, ...]
    share: int


_VIDEO = ("video", "clip.mkv", "--workers", "2", "--threads", "1")
JOBS = {
    "predict": Job(("predict", "images", "-o", "out/", "--format", "exr"), 2),
    "batch": Job(("batch", "in", "--out", "out", "--format", "png16", "--format", "exr"), 6),
    "frames": Job((*_VIDEO, "--out", "out/", "--format", "png16", "--format", "npy"), 4),
    "mkv": Job((*_VIDEO, "--out", "out/", "--format", "mkv", "--format", "mp4"), 3),
    "train": Job(TRAIN, 4),
    "export": Job(("export-onnx", "last.ckpt", "-o", "out/model.onnx"), 1),
}


def room(folder: Path, names: tuple[str, ...]) -> None:
    """A folder with what the jobs read."""
    write_model(folder / "models" / "default")
    for i in range(16):
        write_image(folder / "in" / f"{i % 3}" / f"{i:02}.png", synthetic_image(96, 128))
    write_video(folder / "in" / "short.mkv", flat_frames(range(20, 240, 20), 60, 80))
    write_video(folder / "clip.mkv", flat_frames(range(10, 250, 8), 240, 320))
    if {"train", "export"} & {*names}:
        training(folder)


def command(cli: Cli, job: Job) -> list[str]:
    """The words, with all images where there are to be some."""
    images = sorted(str(path.relative_to(cli.folder)) for path in cli.folder.glob("in/*/*.png"))
    words = [one for word in job.words for one in (images if word == "images" else [word])]
    return cli.command(*words)


def content(cli: Cli) -> dict[str, object]:
    """All files of the outputs, hidden ones too, without times that they took."""
    out = cli.folder / "out"
    return {str(path.relative_to(out)): steady(path) for path in out.rglob("*") if path.is_file()}


def hidden(cli: Cli) -> list[str]:
    """Temporary files that are there, but for those that the next run is to find."""
    names = (path.name for path in (cli.folder / "out").rglob(".*") if path.is_file())
    return sorted(name for name in names if not CONTINUED.fullmatch(name))


def started(cli: Cli, job: Job, *, cold: bool) -> int:
    """The number of a process that runs the command; from the start of Python if cold."""
    words, writes = command(cli, job), os.O_WRONLY | os.O_CREAT | os.O_TRUNC
    streams = {1: os.devnull, 2: str(cli.folder / "said")}
    if cold:  # without a fork of Python, which threads of the tests' process would not survive
        opened = [(os.POSIX_SPAWN_OPEN, n, path, writes, 0o666) for n, path in streams.items()]
        shell = ["/bin/sh", "-c", 'cd "$0" && exec "$@"', str(cli.folder), *words]
        return os.posix_spawn(shell[0], shell, unmeasured(cli.environment), file_actions=opened)
    child = os.fork()
    if child:
        return child
    try:
        os.chdir(cli.folder)
        for handle, path in streams.items():
            os.dup2(os.open(path, writes, 0o666), handle)
        os.environ.clear()
        os.environ.update(unmeasured(cli.environment))
        sys.argv = ["depthcli", *words[words.index("depthcli") + 1 :]]
        main_of_depthcli()
    finally:
        os._exit(70)


def said(cli: Cli) -> str:
    """What the latest process wrote to standard error."""
    return (cli.folder / "said").read_text("utf-8", "replace").strip()


def ended(
    cli: Cli, process: int, number: signal.Signals, delay_s: float
) -> tuple[str, list[str]] | None:
    """How a run ends that gets a signal, and where it falls short; None if it was done before."""
    until_s = time.monotonic() + delay_s
    while time.monotonic() < until_s:
        if os.waitpid(process, os.WNOHANG)[0]:
            return None
        time.sleep(0.002)
    sent_s = time.monotonic()
    os.kill(process, number)
    code, faults = exit_code(process), []
    if code not in {0, 128 + number, -number}:
        faults.append(f"exit code {code}")
    if time.monotonic() - sent_s > LONGEST_END_S:
        faults.append(f"took {time.monotonic() - sent_s:.1f} s to end")
    if any(word in said(cli) for word in NOISE):
        faults.append(f"said {said(cli)!r}")
    if number is not signal.SIGKILL and hidden(cli):
        faults.append(f"left {hidden(cli)}")
    return str(code), faults


def resumed(cli: Cli, job: Job, whole: dict[str, object], *, cold: bool) -> list[str]:
    """Where the next run of the same command falls short."""
    code = exit_code(started(cli, job, cold=cold))
    if code != 0:
        return [f"next run: exit code {code}, {said(cli)!r}"]
    written = content(cli)
    return [
        f"next run: {name} {'differs' if name in written and name in whole else 'is odd'}"
        for name in sorted(written.keys() | whole.keys())
        if name not in written or name not in whole or written[name] != whole[name]
    ]


def fresh(cli: Cli) -> None:
    """No outputs."""
    shutil.rmtree(cli.folder / "out", ignore_errors=True)
    (cli.folder / "out").mkdir()


def unbroken(cli: Cli, job: Job, *, cold: bool = False) -> tuple[float, dict[str, object]]:
    """How long a job takes, and what it writes."""
    fresh(cli)
    start_s = time.monotonic()
    if exit_code(started(cli, job, cold=cold)) != 0:
        raise RuntimeError(f"{job.words}: {said(cli)}")
    return time.monotonic() - start_s, content(cli)


def attack(
    cli: Cli, names: tuple[str, ...], moments: int, seed: int, cold_every: int = 8
) -> list[str]:
    """End jobs at random moments, every so many from the start of Python.

    Returns:
        All that fell short, a line each.
    """
    rng = random.Random(seed)  # noqa: S311 - to be repeated, not to be secret
    expected: dict[tuple[str, bool], tuple[float, dict[str, object]]] = {}
    ends: Counter[tuple[str, str, str]] = Counter()
    shortfalls = []
    for moment in range(moments):
        name = rng.choices(names, [JOBS[one].share for one in names])[0]
        number, part, job = rng.choice(SIGNALS), rng.random(), JOBS[name]
        cold = moment % cold_every == 0
        if name == "export" and not (cli.folder / "last.ckpt").exists():
            unbroken(cli, JOBS["train"])
            shutil.copy(cli.folder / "out/last.ckpt", cli.folder)
        if (name, cold) not in expected:
            expected[name, cold] = unbroken(cli, job, cold=cold)
        end = None
        while end is None:
            seconds, wanted = expected[name, cold]
            fresh(cli)
            start_s = time.monotonic()
            end = ended(cli, started(cli, job, cold=cold), number, part * seconds)
            if end is None:  # the machine is less busy than it was
                expected[name, cold] = time.monotonic() - start_s, wanted
        code, faults = end
        ends[name, number.name, code] += 1
        faults += resumed(cli, job, wanted, cold=cold)
        what = f"{name} {number.name} at {part * seconds:.3f} s{', cold' if cold else ''}"
        print(f"{moment + 1:4} {what}: exit code {code}", *faults, sep="; ", file=sys.stderr)
        shortfalls += [f"{what}: {one}" for one in faults]
    for (name, number, code), count in sorted(ends.items()):
        print(f"{name:8} {number:8} exit code {code:>4}: {count:4}")
    return shortfalls


def main() -> int:
    """Attack, and print what fell short."""
    # Whoever starts this in the background, or under nohup, lets it and all it starts ignore these.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGHUP, signal.SIG_DFL)
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--moments", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", default=",".join(JOBS))
    options = parser.parse_args()
    names = tuple(options.jobs.split(","))
    for name in names:
        load(COMMANDS[JOBS[name].words[0].partition("-")[0]])
    with tempfile.TemporaryDirectory() as folder:
        in_a_fork(lambda: room(Path(folder), names))
        cli = Cli(ROOT, Path(folder), Path(folder) / "models")
        shortfalls = attack(cli, names, options.moments, options.seed)
    print(*shortfalls, sep="\n")
    print(f"{options.moments} moments, {len(shortfalls)} shortfalls")
    return 1 if shortfalls else 0


if __name__ == "__main__":
    sys.exit(main())
