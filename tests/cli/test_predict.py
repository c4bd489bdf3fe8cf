"""``depthcli predict``, run from the built wheel as a user runs it."""

import json
import os
import signal
import subprocess
import time
from io import BytesIO
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from helpers.command_line import Cli
from helpers.folders import here
from helpers.tiny import fixed_inside, synthetic_image, write_image, write_model

from depthcli.io.depth.read import read_stored_depth
from depthcli.io.formats.table import FORMATS

EXPECTED_M = 1 + 8 / 255 * synthetic_image().max(axis=-1).astype(np.float32)


def room(cli: Cli, name: str = "room.png") -> Path:
    """The synthetic image in the command's folder."""
    return write_image(cli.folder / name)


def decode(path: Path) -> np.ndarray[Any, Any]:
    pixels = cv2.imdecode(np.frombuffer(path.read_bytes(), np.uint8), cv2.IMREAD_UNCHANGED)
    assert pixels is not None
    return pixels


def error_lines(done: subprocess.CompletedProcess[bytes]) -> list[str]:
    return done.stderr.decode().splitlines()


def test_without_options_a_png_and_a_preview_beside_the_image(cli: Cli) -> None:
    room(cli)
    done = cli("predict", "room.png")
    assert (done.returncode, done.stderr) == (0, b"")
    assert here(cli) == {"room.png", "room.depth.png", "room.preview.png"}
    millimetres = decode(cli.folder / "room.depth.png")
    assert millimetres.dtype == np.uint16
    assert millimetres.shape == (48, 64)
    np.testing.assert_allclose(millimetres[:, 6:-6] / 1000, EXPECTED_M[:, 6:-6], atol=0.2)
    assert decode(cli.folder / "room.preview.png").shape == (48, 64, 3)
    line = done.stdout.decode()
    assert "room.depth.png, room.preview.png" in line
    low, median, high = (f(millimetres) / 1000 for f in (np.min, np.median, np.max))
    assert f"min {low:.3f}, median {median:.3f}, max {high:.3f} m" in line


def test_its_own_outputs_are_no_inputs(inside: Cli) -> None:
    room(inside)
    assert inside("predict", "room.png").returncode == 0
    before = here(inside)
    again = inside("predict", *sorted(before), code=0)
    assert here(inside) == before
    assert error_lines(again) == [
        f"depthcli: warning: {name} was written by depthcli; skipped"
        for name in ("room.depth.png", "room.preview.png")
    ]
    alone = inside("predict", "room.depth.png", code=2)
    assert b"room.depth.png was written by depthcli; name an image" in alone.stderr


@pytest.mark.parametrize("suffix", [".png", ".exr", ".npy"])
def test_the_output_s_suffix_chooses_the_format(inside: Cli, suffix: str) -> None:
    room(inside)
    assert inside("predict", "room.png", "-o", f"depth{suffix}").returncode == 0
    assert here(inside) == {"room.png", f"depth{suffix}"}
    depth = read_stored_depth(inside.folder / f"depth{suffix}").displayed
    np.testing.assert_allclose(depth.values[:, 6:-6], EXPECTED_M[:, 6:-6], atol=0.2)


def test_formats_are_repeatable_and_a_folder_takes_them(inside: Cli) -> None:
    room(inside)
    write_model(inside.models / "default", error_model="tiny")
    write_model(inside.models / "tiny")
    formats = [word for name in FORMATS for word in ("--format", name)]
    assert inside("predict", "room.png", "-o", "new/deep/", *formats).returncode == 0
    names = {f"new/deep/room{facts.suffix}" for facts in FORMATS.values()}
    assert here(inside) == {"room.png", *names}


def test_a_sidecar_leaves_the_output_s_name_alone(inside: Cli) -> None:
    room(inside)
    assert inside("predict", "room.png", "-o", "depth.exr", "--sidecar").returncode == 0
    assert here(inside) == {"room.png", "depth.exr", "depth.json"}
    sidecar = json.loads((inside.folder / "depth.json").read_text())
    assert (sidecar["kind"], sidecar["unit"], sidecar["model"]) == ("metric", "m", "tiny")


def test_options_of_formats_arrive(inside: Cli) -> None:
    room(inside)
    options = ("--colormap", "turbo", "--vmin", "2", "--vmax", "4", "--legend", "--side-by-side")
    inside("predict", "room.png", "-o", "drawn/", "--format", "preview", *options, code=0)
    assert decode(inside.folder / "drawn/room.preview.png").shape[1] > 2 * 64
    assert inside("predict", "room.png", "-o", "n.png", "--png-normalize").returncode == 0
    assert decode(inside.folder / "n.png").max() == 65535
    inside("predict", "room.png", "-o", "y.exr", "--exr-channel", "Y", "--half", code=0)
    import OpenEXR  # noqa: PLC0415

    channels = OpenEXR.File(str(inside.folder / "y.exr")).channels()
    assert {name: c.pixels.dtype for name, c in channels.items()} == {"Y": np.float16}


def test_from_stdin_to_stdout(cli: Cli) -> None:
    data = room(cli).read_bytes()
    done = cli("predict", "-", "-o", "-", "--format", "npy", stdin=data, code=0)
    depth = np.load(BytesIO(done.stdout))
    np.testing.assert_allclose(depth[:, 6:-6], EXPECTED_M[:, 6:-6], atol=0.2)
    assert b"min" in done.stderr
    assert here(cli) == {"room.png"}


def test_json_is_one_object_a_line(cli: Cli) -> None:
    room(cli)
    (cli.folder / "bad.jpg").write_bytes(b"no image")
    done = cli("predict", "room.png", "bad.jpg", "--json", "--provider", "cpu", code=1)
    fine, failed = map(json.loads, done.stdout.splitlines())
    assert fine["status"] == "ok"
    assert fine["outputs"] == ["room.depth.png", "room.preview.png"]
    assert (fine["model"], fine["provider"], fine["unit"]) == ("tiny", "cpu", "m")
    assert (
        fine["model_sha256"] == json.loads((cli.models / "default/card.json").read_text())["sha256"]
    )
    depth = decode(cli.folder / "room.depth.png") / 1000
    assert fine["min"] == pytest.approx(depth.min(), abs=1e-3)
    assert fine["median"] == pytest.approx(np.median(depth), abs=1e-3)
    assert fine["max"] == pytest.approx(depth.max(), abs=1e-3)
    assert 0 < fine["seconds"] < 60
    assert fine["warnings"] == []
    assert (failed["input"], failed["status"]) == ("bad.jpg", "failed")
    assert "bad.jpg" in failed["error"]


def test_warnings_are_told(inside: Cli) -> None:
    room(inside)
    words = ("predict", "room.png", "-o", "a.png", "--png-scale", "20000")
    plain, runs = inside(*words, code=0), inside(*words, "--json", code=0)
    assert "saturated" in error_lines(plain)[0]
    assert "saturated" in json.loads(runs.stdout)["warnings"][0]
    assert decode(inside.folder / "a.png").max() == 65535


def test_a_bad_input_never_stops_the_others(inside: Cli) -> None:
    room(inside, "a.png"), room(inside, "z.png")
    image = (inside.folder / "a.png").read_bytes()
    (inside.folder / "empty.png").touch()
    (inside.folder / "cut.png").write_bytes(image[: len(image) // 2])
    (inside.folder / "text.jpg").write_text("no image")
    (inside.folder / "folder.png").mkdir()
    (inside.folder / "link.png").symlink_to("nowhere")
    bad = ["empty.png", "cut.png", "text.jpg", "folder.png", "link.png", "missing.png"]
    done = inside("predict", "a.png", *bad, "z.png", "-o", "out/", "--format", "npy", code=1)
    *lines, summary = error_lines(done)
    assert len(lines) == len(bad)
    for name, line in zip(bad, lines, strict=True):
        assert line.startswith(f"depthcli: error: {name}")
    assert "batch" in lines[bad.index("folder.png")]
    assert summary == f"6 of 8 inputs failed: {', '.join(bad)}"
    outputs = {name for name in here(inside) if name.startswith("out/")}
    assert outputs == {"out/a.depth.npy", "out/z.depth.npy"}


def test_an_image_that_the_network_fails_on_stops_no_other(inside: Cli) -> None:
    # A reshape to a fixed size fails on images of other aspect ratios.
    write_model(inside.models / "default", fixed_inside(), input__fit="keep-aspect")
    write_image(inside.folder / "wide.png", np.zeros((10, 300), np.uint8))
    write_image(inside.folder / "a.png")
    done = inside("predict", "wide.png", "a.png", "--json", code=1)
    assert [json.loads(line)["status"] for line in done.stdout.splitlines()] == ["failed", "ok"]
    assert (inside.folder / "a.depth.png").is_file()
    write_model(inside.models / "default", fixed_inside(5))
    done = inside("predict", "wide.png", "a.png", code=3)
    (line,) = error_lines(done)
    assert "model.onnx" in line


@pytest.mark.parametrize(
    "words",
    [
        ("--focal-px", "500", "--hfov", "60"),
        ("--focal-px", "0"),
        ("--focal-px", "nan"),
        ("--hfov", "180"),
        ("--png-scale", "-1"),
        ("--png-scale", "5000", "--png-normalize"),
        ("--vmin", "inf"),
        ("--vmin", "3", "--vmax", "2"),
        *(
            ("--anchor", word)
            for word in ("1,2", "1,2,0", "-1,2,3", "a,b,c", "1,2,3,4", "1.5,2,3", "1,2,nan")
        ),
        *(("--tile", word) for word in ("0", "-5", "half", "1.5", "", "9" * 5000)),
        *(("--centre-px", word) for word in ("3", "nan,3")),
        ("--calibration", "a.yaml", "--centre-px", "3,4"),
        *(("--rectified",), ("--undistort",)),
        ("-", "-"),
        ("-o", "/dev/stdout", "--format", "npy"),
        ("-o", "a.obj"),
        ("b.png", "-o", "one.png"),
    ],
)
def test_options_that_do_not_fit_write_nothing(inside: Cli, words: tuple[str, ...]) -> None:
    room(inside), room(inside, "b.png")
    done = inside("predict", "room.png", *words, code=2)
    assert len(error_lines(done)) == 1
    assert here(inside) == {"room.png", "b.png"}


@pytest.mark.parametrize("fault", ["missing", "checksum", "no card"])
def test_a_model_that_cannot_be_used_is_exit_code_3(inside: Cli, fault: str) -> None:
    room(inside)
    folder = inside.models / "default"
    if fault == "missing":
        words = ("--model", "nothing")
    else:
        words = ()
        data = (folder / "model.onnx").read_bytes()
        (folder / "model.onnx").write_bytes(data[:-1] + bytes([data[-1] ^ 1]))
    if fault == "no card":
        words = ("--model", str(folder / "model.onnx"))
    done = inside("predict", "room.png", *words)
    assert (done.returncode, done.stdout) == (3, b"")
    assert len(error_lines(done)) == 1
    assert here(inside) == {"room.png"}


def test_names_may_hold_any_byte(inside: Cli) -> None:
    image = room(inside).read_bytes()
    names = [b"line\nbreak.png", b"caf\xe9.png", "\u0434\u043e\u043c \U0001f3e0.png".encode()]
    for name in names:
        (inside.folder / os.fsdecode(name)).write_bytes(image)
    words = [os.fsdecode(name) for name in names]
    done = inside("predict", *words, "--format", "npy")
    assert (done.returncode, done.stderr) == (0, b"")
    assert len(done.stdout.splitlines()) == 3
    named = inside("predict", *words, "--format", "npy", "--json")
    assert [os.fsencode(json.loads(line)["input"]) for line in named.stdout.splitlines()] == names
    inside("predict", *words, "--format", "npy", PYTHONIOENCODING="ascii", code=0)
    inside("predict", *words, "--format", "html", code=0)
    outputs = {os.fsencode(name) for name in here(inside) if name.endswith(".npy")}
    assert outputs == {name.replace(b".png", b".depth.npy") for name in names}


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_an_interrupted_run_leaves_whole_files_only(cli: Cli, number: signal.Signals) -> None:
    images = [room(cli, f"{i:03}.png") for i in range(200)]
    formats = ("--format", "npy", "--format", "exr")
    process = cli.started("predict", *images, "-o", "out/", *formats)
    while not (cli.folder / "out/003.depth.npy").exists() and process.poll() is None:
        time.sleep(0.001)
    process.send_signal(number)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 128 + number
    assert b"Traceback" not in errors
    outputs = list((cli.folder / "out").iterdir())
    assert 3 < len(outputs) < 400
    for path in outputs:
        assert not path.name.startswith(".")
        assert read_stored_depth(path).displayed.values.shape == (48, 64)
