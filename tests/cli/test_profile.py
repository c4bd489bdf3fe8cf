"""``depthcli profile`` and ``--profile``."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from typing import TYPE_CHECKING

import av
import numpy as np
import pytest
from helpers.tiny import write_model
from helpers.videos import flat_frames, write_video
from hypothesis import given
from hypothesis import strategies as st

from depthcli.cli import shell
from depthcli.cli.profile_files import _toml, write_profile
from depthcli.cli.table import COMMANDS, PROFILE_COMMANDS
from depthcli.errors import OutputError

if TYPE_CHECKING:
    from helpers.command_line import Cli


class Home:
    """The command line with a settings folder of its own, whose model learned a camera."""

    def __init__(self, cli: Cli) -> None:
        write_model(cli.models / "default", camera={"hfov_deg": 90.0})
        self.cli = cli
        self.folder = cli.folder / "config" / "depthcli" / "profiles"

    def run(self, *words: str | Path) -> tuple[int, str, str]:
        """Exit code, standard output and standard error."""
        done = self.cli(*words, XDG_CONFIG_HOME=str(self.cli.folder / "config"))
        return done.returncode, done.stdout.decode(), done.stderr.decode()

    def write(self, name: str, text: str) -> None:
        """A profile as somebody writes it by hand."""
        self.folder.mkdir(parents=True, exist_ok=True)
        (self.folder / f"{name}.toml").write_text(text)


@pytest.fixture
def home(inside: Cli) -> Home:
    """The source's command line."""
    return Home(inside)


def told(stdout: str) -> dict[str, object]:
    """The one line of ``--json``."""
    (line,) = stdout.splitlines()
    found: dict[str, object] = json.loads(line)
    return found


def test_saved_options_are_used(cli: Cli, picture: Path) -> None:
    """By processes of their own, as a user runs them."""
    home = Home(cli)
    options = ("--hfov", "60", "--format", "npy", "--format", "exr", "--anchor", "3,4,2.5")
    code, out, _ = home.run("profile", "save", "kitti", *options, "--model", "default", "--half")
    assert (code, out.startswith("saved ")) == (0, True)
    code, out, _ = home.run("profile", "show", "kitti")
    assert tomllib.loads(out) == {
        "hfov": 60.0,
        "format": ["npy", "exr"],
        "anchor": ["3,4,2.5"],
        "model": "default",
        "half": True,
    }
    code, out, _ = home.run("predict", picture, "--profile", "kitti", "-o", "out/", "--json")
    facts = told(out)
    assert code == 0
    assert facts["focal_px"] == pytest.approx(64 / 2 / np.tan(np.radians(30)))
    assert facts["outputs"] == ["out/room.depth.npy", "out/room.depth.exr"]
    assert np.load(home.cli.folder / "out/room.depth.npy")[4, 3] == pytest.approx(2.5)


def test_what_is_given_wins(home: Home, picture: Path) -> None:
    home.write("p", 'hfov = 60\nformat = ["npy"]\npng-scale = 256\nanchor = ["3,4,2.5"]\n')
    run = ("predict", picture, "--profile", "p", "--json", "-o")
    same = told(home.run(*run, "out/", "--hfov", "60.0", "--anchor", "3,4,1")[1])
    wide = told(home.run(*run, "out/", "--hfov", "90")[1])
    pixels = told(home.run(*run, "out/", "--focal-px", "77")[1])
    assert (wide["focal_px"], pixels["focal_px"]) == pytest.approx((32, 77))
    assert np.load(home.cli.folder / "out/room.depth.npy")[4, 3] == pytest.approx(2.5)
    assert same["focal_px"] == pytest.approx(55.4256)
    assert told(home.run(*run, "x.exr")[1])["outputs"] == ["x.exr"]
    assert told(home.run(*run, "out/", "--format", "exr")[1])["outputs"] == ["out/room.depth.exr"]
    code, _, problem = home.run(*run, "y.png", "--png-normalize")
    assert (code, problem) == (0, "")


def test_the_place_of_the_option_does_not_matter(home: Home, picture: Path) -> None:
    home.write("p", "hfov = 60\n")
    for words in (("--profile", "p", "--focal-px", "77"), ("--focal-px", "77", "--profile", "p")):
        assert told(home.run("predict", *words, "--json", picture)[1])["focal_px"] == 77


def test_without_the_option_no_profile_is_read(home: Home, picture: Path) -> None:
    home.write("default", "hfov = 60\n")
    found = told(home.run("predict", picture, "--json")[1])["focal_px"]
    assert found == pytest.approx(32)  # the card's own camera


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("hfovv = 60", "no option named 'hfovv'; did you mean 'hfov'?"),
        ("output = 'x.png'", "no option named 'output'"),
        ("debug = true", "no option named 'debug'"),
        ("profile = 'q'", "no option named 'profile'"),
        ("focal_px = 60", "did you mean 'focal-px'?"),
        ("hfov = 300", "hfov = 300: must be an angle from 0.1 to 179.9"),
        ("hfov = 'wide'", "hfov = 'wide'"),
        ("colormap = 'jet'", "'jet' is not one of"),
        ("format = ['png16', 'jpg']", "'jpg' is not one of"),
        ("threads = 0", "threads = 0"),
        ("hfov =", "is not TOML"),
        ("[camera]\nhfov = 60", "camera must be text, a number"),
        ("hfov = [1, [2]]", "hfov must be text, a number"),
        ("anchor = [1979-05-27]", "anchor must be text, a number"),
    ],
)
def test_what_is_wrong_in_a_profile_is_one_line(
    home: Home, picture: Path, text: str, problem: str
) -> None:
    home.write("p", text)
    code, out, err = home.run("predict", picture, "--profile", "p")
    (line,) = err.splitlines()
    assert (code, out) == (2, "")
    assert problem in line
    assert "'p'" in line or "p.toml" in line
    assert [p.name for p in picture.parent.iterdir()] == ["room.png"]


def test_a_profile_that_is_not_there_names_those_that_are(home: Home, picture: Path) -> None:
    home.write("kitti", "hfov = 60")
    code, _, err = home.run("predict", picture, "--profile", "kity")
    assert code == 2
    assert "no profile named 'kity'; there are: kitti" in err


def test_a_profile_can_be_a_file(home: Home, picture: Path) -> None:
    (home.cli.folder / "mine.toml").write_text("focal-px = 77\n")
    found = told(home.run("predict", picture, "--profile", "mine.toml", "--json")[1])
    assert found["focal_px"] == 77


@pytest.mark.parametrize(
    ("words", "problem"),
    [
        (("save", "p"), "give the options to save"),
        (("save", "../p", "--half"), "is not a valid profile name"),
        (("save", "p", "--hfov", "300"), "an angle from 0.1 to 179.9"),
        (("save", "p", "--format", "jpg"), "'jpg' is not one of"),
        (("save", "p", "--output", "x.png"), "--output"),
        (("save", "there", "--half"), "already exists"),
        (("show", "nothing"), "no profile named 'nothing'"),
        (("remove", "nothing"), "no profile named 'nothing'"),
    ],
)
def test_what_is_wrong_on_the_command_line_is_one_line(
    home: Home, words: tuple[str, ...], problem: str
) -> None:
    home.write("there", "hfov = 60\n")
    code, out, err = home.run("profile", *words)
    (line,) = err.splitlines()
    assert (code, out) == (2, "")
    assert problem in line
    assert [p.name for p in home.folder.iterdir()] == ["there.toml"]
    assert (home.folder / "there.toml").read_text() == "hfov = 60\n"


def test_list_force_and_remove(home: Home) -> None:
    code, out, err = home.run("profile")
    assert (code, out) == (0, "")
    assert "'depthcli profile save NAME'" in err
    assert home.run("profile", "list", "--json") == (0, "", "")
    home.run("profile", "save", "b", "--half")
    home.run("profile", "save", "a", "--hfov", "60")
    home.run("profile", "save", "a", "--hfov", "70", "--force")
    assert home.run("profile", "list") == (0, "a: hfov = 70.0\nb: half = true\n", "")
    assert home.run("profile")[1] == home.run("profile", "list")[1]
    rows = [json.loads(line) for line in home.run("profile", "list", "--json")[1].splitlines()]
    assert [(row["name"], row["options"]) for row in rows] == [
        ("a", {"hfov": 70.0}),
        ("b", {"half": True}),
    ]
    assert home.run("profile", "remove", "a", "c")[0] == 2
    assert len(list(home.folder.iterdir())) == 2
    code, out, _ = home.run("profile", "remove", "a", "b")
    assert (code, out.count("removed")) == (0, 2)
    assert not list(home.folder.iterdir())


def test_a_model_s_path_is_found_from_everywhere(home: Home, picture: Path) -> None:
    write_model(home.cli.folder / "here" / "mine", name="mine")
    home.run("profile", "save", "p", "--model", "here/mine")
    values = tomllib.loads((home.folder / "p.toml").read_text())
    assert Path(str(values["model"])) == home.cli.folder / "here" / "mine"
    assert told(home.run("predict", picture, "--profile", "p", "--json")[1])["model"] == "mine"


def test_a_model_folder_named_without_a_slash_is_found_from_everywhere(home: Home) -> None:
    write_model(home.cli.folder / "mine", name="mine")
    home.run("profile", "save", "p", "--model", "mine")
    home.run("profile", "save", "q", "--model", "default")
    saved = [tomllib.loads((home.folder / f"{name}.toml").read_text()) for name in "pq"]
    assert saved == [{"model": str(home.cli.folder / "mine")}, {"model": "default"}]


def test_formats_of_other_commands_are_ignored(home: Home, picture: Path) -> None:
    write_video(home.cli.folder / "clip.avi", flat_frames(range(3)))
    home.write("p", 'format = ["png16", "preview", "mp4"]')
    assert home.run("predict", picture, "--profile", "p")[0] == 0
    names = {path.name for path in picture.parent.iterdir()}
    assert names == {"room.png", "room.depth.png", "room.preview.png"}
    assert home.run("video", "clip.avi", "--profile", "p")[0] == 0
    names = {path.name for path in home.cli.folder.glob("clip.*")}
    assert names == {"clip.avi", "clip.preview.mp4", *(f"clip.depth.{i:06}.png" for i in range(3))}
    home.write("q", 'format = "ply"')
    assert home.run("video", "clip.avi", "--profile", "q")[0] == 0
    assert (home.cli.folder / "clip.depth.mkv").is_file()
    home.write("r", 'format = ["png16", "prn"]')
    code, _, err = home.run("video", "clip.avi", "--profile", "r")
    assert (code, "'prn'" in err) == (2, True)


@pytest.mark.parametrize("name", [name for name in COMMANDS if name in PROFILE_COMMANDS])
def test_every_such_command_takes_profiles_and_its_options_are_saved(name: str) -> None:
    command = shell.load_command(name)
    saved = {word for p in shell.load_command("profile").commands["save"].params for word in p.opts}
    assert any("--profile" in p.opts for p in command.params)
    left_out = {"--out", "--output", "--profile", "--debug", "--help"}
    for parameter in command.params:
        words = {word for word in parameter.opts if word.startswith("--")}
        assert not words or words & left_out or words & saved, words


def test_an_option_of_another_command_is_passed_over(home: Home, picture: Path) -> None:
    def keys(name: str) -> set[str]:
        params = shell.load_command(name).params
        return {word for p in params for word in p.opts if word.startswith("--")}

    others = set().union(*(keys(name) for name in PROFILE_COMMANDS & COMMANDS.keys() - {"predict"}))
    only = sorted(others - keys("predict") - {"--out"})
    if not only:
        pytest.skip("predict is the only such command")
    home.write("p", f"focal-px = 77\n{only[0].removeprefix('--')} = 1\n")
    assert told(home.run("predict", picture, "--profile", "p", "--json")[1])["focal_px"] == 77


@given(
    st.dictionaries(
        st.from_regex(r"[a-z][a-z-]{0,9}", fullmatch=True),
        st.one_of(
            st.text(st.characters(exclude_categories=["Cs"])),
            st.integers(-(2**53), 2**53),
            st.floats(allow_nan=False, allow_infinity=False),
            st.booleans(),
            st.lists(st.text(st.characters(exclude_categories=["Cs"]))),
        ),
    )
)
def test_what_is_saved_is_read_back(values: dict[str, object]) -> None:
    text = "".join(f"{key} = {_toml(value)}\n" for key, value in values.items())  # type: ignore[arg-type]
    assert tomllib.loads(text) == values


@pytest.mark.parametrize(
    ("words", "problem"),
    [
        (("--tile", "abc"), "--tile is auto or a width"),
        (("--anchor", "foo"), "'foo'"),
        (("--start", "foo"), "--start 'foo'"),
        (("--fps", "foo"), "--fps 'foo'"),
        (("--start", "3", "--end", "2"), "not after --start"),
        (("--provider", "nosuch"), "no provider named 'nosuch'"),
        (("--provider", "cuda", "--provider-option", "a"), "not KEY=VALUE"),
        (("--focal-px", "5", "--hfov", "60"), "--focal-px or --hfov"),
        (("--png-scale", "5", "--png-normalize"), "--png-scale or --png-normalize"),
        (("--vmin", "5", "--vmax", "5"), "--vmin and --vmax"),
    ],
)
def test_what_no_command_would_take_is_not_saved(
    home: Home, words: tuple[str, ...], problem: str
) -> None:
    code, out, err = home.run("profile", "save", "p", *words)
    (line,) = err.splitlines()
    assert (code, out) == (2, "")
    assert problem in line
    assert home.run("profile", "list", "--json")[1] == ""


def test_a_profile_for_sequences_serves_videos_too(home: Home) -> None:
    write_video(home.cli.folder / "clip.avi", flat_frames(range(3)))
    options = ("--fps", "24", "--codec", "prores", "--white-level", "4095", "--format", "mp4")
    assert home.run("profile", "save", "vfx", *options)[0] == 0
    code, out, err = home.run("video", "clip.avi", "--profile", "vfx", "--json")
    assert (code, told(out)["fps"], err) == (0, "25/1", "")
    with av.open(str(home.cli.folder / "clip.preview.mp4")) as preview:
        assert preview.streams.video[0].codec_context.name == "h264"
    words = ("video", "clip.avi", "--profile", "vfx", "--out", "a.mov")
    assert home.run(*words)[0] == 0
    with av.open(str(home.cli.folder / "a.mov")) as preview:
        assert preview.streams.video[0].codec_context.name == "prores"
    for option, value in (("--fps", "24"), ("--codec", "prores"), ("--white-level", "4095")):
        code, _, err = home.run("video", "clip.avi", "--profile", "vfx", option, value)
        assert (code, option in err) == (2, True)


def test_a_folder_with_a_dot_in_its_name_says_no_format(home: Home, picture: Path) -> None:
    home.run("profile", "save", "p", "--format", "npy")
    (home.cli.folder / "in").mkdir()
    (home.cli.folder / "in" / "a.png").write_bytes(picture.read_bytes())
    for name in ("depth.v2", "more.png"):
        assert home.run("batch", "in", "--out", name, "--profile", "p")[0] == 0
        assert (home.cli.folder / name / "a.depth.npy").is_file()
    (home.cli.folder / "out.2024").mkdir()
    assert home.run("predict", picture, "-o", "out.2024", "--profile", "p")[0] == 0
    assert [p.name for p in (home.cli.folder / "out.2024").iterdir()] == ["room.depth.npy"]


def test_a_model_file_is_found_from_every_folder(home: Home) -> None:
    write_model(home.cli.folder / "mine")
    (home.cli.folder / "mine" / "model.onnx").rename(home.cli.folder / "m.onnx")
    (home.cli.folder / "mine" / "card.json").rename(home.cli.folder / "m.card.json")
    assert home.run("profile", "save", "p", "--model", "m.onnx")[0] == 0
    saved = tomllib.loads((home.folder / "p.toml").read_text())
    assert saved == {"model": str(home.cli.folder / "m.onnx")}


def test_a_place_that_takes_no_profile_is_an_error_that_says_how_to_name_another(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "depthcli").write_text("a file")
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    with pytest.raises(OutputError, match="Not a directory; set XDG_CONFIG_HOME"):
        write_profile("p", {"half": True}, force=False)


def test_a_damaged_profile_hides_no_other(home: Home) -> None:
    home.write("a", "hfov =")
    home.write("b", "hfov = 60")
    code, out, err = home.run("profile", "list")
    assert (code, out) == (1, "b: hfov = 60\n")
    assert "a.toml is not TOML" in err


@pytest.mark.parametrize("text", ["hfov = true", "threads = 2.5", "threads = true"])
def test_a_value_of_another_type_is_refused(home: Home, picture: Path, text: str) -> None:
    home.write("p", text)
    code, _, err = home.run("predict", picture, "--profile", "p")
    key = text.split(maxsplit=1)[0]
    assert (code, f"profile 'p': {key} " in err) == (2, True)
