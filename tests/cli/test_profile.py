"""``--profile NAME``: options from a table of ``depthcli.toml``."""

import json
from pathlib import Path

import pytest
from helpers.command_line import Cli
from helpers.tiny import write_picture

from depthcli.cli import profiles
from depthcli.cli.app import main
from depthcli.cli.profiles import read_profiles
from depthcli.errors import UsageError
from depthcli.io.depth.read import read_metadata

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
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The working directory, and a configuration folder of the user's."""
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "home"))
    monkeypatch.chdir(tmp_path)
    write_picture(tmp_path / "room.png")
    return tmp_path


def test_profile_gives_options_to_the_command(inside: Cli) -> None:
    write_picture(inside.folder / "room.png")
    (inside.folder / "depthcli.toml").write_text(TEXT)
    done = inside("predict", "room.png", "--profile", "robot", "--json")
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert told["outputs"] == ["room.depth.png", "room.preview.png"]
    assert "81.0°" in told["camera"]
    assert float(read_metadata(inside.folder / "room.depth.png")["scale"]) == 256


@pytest.mark.parametrize(
    ("words", "scale"),
    [
        (("-o", "x.exr"), None),
        (("-o", "x.png", "--png-scale", "5000"), "5000"),
        (("-o", "x.png", "--focal-px", "60"), "256"),
        (("-o", "x.png", "--png-normalize"), None),
    ],
)
def test_options_win_over_profiles(inside: Cli, words: tuple[str, ...], scale: str | None) -> None:
    write_picture(inside.folder / "room.png")
    (inside.folder / "depthcli.toml").write_text(TEXT)
    done = inside("predict", "room.png", "--profile", "robot", *words)
    assert done.returncode == 0, done.stderr
    written = inside.folder / words[1]
    assert written.exists()
    if scale:
        assert float(read_metadata(written)["scale"]) == float(scale)


def test_project_precedes_the_user(folder: Path) -> None:
    own = folder / "home" / "depthcli" / "depthcli.toml"
    own.parent.mkdir(parents=True)
    own.write_text("[robot]\nhfov = 50\n[mine]\nhfov = 60\n")
    (folder / "depthcli.toml").write_text(TEXT)
    assert profiles.profile_names() == ("mine", "one", "robot")
    assert profiles.profile_files()[1] == own


def test_repeatable_option_takes_one_value(inside: Cli) -> None:
    write_picture(inside.folder / "room.png")
    (inside.folder / "depthcli.toml").write_text(TEXT)
    assert inside("predict", "room.png", "--profile", "one").returncode == 0
    assert (inside.folder / "room.depth.exr").exists()


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("[robot]\nhfovv = 3\n", "no option named 'hfovv'; did you mean 'hfov'?"),
        ("[robot]\nhfov = 300\n", "--hfov"),
        ("[robot]\nhfov = 80\nfocal-px = 70\n", "not both"),
        ("[robot]\nout = 'x.png'\n", "no option named 'out'"),
        ("[robot\n", "depthcli.toml is not TOML"),
        ("hfov = 80\n", "outside of a table"),
        ("[other]\nhfov = 80\n", "no profile named 'robot'; there are: other"),
        ("", "no profile named 'robot'; there are: none"),
    ],
)
def test_wrong_profile_is_a_usage_error(
    folder: Path, text: str, reason: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "depthcli.toml").write_text(text)
    assert main(["predict", "room.png", "--profile", "robot"]) == 2
    assert reason in capsys.readouterr().err
    assert not (folder / "room.depth.png").exists()


def test_file_of_profiles_has_to_be_text(folder: Path) -> None:
    assert read_profiles(folder / "none.toml") == {}
    (folder / "depthcli.toml").write_bytes(b"\xff\xfe")
    with pytest.raises(UsageError):
        read_profiles(folder / "depthcli.toml")
