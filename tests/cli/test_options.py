"""Options of the commands: groups, details, profiles, errors."""

import json
from pathlib import Path

import numpy as np
import pytest
from helpers.command_line import Cli
from helpers.tiny import write_image, write_model
from helpers.videos import flat_frames, write_video

from depthcli.cli.app import main
from depthcli.cli.table import COMMANDS, plain_command
from depthcli.core.options import Colormap, Near
from depthcli.io.depth.read import read_metadata
from depthcli.io.formats.table import PreviewOptions

NORMALIZED = "png16 with --png-normalize or --png-inverse"
USUAL = 12
"""Options of the first section of the help, at most."""


@pytest.mark.parametrize("name", COMMANDS)
def test_options_are_few_in_the_first_section_and_have_one_name(name: str) -> None:
    pending = [plain_command(name)]
    while pending:
        command = pending.pop()
        pending += getattr(command, "commands", {}).values()
        options = [p for p in command.params if p.param_type_name == "option"]
        first = [p for p in options if p.rich_help_panel in {None, "Options"}]
        assert len(first) <= USUAL, [p.name for p in first]
        for parameter in options:
            assert "--output" not in parameter.opts
            assert ("-o" in parameter.opts) == ("--out" in parameter.opts)


@pytest.mark.parametrize(
    ("words", "option", "used_by"),
    [
        (("predict", "room.png", "-o", "x.png", "--colormap", "turbo"), "--colormap", "preview"),
        (("predict", "room.png", "-o", "x.ply", "--half"), "--half", "exr, normals-exr"),
        (("predict", "room.png", "-o", "x.png", "--vmin", "1"), "--vmin", f"preview, {NORMALIZED}"),
        (("batch", "in", "-o", "out", "--legend"), "--legend", "preview"),
        (
            ("video", "clip.avi", "-o", "d.mkv", "--no-audio"),
            "--no-audio",
            "mp4, webm, mov, stereo",
        ),
        (
            ("convert", "a.npy", "b.exr", "--png-scale", "256"),
            "--png-scale",
            "png16, pgm, json, mkv",
        ),
    ],
)
def test_option_without_effect_is_a_warning(
    words: tuple[str, ...], option: str, used_by: str, inside: Cli
) -> None:
    write_image(inside.folder / "room.png")
    write_image(inside.folder / "in" / "room.png")
    write_video(inside.folder / "clip.avi", flat_frames(range(2)))
    assert inside("predict", "room.png", "-o", "a.npy").returncode == 0
    done = inside(*words, code=0)
    warnings = done.stderr.decode().splitlines()
    assert f"depthcli: warning: {option} has no effect: it is for {used_by}" in warnings
    assert not inside(*words, "--quiet", code=0).stderr


def test_extrinsics_are_refused_with_known_depth_in_pixels(inside: Cli) -> None:
    (inside.folder / "known.csv").write_text("x,y,depth_m\n5,4,2\n")
    done = inside("predict", "a.png", "--anchors", "known.csv", "--extrinsics", "pose.txt", code=2)
    assert b"--extrinsics is for clouds: leave it out, or name one in --anchors" in done.stderr


def test_normalized_png_has_the_range_of_every_command(inside: Cli) -> None:
    write_image(inside.folder / "in" / "room.png")
    write_video(inside.folder / "clip.avi", flat_frames(range(2)))
    options = ("--format", "png16", "--png-inverse", "--vmin", "0.5", "--vmax", "8")
    for words in (
        ("predict", "in/room.png", "-o", "p/"),
        ("batch", "in", "-o", "b"),
        ("video", "clip.avi", "-o", "v/"),
        ("convert", "b/room.depth.png", "c/room.png"),
    ):
        done = inside(*words, *options, code=0)
        assert "effect" not in done.stderr.decode()
        assert "range of each frame" not in done.stderr.decode()
    written = [path for folder in "pbvc" for path in (inside.folder / folder).glob("*.png")]
    assert len(written) == 5
    assert {read_metadata(path)["range"] for path in written} == {"0.125 2"}
    done = inside("video", "clip.avi", "-o", "w/", *options[:3], code=0)
    assert "give --vmin and --vmax" in done.stderr.decode()


def test_option_of_a_profile_may_have_no_effect(inside: Cli) -> None:
    write_image(inside.folder / "room.png")
    (inside.folder / "depthcli.toml").write_text("[own]\ncolormap = 'turbo'\nhalf = true\n")
    assert not inside("predict", "room.png", "-o", "x.png", "--profile", "own", code=0).stderr


def test_range_of_a_normalized_video_has_an_effect(inside: Cli) -> None:
    relative = {"output__kind": "relative", "output__min_m": None, "output__max_m": None}
    write_model(inside.models / "default", **relative)
    write_video(inside.folder / "clip.avi", flat_frames(range(3)))
    done = inside("video", "clip.avi", "-o", "d.mkv", "--vmin", "1", "--vmax", "2", code=0)
    assert b"no effect" not in done.stderr


@pytest.mark.parametrize(
    ("colormap", "near", "chosen"),
    [
        (None, None, ("inferno", "warm")),
        (None, Near.WARM, ("inferno", "warm")),
        (None, Near.WHITE, ("gray", "white")),
        (Colormap.GRAY, Near.BLACK, ("gray", "black")),
        (Colormap.INFERNO, Near.BLACK, ("inferno", "black")),
    ],
)
def test_near_white_and_black_select_gray(
    colormap: Colormap | None, near: Near | None, chosen: tuple[str, str]
) -> None:
    assert PreviewOptions(colormap=colormap, near=near).palette == chosen


@pytest.mark.parametrize(
    ("words", "meant"),
    [
        (["predict", "a.png", "--device", "cuda"], "--provider"),
        (["batch", "in", "--out", "out", "--gpu"], "--provider"),
        (["train", "cut", "--gpu"], "--accelerator"),
    ],
)
def test_device_names_of_other_programs_lead_to_the_option(
    words: list[str], meant: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(words) == 2
    assert meant in capsys.readouterr().err


def test_unknown_suffix_of_out_is_told_with_known_ones(capsys: pytest.CaptureFixture[str]) -> None:
    main(["predict", "a.png", "-o", "a.obj"])
    problem = capsys.readouterr().err
    assert all(suffix in problem for suffix in (".obj", ".png", ".exr", ".npy", ".ply"))


def test_tiles_change_the_map_but_not_its_size(inside: Cli) -> None:
    write_image(inside.folder / "room.png")
    for name, options in (("a", ()), ("b", ("--tile", "auto")), ("c", ("--upsample", "bilinear"))):
        assert inside("predict", "room.png", "-o", f"{name}.npy", *options).returncode == 0
    maps = [np.load(inside.folder / f"{name}.npy") for name in "abc"]
    assert {m.shape for m in maps} == {(48, 64)}
    assert all(np.abs(maps[0] - other).max() > 1e-3 for other in maps[1:])
    inside("predict", "room.png", "-o", "d.npy", "--tile", "9999", code=0)
    assert np.array_equal(np.load(inside.folder / "d.npy"), maps[0])


TEXT = """
[robot]
hfov = 81.0
png-scale = 256
format = ["png16", "preview", "mp4"]
legend = true
fps = "25"

[one]
format = "exr"
"""


@pytest.fixture
def folder(inside: Cli) -> Path:
    """An image beside two profiles."""
    write_image(inside.folder / "room.png")
    (inside.folder / "depthcli.toml").write_text(TEXT)
    return inside.folder


def test_profile_gives_options_to_the_command(inside: Cli, folder: Path) -> None:
    done = inside("predict", "room.png", "--profile", "robot", "--json", code=0)
    facts = json.loads(done.stdout)
    assert facts["outputs"] == ["room.depth.png", "room.preview.png"]
    assert "81.0°" in facts["camera"]
    assert float(read_metadata(folder / "room.depth.png")["scale"]) == 256


@pytest.mark.parametrize(
    ("words", "scale"),
    [
        (("-o", "x.exr"), None),
        (("-o", "x.png", "--png-scale", "5000"), "5000"),
        (("-o", "x.png", "--focal-px", "60"), "256"),
        (("-o", "x.png", "--png-normalize"), None),
    ],
)
def test_options_win_over_profiles(
    inside: Cli, folder: Path, words: tuple[str, ...], scale: str | None
) -> None:
    inside("predict", "room.png", "--profile", "robot", *words, code=0)
    assert (folder / words[1]).exists()
    if scale:
        assert float(read_metadata(folder / words[1])["scale"]) == float(scale)


def test_project_precedes_the_user(inside: Cli, folder: Path) -> None:
    user = folder.parent / "home" / "depthcli" / "depthcli.toml"
    user.parent.mkdir(parents=True)
    user.write_text("[robot]\nhfov = 50\n[mine]\nhfov = 60\n")
    for name, camera in (("robot", "81.0°"), ("mine", "60.0°")):
        done = inside("predict", "room.png", "--profile", name, "--json", code=0)
        assert camera in json.loads(done.stdout)["camera"]


def test_repeatable_option_takes_one_value(inside: Cli, folder: Path) -> None:
    inside("predict", "room.png", "--profile", "one", code=0)
    assert (folder / "room.depth.exr").exists()


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (b"[robot]\nhfovv = 3\n", "no option named 'hfovv'; did you mean 'hfov'?"),
        (b"\xef\xbb\xbf[robot]\nhfov = 300\n", "--hfov"),  # hukkin/tomli#304
        (b"[robot]\nhfov = true\n", "hfov takes a value, not true or false"),
        (b"[robot]\nhfov = 80\nfocal-px = 70\n", "not both"),
        (b"[robot]\nout = 'x.png'\n", "no option named 'out'"),
        (b"[robot\n", "depthcli.toml is not TOML"),
        (b"\xff\xfe", "depthcli.toml"),
        (b"hfov = 80\n", "no profile named 'robot'; there are: hfov"),
        (b"[other]\nhfov = 80\n", "no profile named 'robot'; there are: other"),
        (b"", "no profile named 'robot'; there are: none"),
    ],
)
def test_wrong_profile_is_a_usage_error(
    inside: Cli, folder: Path, text: bytes, reason: str
) -> None:
    (folder / "depthcli.toml").write_bytes(text)
    done = inside("predict", "room.png", "--profile", "robot", code=2)
    assert reason in done.stderr.decode()
    assert not (folder / "room.depth.png").exists()
