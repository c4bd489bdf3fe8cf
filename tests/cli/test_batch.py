"""``depthcli batch``, run from the built wheel as a user runs it: inputs, outputs, what is said."""

import hashlib
import json
import os
from typing import Any

import numpy as np
import pytest
from helpers.command_line import Cli
from helpers.folders import contents, image, printed, rows, tree
from helpers.tiny import synthetic_image, write_image
from helpers.videos import flat_frames, write_preview_video, write_video

from depthcli.cli.app import main
from depthcli.core.types import Frame
from depthcli.inference.pipeline import Pipeline, Prediction
from depthcli.video.depth_video import DepthVideo


def test_the_tree_is_kept_and_outputs_are_those_of_predict(cli: Cli) -> None:
    tree(cli, "a.png", "hall/b.jpg", "hall/deep/er/c.png", "hall/notes.txt", ".hidden.png")
    done = cli("batch", "in", "--out", "out")
    assert (done.returncode, done.stderr) == (0, b"")
    assert contents(cli, "out").keys() == {
        *("a.depth.png", "hall/b.depth.png", "hall/deep/er/c.depth.png", "manifest.jsonl")
    }
    assert b"3 of 3 inputs done, 2 files skipped (1 hidden, 1 .txt)" in done.stdout
    assert b"manifest: out/manifest.jsonl" in done.stdout
    assert cli("predict", "in/hall/b.jpg", "-o", "alone.png").returncode == 0
    alone = (cli.folder / "alone.png").read_bytes()
    assert contents(cli, "out")["hall/b.depth.png"] == alone


@pytest.mark.parametrize(
    ("words", "taken"),
    [
        (("--exclude", "hall/"), {"a.png"}),
        (("--include", "*.jpg", "--include", "a.*"), {"a.png", "hall/b.jpg"}),
        (("--include", "*.png", "--exclude", "[cd].png"), {"a.png"}),
    ],
)
def test_patterns(inside: Cli, words: tuple[str, ...], taken: set[str]) -> None:
    tree(inside, "a.png", "hall/b.jpg", "hall/c.png", "hall/thumbs/d.png")
    done = inside("batch", "in", "--out", "out", "--json", *words, code=0)
    assert {row["input"] for row in printed(done)} == taken
    assert rows(inside, "out").keys() == taken


@pytest.mark.parametrize("end", [b"\n", b"\0", b"\r\n"])
def test_a_list_from_standard_input(cli: Cli, end: bytes) -> None:
    tree(cli, "a.png", "hall/b.png")
    outside = write_image(cli.folder / "elsewhere" / "c.png")
    words = (b"in/hall/b.png", b"./in/a.png", os.fsencode(outside), b"in/missing.png")
    stdin = b"".join(word + end for word in words)
    done = cli("batch", "--out", "out", "--files", "-", stdin=stdin, code=1)
    assert b"in/missing.png is missing" in done.stderr
    images = {"in/a.depth.png", "in/hall/b.depth.png", str(outside.with_suffix(".depth.png"))[1:]}
    assert contents(cli, "out").keys() == {*images, "manifest.jsonl"}


def test_videos_among_the_images(inside: Cli) -> None:
    tree(inside, "a.png")
    write_video(inside.folder / "in" / "hall" / "clip.avi", flat_frames(range(0, 100, 10)))
    formats = ("--format", "png16", "--format", "preview", "--format", "npy", "--sidecar")
    done = inside("batch", "in", "--out", "out", "--json", *formats, code=0)
    frames = {f"hall/clip.depth.{number:06d}.npy" for number in range(10)}
    video = {"hall/clip.depth.mkv", "hall/clip.preview.mp4", "hall/clip.depth.json"}
    images = {"a.depth.png", "a.preview.png", "a.depth.npy", "a.depth.json"}
    assert contents(inside, "out").keys() == frames | video | images | {"manifest.jsonl"}
    assert [row["input"] for row in printed(done)] == ["a.png", "hall/clip.avi"]
    assert len(list(DepthVideo(inside.folder / "out/hall/clip.depth.mkv").steps())) == 10
    (inside.folder / "out/hall/clip.depth.000004.npy").unlink()
    again = printed(inside("batch", "in", "--out", "out", "--json", *formats))
    assert [row["kept"] for row in again] == [True, False]
    last = printed(inside("batch", "in", "--out", "out", "--json", *formats))
    assert [row["kept"] for row in last] == [True, True]


def test_a_dry_run_writes_nothing(inside: Cli) -> None:
    tree(inside, "a.png", "hall/b.png", "notes.txt")
    (inside.folder / "in" / "empty.jpg").touch()
    dry = ("batch", "in", "--out", "out", "--dry-run")
    done = inside(*dry, code=1)
    assert done.stdout.decode().splitlines() == [
        "do    a.png -> out/a.depth.png",
        "fail  empty.jpg: in/empty.jpg is empty",
        "do    hall/b.png -> out/hall/b.depth.png",
        "skip  notes.txt: .txt",
    ]
    assert b"would process 2, keep 0 already done, fail 1; 1 file skipped" in done.stderr
    assert not (inside.folder / "out").exists()
    assert not inside(*dry, "--include", "a.png", "--quiet", code=0).stderr
    inside("batch", "in", "--out", "out", "--include", "a.png")
    before = contents(inside, "out")
    facts = printed(inside(*dry, "--json"))
    assert [row["would"] for row in facts] == ["keep", "fail", "do", "skip"]
    assert facts[0]["outputs"] == ["out/a.depth.png"]
    assert contents(inside, "out") == before


def test_every_column_of_the_manifest_is_true(inside: Cli) -> None:
    tree(inside, "hall/a.png")
    (inside.folder / "in" / "b.png").write_bytes(b"not an image")
    inside("batch", "in", "--out", "out")
    lines = (inside.folder / "out" / "manifest.jsonl").read_bytes().splitlines()
    failed, row = map(json.loads, lines)
    assert list(row) == list(failed)
    written = (inside.folder / "out/hall/a.depth.png").read_bytes()
    model = (inside.models / "default" / "model.onnx").read_bytes()
    assert row["outputs"] == [
        {"path": "hall/a.depth.png", "bytes": len(written), "sha256": sha256(written)}
    ]
    assert (row["input"], row["status"], row["error"]) == ("hall/a.png", "ok", None)
    assert row["input_sha256"] == sha256((inside.folder / "in/hall/a.png").read_bytes())
    assert (row["model"], row["model_sha256"]) == ("tiny", sha256(model))
    assert len(row["options_sha256"]) == 64
    assert 0 < row["seconds"] < 60
    assert row["warnings"] == []
    assert (failed["status"], failed["outputs"]) == ("failed", [])
    assert "b.png" in failed["error"]
    assert failed["input_sha256"] == sha256(b"not an image")
    assert (row["input_path"], failed["input_path"]) == tuple(
        str(inside.folder / "in" / name) for name in ("hall/a.png", "b.png")
    )


def sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def test_json_prints_the_rows_of_the_manifest(inside: Cli) -> None:
    tree(inside, "a.png", "b.png")
    (inside.folder / "in" / "c.png").touch()
    done = inside("batch", "in", "--out", "out", "--json", code=1)
    printed_rows = printed(done)
    assert [row.pop("kept") for row in printed_rows] == [False] * 3
    assert {row["input"]: row for row in printed_rows} == rows(inside, "out")
    assert b"depthcli: error: in/c.png is empty" in done.stderr


def test_no_bad_file_stops_the_others(inside: Cli) -> None:
    folder = inside.folder / "in"
    tree(inside, "a.png", "z.png")
    good = (folder / "a.png").read_bytes()
    for name, data in {
        "bomb.pbm": b"P4 60000 60000\n",
        "cut.png": good[: len(good) // 2],
        "empty.png": b"",
        "text.jpg": b"hello",
    }.items():
        (folder / name).write_bytes(data)
    (folder / "link.png").symlink_to("nowhere.png")
    (folder / "self.png").symlink_to("self.png")
    os.mkfifo(folder / "pipe.png")
    np.save(folder / "floats.npy", np.zeros(3))
    done = inside("batch", "in", "--out", "out", code=1)
    errors = done.stderr.decode().splitlines()
    bad = ("bomb.pbm", "cut.png", "empty.png", "link.png", "pipe.png", "self.png", "text.jpg")
    assert len(errors) == len(bad)
    for name, line in zip(bad, errors, strict=True):
        assert line.startswith("depthcli: error: ")
        assert f"in/{name} " in line
    assert b"2 of 9 inputs done, 7 failed, 1 file skipped (1 .npy)" in done.stdout
    assert contents(inside, "out").keys() == {"a.depth.png", "z.depth.png", "manifest.jsonl"}
    assert {name for name, row in rows(inside, "out").items() if row["error"]} == set(bad)


def test_an_output_that_cannot_be_written_stops_no_other(inside: Cli) -> None:
    tree(inside, "a.png", "b.png")
    (inside.folder / "out" / "a.depth.png" / "in the way").mkdir(parents=True)
    done = inside("batch", "in", "--out", "out", code=1)
    (line,) = done.stderr.decode().splitlines()
    assert "a.depth.png" in line
    assert rows(inside, "out")["b.png"]["status"] == "ok"


def test_an_output_folder_among_the_inputs_is_not_read(inside: Cli) -> None:
    tree(inside, "a.png", "depth/b.png")
    assert inside("batch", "in", "--out", "in/depth").returncode == 0
    assert rows(inside, "in/depth").keys() == {"a.png"}


def test_a_listed_input_is_never_replaced(inside: Cli) -> None:
    tree(inside, "a.jpg", "a.depth.png", "b.png")
    before = contents(inside, "in")
    stdin = b"a.jpg\na.depth.png\n"
    for extra in ((), ("--dry-run",)):
        done = inside("batch", "in", "--out", "in", "--files", "-", *extra, stdin=stdin, code=2)
        assert b"in/a.depth.png, the output for a.jpg, is an input" in done.stderr
    assert contents(inside, "in") == before
    inside("batch", "in", "--out", "in", "--files", "-", stdin=b"b.png", code=0)
    assert contents(inside, "in").keys() - before.keys() == {"b.depth.png", "manifest.jsonl"}


def test_quiet_says_errors_only(inside: Cli) -> None:
    tree(inside, "a.png")
    done = inside("batch", "in", "--out", "out", "--quiet")
    assert (done.returncode, done.stdout, done.stderr) == (0, b"", b"")
    (inside.folder / "in" / "b.png").touch()
    done = inside("batch", "in", "--out", "out", "-q")
    assert (done.returncode, done.stdout) == (1, b"")
    assert done.stderr.decode().splitlines() == [
        "depthcli: error: in/b.png is empty",
        "1 of 2 inputs failed",
    ]


def test_its_own_outputs_are_no_inputs(inside: Cli) -> None:
    tree(inside, "a.png")
    image(inside, "b.preview.png", synthetic_image())  # another program's
    assert inside("predict", "in/a.png").returncode == 0
    inside("predict", "in/a.png", "-o", "in/a.exr.png", "--format", "png16", code=0)
    for name in ("clip.depth.mkv", "clip.preview.mp4"):
        (inside.folder / "in" / name).touch()
    write_preview_video(inside.folder / "in" / "a.mp4", [np.ones((16, 16), np.float32)])
    done = inside("batch", "in", "--out", "in/out", code=0)
    assert rows(inside, "in/out").keys() == {"a.png", "b.preview.png"}
    assert b"2 of 2 inputs done, 6 files skipped (6 written by depthcli)" in done.stdout
    names = sorted(contents(inside, "in"))
    listed = inside(
        "batch", "in", "--out", "elsewhere", "--files", "-", stdin="\n".join(names).encode()
    )
    assert b"out/a.depth.png" not in listed.stderr
    assert rows(inside, "elsewhere").keys() == {"a.png", "b.preview.png", "out/manifest.jsonl"}


def test_an_unforeseen_error_stops_no_other(cli: Cli, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = Pipeline._predict_batch

    def predict_batch(self: Pipeline, frames: list[Frame], *rest: Any) -> list[Prediction]:
        if any(frame.width == 7 for frame in frames):
            raise ValueError("seven")
        return whole(self, frames, *rest)

    monkeypatch.setattr(Pipeline, "_predict_batch", predict_batch)
    monkeypatch.setenv("DEPTHCLI_MODELS", str(cli.models))
    tree(cli, "a.png", "z.png")
    image(cli, "seven.png", np.zeros((5, 7), np.uint8))
    folders = (str(cli.folder / "in"), "--out", str(cli.folder / "out"))
    assert main(["batch", *folders, "--workers", "1", "--batch-size", "3"]) == 1
    by_name = rows(cli, "out")
    assert {name: row["status"] for name, row in by_name.items()} == {
        **dict.fromkeys(("a.png", "z.png"), "ok"),
        "seven.png": "failed",
    }
    assert by_name["seven.png"]["error"] == "unexpected ValueError: seven"
