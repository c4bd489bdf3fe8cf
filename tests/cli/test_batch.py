"""``depthcli batch``, run from the built wheel as a user runs it: inputs, outputs, what is said."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import shutil
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import pytest
from helpers.folders import contents, picture, printed, rows, tree
from helpers.tiny import fixed_inside, synthetic_picture, write_model, write_picture
from helpers.videos import flat_frames, write_mp4, write_video

from depthcli.cli.app import main
from depthcli.inference.pipeline import Pipeline, Prediction
from depthcli.io.listing.folder import list_folder
from depthcli.video.depth_video import DepthVideo

if TYPE_CHECKING:
    from helpers.command_line import Cli

    from depthcli.core.types import Frame


def test_the_tree_is_kept_and_outputs_are_those_of_predict(cli: Cli) -> None:
    tree(cli, "a.png", "hall/b.jpg", "hall/deep/er/c.png", "hall/notes.txt", ".hidden.png")
    done = cli("batch", "in", "--out", "out")
    assert (done.returncode, done.stderr) == (0, b"")
    assert contents(cli, "out").keys() == {
        *("a.depth.png", "hall/b.depth.png", "hall/deep/er/c.depth.png", "manifest.jsonl"),
    }
    assert b"3 of 3 inputs done, 2 files skipped (1 hidden, 1 .txt)" in done.stdout
    assert b"manifest: out/manifest.jsonl" in done.stdout
    assert cli("predict", "in/hall/b.jpg", "-o", "alone.png").returncode == 0
    alone = (cli.folder / "alone.png").read_bytes()
    assert contents(cli, "out")["hall/b.depth.png"] == alone


def test_the_manifest_names_the_camera_of_each_picture(inside: Cli) -> None:
    write_model(inside.models / "default", camera={"hfov_deg": 60.0}, input__fit="keep-aspect")
    tree(inside, "a.png")
    write_picture(inside.folder / "in" / "upright.png", synthetic_picture(64, 48))
    for words, cameras in (
        ((), ["hfov 60.0° (assumed, from the model's card)", "hfov 46.8° (assumed, from"]),
        (("--hfov", "70"), ["hfov 70.0° (given)", "hfov 70.0° (given)"]),
    ):
        assert inside("batch", "in", "--out", "out", *words).returncode == 0
        rows = (inside.folder / "out" / "manifest.jsonl").read_text().splitlines()
        found = [json.loads(row)["camera"] for row in rows]
        assert all(text.startswith(camera) for text, camera in zip(found, cameras, strict=True))


def test_formats_and_sidecar(inside: Cli) -> None:
    tree(inside, "a.png")
    formats = ("png16", "preview", "exr", "npy", "ply")
    words = [word for name in formats for word in ("--format", name)]
    done = inside("batch", "in", "--out", "out", *words, "--sidecar", "--colormap", "gray")
    assert done.returncode == 0
    names = ("a.depth.png", "a.preview.png", "a.depth.exr", "a.depth.npy", "a.ply", "a.depth.json")
    assert contents(inside, "out").keys() == {*names, "manifest.jsonl"}
    sidecar = json.loads((inside.folder / "out" / "a.depth.json").read_text())
    assert (sidecar["unit"], sidecar["model"]) == ("m", "tiny")


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
    done = inside("batch", "in", "--out", "out", "--json", *words)
    assert done.returncode == 0
    assert {row["input"] for row in printed(done)} == taken
    assert rows(inside, "out").keys() == taken


def test_a_list_from_a_file(inside: Cli) -> None:
    tree(inside, "hall/a.png", "hall/b.png", "c.png")
    shutil.copy(inside.folder / "in/c.png", inside.folder / "in/picture-without-suffix")
    (inside.folder / "list.txt").write_text("hall/a.png\npicture-without-suffix\n\nhall/a.png\n")
    done = inside("batch", "in", "--out", "out", "--files", "list.txt")
    assert done.returncode == 0
    names = {"hall/a.depth.png", "picture-without-suffix.depth.png", "manifest.jsonl"}
    assert contents(inside, "out").keys() == names


@pytest.mark.parametrize("end", [b"\n", b"\0", b"\r\n"])
def test_a_list_from_standard_input(cli: Cli, end: bytes) -> None:
    tree(cli, "a.png", "hall/b.png")
    outside = write_picture(cli.folder / "elsewhere" / "c.png")
    words = (b"in/hall/b.png", b"./in/a.png", os.fsencode(outside), b"in/missing.png")
    stdin = b"".join(word + end for word in words)
    done = cli("batch", "--out", "out", "--files", "-", stdin=stdin)
    assert done.returncode == 1
    assert b"in/missing.png is missing" in done.stderr
    pictures = {"in/a.depth.png", "in/hall/b.depth.png", str(outside.with_suffix(".depth.png"))[1:]}
    assert contents(cli, "out").keys() == {*pictures, "manifest.jsonl"}


def test_a_path_outside_the_folder_keeps_all_its_folders(inside: Cli) -> None:
    tree(inside, "a.png")
    outside = write_picture(inside.folder.parent / "far" / "b.png")
    stdin = b"a.png\n" + os.fsencode(outside)
    done = inside("batch", "in", "--out", "out", "--files", "-", stdin=stdin)
    assert done.returncode == 0
    name = str(outside.with_suffix(".depth.png")).lstrip("/")
    assert contents(inside, "out").keys() == {"a.depth.png", name, "manifest.jsonl"}


def test_names_with_any_byte(cli: Cli) -> None:
    tree(cli, "new\nline.png")
    odd = os.fsdecode(b"caf\xe9.png")
    shutil.copy(cli.folder / "in" / "new\nline.png", cli.folder / "in" / odd)
    done = cli("batch", "in", "--out", "out")
    assert (done.returncode, done.stderr) == (0, b"")
    wanted = {"new\nline.depth.png", os.fsdecode(b"caf\xe9.depth.png"), "manifest.jsonl"}
    assert contents(cli, "out").keys() == wanted
    assert rows(cli, "out").keys() == {"new\nline.png", odd}
    again = cli("batch", "in", "--out", "out")
    assert b"2 already done" in again.stdout


def test_videos_among_the_pictures(inside: Cli) -> None:
    tree(inside, "a.png")
    write_video(inside.folder / "in" / "hall" / "clip.avi", flat_frames(range(0, 100, 10)))
    formats = ("--format", "png16", "--format", "preview", "--format", "npy", "--sidecar")
    done = inside("batch", "in", "--out", "out", "--json", *formats)
    assert done.returncode == 0
    frames = {f"hall/clip.depth.{number:06d}.npy" for number in range(10)}
    video = {"hall/clip.depth.mkv", "hall/clip.preview.mp4", "hall/clip.depth.json"}
    pictures = {"a.depth.png", "a.preview.png", "a.depth.npy", "a.depth.json"}
    assert contents(inside, "out").keys() == frames | video | pictures | {"manifest.jsonl"}
    assert [row["input"] for row in printed(done)] == ["a.png", "hall/clip.avi"]
    assert len(list(DepthVideo(inside.folder / "out/hall/clip.depth.mkv").steps())) == 10
    (inside.folder / "out/hall/clip.depth.000004.npy").unlink()
    again = printed(inside("batch", "in", "--out", "out", "--json", *formats))
    assert [row["kept"] for row in again] == [True, False]
    last = printed(inside("batch", "in", "--out", "out", "--json", *formats))
    assert [row["kept"] for row in last] == [True, True]


def test_videos_fail_as_pictures_do(inside: Cli) -> None:
    tree(inside, "z.png")
    cut = write_video(inside.folder / "in" / "cut.avi", flat_frames(range(60)))
    cut.write_bytes(cut.read_bytes()[: cut.stat().st_size // 2])
    (inside.folder / "in" / "no.mp4").write_bytes(b"no video" * 99)
    (inside.folder / "in" / "broken.mov").symlink_to("nowhere.mov")
    done = inside("batch", "in", "--out", "out")
    assert done.returncode == 1
    found = rows(inside, "out")
    assert {name: row["status"] for name, row in found.items()} == {
        **dict.fromkeys(("broken.mov", "cut.avi", "no.mp4"), "failed"),
        "z.png": "ok",
    }
    assert "ends after" in found["cut.avi"]["error"]
    assert [file["path"] for file in found["cut.avi"]["outputs"]] == ["cut.depth.mkv"]
    assert contents(inside, "out").keys() == {"cut.depth.mkv", "z.depth.png", "manifest.jsonl"}


@pytest.mark.parametrize(
    ("options", "reason"), [(("--format", "ply"), "png16"), (("--anchor", "3,4,2"), "--anchor")]
)
def test_what_does_not_apply_to_videos(inside: Cli, options: tuple[str, ...], reason: str) -> None:
    tree(inside, "a.png")
    write_video(inside.folder / "in" / "clip.avi", flat_frames(range(3)))
    done = inside("batch", "in", "--out", "out", *options)
    assert done.returncode == 1
    (line,) = [x for x in done.stderr.decode().splitlines() if x.startswith("depthcli: error")]
    assert "clip.avi is a video" in line
    assert reason in line
    assert rows(inside, "out")["a.png"]["status"] == "ok"


def test_a_dry_run_writes_nothing(inside: Cli) -> None:
    tree(inside, "a.png", "hall/b.png", "notes.txt")
    (inside.folder / "in" / "empty.jpg").touch()
    dry = ("batch", "in", "--out", "out", "--dry-run")
    done = inside(*dry)
    assert done.returncode == 1
    assert done.stdout.decode().splitlines() == [
        "do    a.png -> out/a.depth.png",
        "fail  empty.jpg: in/empty.jpg is empty",
        "do    hall/b.png -> out/hall/b.depth.png",
        "skip  notes.txt: .txt",
    ]
    assert b"would process 2, keep 0 already done, fail 1; 1 file skipped" in done.stderr
    assert not (inside.folder / "out").exists()
    assert inside(*dry, "--include", "a.png").returncode == 0
    inside("batch", "in", "--out", "out", "--include", "a.png")
    before = contents(inside, "out")
    found = printed(inside(*dry, "--json"))
    assert [row["would"] for row in found] == ["keep", "fail", "do", "skip"]
    assert found[0]["outputs"] == ["out/a.depth.png"]
    assert contents(inside, "out") == before


def test_every_column_of_the_manifest_is_true(inside: Cli) -> None:
    tree(inside, "hall/a.png")
    (inside.folder / "in" / "b.png").write_bytes(b"not a picture")
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
    assert "is not a picture" in failed["error"]
    assert failed["input_sha256"] == sha256(b"not a picture")
    assert (row["input_path"], failed["input_path"]) == tuple(
        str(inside.folder / "in" / name) for name in ("hall/a.png", "b.png")
    )


def sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def test_json_prints_the_rows_of_the_manifest(inside: Cli) -> None:
    tree(inside, "a.png", "b.png")
    (inside.folder / "in" / "c.png").touch()
    done = inside("batch", "in", "--out", "out", "--json")
    assert done.returncode == 1
    found = printed(done)
    assert [row.pop("kept") for row in found] == [False] * 3
    assert {row["input"]: row for row in found} == rows(inside, "out")
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
    done = inside("batch", "in", "--out", "out")
    assert done.returncode == 1
    errors = done.stderr.decode().splitlines()
    bad = ("bomb.pbm", "cut.png", "empty.png", "link.png", "pipe.png", "self.png", "text.jpg")
    assert len(errors) == len(bad)
    for name, line in zip(bad, errors, strict=True):
        assert line.startswith("depthcli: error: ")
        assert f"in/{name} " in line
    assert b"2 of 9 inputs done, 7 failed, 1 file skipped (1 .npy)" in done.stdout
    assert contents(inside, "out").keys() == {"a.depth.png", "z.depth.png", "manifest.jsonl"}
    assert {name for name, row in rows(inside, "out").items() if row["error"]} == set(bad)


def test_what_may_not_be_read_is_a_failure(inside: Cli) -> None:
    tree(inside, "a.png", "secret.png", "locked/b.png")
    for name in ("secret.png", "locked"):
        (inside.folder / "in" / name).chmod(0)
    done = inside.as_user("batch", "in", "--out", "out")
    (inside.folder / "in" / "locked").chmod(0o700)
    assert done.returncode == 1
    assert b"in/locked cannot be listed: Permission denied" in done.stderr
    assert b"in/secret.png cannot be read: Permission denied" in done.stderr
    assert contents(inside, "out").keys() == {"a.depth.png", "manifest.jsonl"}


def test_a_folder_that_is_too_deep_is_a_failure(tmp_path: Path) -> None:
    with contextlib.chdir(tmp_path):
        for name in ["in"] + 50 * ["a" * 100]:  # more than a path may have
            Path(name).mkdir()
            os.chdir(name)
        Path("b.png").touch()
    (found,) = list_folder(str(tmp_path / "in"), leave_out=str(tmp_path / "out")).media
    assert found.problem is not None
    assert "cannot be listed: File name too long" in found.problem


def test_an_output_that_cannot_be_written_stops_no_other(inside: Cli) -> None:
    tree(inside, "a.png", "b.png")
    (inside.folder / "out" / "a.depth.png" / "in the way").mkdir(parents=True)
    done = inside("batch", "in", "--out", "out")
    assert done.returncode == 1
    (line,) = done.stderr.decode().splitlines()
    assert "cannot write out/a.depth.png" in line
    assert rows(inside, "out")["b.png"]["status"] == "ok"


def test_a_picture_that_the_network_fails_on_stops_no_other(inside: Cli) -> None:
    # A reshape to a fixed size fails on every picture that comes in another one.
    write_model(inside.models / "default", fixed_inside(), input__fit="keep-aspect")
    picture(inside, "wide.png", np.zeros((10, 300), np.uint8))
    tree(inside, "a.png", "z.png")
    done = inside("batch", "in", "--out", "out")
    assert done.returncode == 1
    assert b"wide.png" in done.stderr
    assert {n: r["status"] for n, r in rows(inside, "out").items()} == {
        **dict.fromkeys(("a.png", "z.png"), "ok"),
        "wide.png": "failed",
    }


def test_a_network_that_fails_on_everything_is_no_fault_of_the_inputs(inside: Cli) -> None:
    write_model(inside.models / "default", fixed_inside(5))
    tree(inside, "a.png", "b.png")
    done = inside("batch", "in", "--out", "out")
    assert done.returncode == 3
    assert b"model.onnx failed" in done.stderr


def test_loops_are_left_out_and_named(inside: Cli) -> None:
    tree(inside, "hall/a.png", "b.png")
    (inside.folder / "in" / "hall" / "up").symlink_to("..")
    (inside.folder / "in" / "twin").symlink_to("hall")
    done = inside("batch", "in", "--out", "out")
    assert done.returncode == 0
    assert rows(inside, "out").keys() == {"b.png", "hall/a.png", "twin/a.png"}
    assert b"hall/up is a link to a folder above it" in done.stderr


def test_names_do_not_collide(inside: Cli) -> None:
    levels = {"a.jpg": 0, "a.png": 50, "a.jpg.png": 100, "b.png": 150, "B.png": 200}
    for name, level in levels.items():
        picture(inside, name, np.full((20, 20), level, np.uint8))
    assert inside("batch", "in", "--out", "out").returncode == 0
    found = rows(inside, "out")
    outputs = {name: found[name]["outputs"][0]["path"] for name in levels}
    assert len({path.casefold() for path in outputs.values()}) == len(levels)
    assert outputs["a.jpg"] == "a.jpg.depth.png"
    for name, level in levels.items():
        steps = cv2.imread(str(inside.folder / "out" / outputs[name]), cv2.IMREAD_UNCHANGED)
        assert steps.mean() == pytest.approx(1000 + 8000 * level / 255, abs=40)


def test_names_do_not_depend_on_what_is_wanted(inside: Cli) -> None:
    tree(inside, "a.jpg", "a.png")
    inside("batch", "in", "--out", "one", "--include", "*.png")
    inside("batch", "in", "--out", "all")
    png = "a.png.depth.png"
    assert contents(inside, "one")[png] == contents(inside, "all")[png]


def test_an_output_folder_among_the_inputs_is_not_read(inside: Cli) -> None:
    tree(inside, "a.png")
    for _ in range(2):
        assert inside("batch", "in", "--out", "in/depth").returncode == 0
    assert rows(inside, "in/depth").keys() == {"a.png"}


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (("in",), "name the folder for outputs"),
        ((), "name the folder for outputs"),
        (("--out", "out"), "name a folder, or give --files"),
        (("nowhere", "--out", "out"), "nowhere is not a folder"),
        (("in/a.png", "--out", "out"), "is not a folder"),
        (("in", "--out", "in"), "is the folder of the inputs"),
        (("in", "--out", "in/../in"), "is the folder of the inputs"),
        (("in", "--out", "leads-in"), "would lie among the inputs"),
        (("in", "--out", "out", "--files", "nowhere.txt"), "cannot read the list nowhere.txt"),
        (("in", "--out", "out", "--focal-px", "3", "--hfov", "4"), "not both"),
        (("in", "--out", "out", "--png-normalize", "--png-scale", "5"), "--png"),
        (("in", "--out", "out", "--workers", "0"), "workers"),
        (("in", "--out", "out", "--provider-option", "a=b"), "provider"),
    ],
)
def test_wrong_usage(inside: Cli, words: tuple[str, ...], reason: str) -> None:
    tree(inside, "hall/b.png", "a.png")
    (inside.folder / "leads-in").mkdir()
    (inside.folder / "leads-in" / "hall").symlink_to("../in/hall")
    before = contents(inside, ".")
    done = inside("batch", *words)
    assert done.returncode == 2
    (line,) = done.stderr.decode().splitlines()
    assert reason in line
    assert contents(inside, ".") == before


def test_a_listed_input_is_never_replaced(inside: Cli) -> None:
    tree(inside, "a.jpg", "a.depth.png", "b.png")
    before = contents(inside, "in")
    stdin = b"a.jpg\na.depth.png\n"
    for extra in ((), ("--dry-run",)):
        done = inside("batch", "in", "--out", "in", "--files", "-", *extra, stdin=stdin)
        assert done.returncode == 2
        assert b"in/a.depth.png, the output for a.jpg, is an input" in done.stderr
    assert contents(inside, "in") == before
    beside = inside("batch", "in", "--out", "in", "--files", "-", stdin=b"b.png")
    assert beside.returncode == 0
    assert contents(inside, "in").keys() - before.keys() == {"b.depth.png", "manifest.jsonl"}


def test_a_missing_model_is_a_failure_and_leaves_nothing(cli: Cli) -> None:
    tree(cli, "a.png")
    done = cli("batch", "in", "--out", "out", "--model", "nowhere.onnx")
    assert done.returncode == 3
    assert not (cli.folder / "out").exists()


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


def test_warnings_name_their_input(inside: Cli) -> None:
    write_model(inside.models / "default", output__shift=80.0, output__max_m=200.0)
    tree(inside, "a.png")
    done = inside("batch", "in", "--out", "out")
    assert done.returncode == 0
    assert b"depthcli: warning: a.png: " in done.stderr
    assert "were saturated" in rows(inside, "out")["a.png"]["warnings"][0]


def test_a_folder_without_pictures(inside: Cli) -> None:
    (inside.folder / "in").mkdir()
    done = inside("batch", "in", "--out", "out")
    assert done.returncode == 0
    assert b"0 of 0 inputs done" in done.stdout
    assert contents(inside, "out") == {"manifest.jsonl": b""}


def test_a_folder_of_exr_alone_names_what_reads_them(inside: Cli) -> None:
    (inside.folder / "in").mkdir()
    for number in range(2):
        (inside.folder / "in" / f"plate.{number}.exr").touch()
    done = inside("batch", "in", "--out", "out")
    assert done.returncode == 1
    (line,) = done.stderr.decode().splitlines()
    assert line.endswith(
        "no picture or video in in: 2 files skipped (2 .exr); 'depthcli video' reads a sequence of "
        "EXR, 'predict' and 'batch --files' single ones"
    )


@pytest.mark.usefixtures("without_heif")
def test_a_folder_of_which_nothing_can_be_read_is_a_failure(inside: Cli) -> None:
    for name in ("a.HEIC", "b.heic", "notes.txt"):
        (inside.folder / "in").mkdir(exist_ok=True)
        (inside.folder / "in" / name).touch()
    done = inside("batch", "in", "--out", "out")
    assert (done.returncode, done.stdout) == (1, b"")
    (line,) = done.stderr.decode().splitlines()
    assert "no picture or video in in: 3 files skipped (2 .heic, 1 .txt); 2 pictures" in line
    assert line.endswith("pip install pillow-heif")
    assert not (inside.folder / "out").exists()


@pytest.mark.usefixtures("without_heif")
def test_pictures_that_are_not_read_are_named_among_others(inside: Cli) -> None:
    tree(inside, "a.png")
    (inside.folder / "in" / "b.heic").touch()
    done = inside("batch", "in", "--out", "out")
    assert done.returncode == 0
    (line,) = done.stderr.decode().splitlines()
    assert "warning: 1 picture of a format that is not read (.heic) skipped" in line
    assert b"1 of 1 inputs done, 1 file skipped (1 .heic)" in done.stdout


def test_patterns_that_match_nothing_are_told(inside: Cli) -> None:
    tree(inside, "a.png", "b.jpg")
    nothing = inside("batch", "in", "--out", "out", "--include", "*.jpgg")
    assert (nothing.returncode, nothing.stdout) == (2, b"")
    assert b"--include and --exclude leave nothing of in: 2 files skipped (2 not" in nothing.stderr
    some = inside("batch", "in", "--out", "out", "--include", "*.jpgg", "--include", "*.png")
    assert some.returncode == 0
    assert b"warning: --include '*.jpgg' matches no picture or video" in some.stderr
    assert b"1 of 1 inputs done, 1 file skipped (1 not included)" in some.stdout


def test_its_own_outputs_are_no_inputs(inside: Cli) -> None:
    tree(inside, "a.png")
    picture(inside, "b.preview.png", synthetic_picture())  # another program's
    assert inside("predict", "in/a.png").returncode == 0
    for name in ("clip.depth.mkv", "clip.preview.mp4"):
        (inside.folder / "in" / name).touch()
    done = inside("batch", "in", "--out", "in/out")
    assert done.returncode == 0
    assert rows(inside, "in/out").keys() == {"a.png", "b.preview.png"}
    assert b"2 of 2 inputs done, 4 files skipped (4 written by depthcli)" in done.stdout
    names = sorted(contents(inside, "in"))
    listed = inside(
        "batch", "in", "--out", "elsewhere", "--files", "-", stdin="\n".join(names).encode()
    )
    assert b"out/a.depth.png" not in listed.stderr
    assert rows(inside, "elsewhere").keys() == {"a.png", "b.preview.png", "out/manifest.jsonl"}


def test_a_list_of_find_in_the_folder(inside: Cli) -> None:
    tree(inside, "a.png", "hall/b.png", "in/a.png")
    found = b"in/hall/b.png\nin/a.png\n./in/in/a.png\n"
    done = inside("batch", "in", "--out", "out", "--files", "-", stdin=found)
    assert (done.returncode, done.stderr) == (0, b"")
    assert rows(inside, "out").keys() == {"hall/b.png", "in/a.png", "a.png"}


def test_workers_threads_and_batch_size_change_no_byte(inside: Cli) -> None:
    for number in range(7):
        size = (48, 64) if number % 3 else (30, 40)
        picture(inside, f"{number}.png", synthetic_picture(*size) // (number + 1))
    ways = (("1", "1", "1"), ("3", "2", "1"), ("2", "1", "4"))
    outputs = []
    for workers, threads, size in ways:
        out = f"w{workers}b{size}"
        options = ("--workers", workers, "--threads", threads, "--batch-size", size)
        assert inside("batch", "in", "--out", out, *options).returncode == 0
        outputs.append({n: d for n, d in contents(inside, out).items() if n != "manifest.jsonl"})
    assert len(outputs[0]) == 7
    assert outputs[0] == outputs[1] == outputs[2]


def test_a_thin_strip_in_tiles_stops_no_other(inside: Cli) -> None:
    tree(inside, "a.png", "c.png")
    strip = np.full((2, 3000, 3), 90, np.uint8)
    assert cv2.imwrite(str(inside.folder / "in" / "b.png"), strip)
    done = inside("batch", "in", "--out", "out", "--tile", "300", "--workers", "1")
    assert done.returncode == 0, done.stderr
    assert (inside.folder / "out" / "b.depth.png").is_file()


def test_the_frames_of_a_damaged_video_are_all_in_the_manifest(inside: Cli) -> None:
    rng = np.random.default_rng(0)
    (inside.folder / "in").mkdir()
    frames = [rng.integers(0, 255, (48, 64, 3), dtype=np.uint8) for _ in range(40)]
    path = write_mp4(inside.folder / "in" / "clip.mp4", frames)
    data = bytearray(path.read_bytes())
    middle = len(data) // 2
    data[middle : middle + len(data) // 10] = bytes(len(data) // 10)
    path.write_bytes(data)
    done = inside("batch", "in", "--out", "out", "--format", "npy", "--json")
    assert done.returncode == 1
    (row,) = (json.loads(line) for line in done.stdout.splitlines())
    assert "cannot be decoded" in row["error"]
    written = {f"clip.depth.{number:06d}.npy" for number in range(40)}
    seen = {p.name for p in (inside.folder / "out").glob("*.npy")}
    assert {output["path"] for output in row["outputs"]} == seen < written


def test_an_error_that_nobody_foresaw_stops_no_other(
    cli: Cli, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = Pipeline._predict_batch

    def predict_batch(self: Pipeline, frames: list[Frame], *rest: Any) -> list[Prediction]:
        if any(frame.width == 7 for frame in frames):
            raise ValueError("seven")
        return whole(self, frames, *rest)

    monkeypatch.setattr(Pipeline, "_predict_batch", predict_batch)
    monkeypatch.setenv("DEPTHCLI_MODELS", str(cli.models))
    tree(cli, "a.png", "z.png")
    picture(cli, "seven.png", np.zeros((5, 7), np.uint8))
    folders = (str(cli.folder / "in"), "--out", str(cli.folder / "out"))
    assert main(["batch", *folders, "--workers", "1", "--batch-size", "3"]) == 1
    found = rows(cli, "out")
    assert {name: row["status"] for name, row in found.items()} == {
        **dict.fromkeys(("a.png", "z.png"), "ok"),
        "seven.png": "failed",
    }
    assert found["seven.png"]["error"] == "unexpected ValueError: seven"


def test_a_shard_of_a_list_in_a_table(inside: Cli) -> None:
    tree(inside, "a.png", "hall/b.png")
    (inside.folder / "list.csv").write_text("n,uri\n1,a.png\n2,hall/b.png\n")
    words = ("batch", "in", "--out", "out", "--files", "list.csv", "--column", "uri")
    assert inside(*words, "--shard", "2/2").returncode == 0
    assert contents(inside, "out").keys() == {"hall/b.depth.png", "manifest-2-of-2.jsonl"}
    assert b"keep 0 already done" in inside(*words, "--shard", "1/2", "--dry-run").stderr
    assert inside(*words, "--shard", "1/2").returncode == 0
    assert b"2 already done" in inside(*words).stdout


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (("--shard", "0/4"), b"--shard 0/4 is not I/N"),
        (("--files", "-", "--column", "x"), b"--column is for a Parquet or CSV file"),
        (("--column", "x"), b"--column is for a Parquet or CSV file"),
        (("--files", "in/a.csv", "--column", "x"), b"no column 'x'; its columns are path"),
        (("--ray-address", "local"), b"--ray-address is for --engine ray"),
        (("--gpus-per-worker", "1"), b"--gpus-per-worker is for --engine ray"),
        (("--engine", "ray", "--ray-address", "x"), b"--ray-address x is not HOST:PORT"),
    ],
)
def test_what_names_no_part_no_column_and_no_cluster(
    inside: Cli, words: tuple[str, ...], line: bytes
) -> None:
    tree(inside, "a.png")
    (inside.folder / "in" / "a.csv").write_text("path\na.png\n")
    done = inside("batch", "in", "--out", "out", *words)
    assert done.returncode == 2
    assert line in done.stderr
    assert done.stderr.count(b"\n") == 1


def test_a_single_file_is_sent_to_the_commands_for_files(inside: Cli) -> None:
    write_picture(inside.folder / "room.png")
    done = inside("batch", "room.png", "--out", "out")
    assert done.returncode == 2
    assert b"'depthcli predict' and 'depthcli video' take files" in done.stderr
