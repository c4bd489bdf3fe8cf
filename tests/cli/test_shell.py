"""What every command shares: help, version, exit codes, one-line errors."""

import subprocess
import sys
from pathlib import Path

import pytest
from helpers.command_line import Cli
from helpers.tiny import write_model

import depthcli
from depthcli.cli.table import COMMANDS

HEAVY = {"av", "numpy", "cv2", "onnxruntime", "torch", "rich", "OpenEXR", "importlib.metadata"}


def loaded(cli: Cli, *arguments: str) -> set[str]:
    """Every module that a command imports."""
    words = [sys.executable, "-X", "importtime", *cli.command(*arguments)[1:]]
    plain = {k: v for k, v in cli.environment.items() if not k.startswith("COVERAGE_")}
    done = subprocess.run(words, capture_output=True, check=True, cwd=cli.folder, env=plain)
    return {line.rsplit("|", 1)[1].strip() for line in done.stderr.decode().splitlines()}


@pytest.mark.parametrize("option", ["--help", "--version", "-h"])
def test_help_and_version_load_nothing_heavy(cli: Cli, option: str) -> None:
    modules = loaded(cli, option)
    assert "depthcli.cli.app" in modules
    assert not modules & (HEAVY | {"typer", "typing", "enum", "signal"})


@pytest.mark.parametrize("name", ["predict", "models", "doctor", "info", "probe", "convert"])
def test_a_command_s_help_loads_nothing_heavy(cli: Cli, name: str) -> None:
    modules = loaded(cli, name, "--help")
    assert "typer" in modules
    assert not modules & HEAVY


def test_help_names_every_command(inside: Cli) -> None:
    done = inside("--help", code=0)
    text = done.stdout.decode()
    for name, (_, summary) in COMMANDS.items():
        assert f"  {name} " in text
        assert summary in text
    assert max(map(len, text.splitlines())) <= 80


def test_without_a_command_the_help_is_shown(inside: Cli) -> None:
    bare = inside()
    assert (bare.returncode, bare.stderr) == (0, b"")
    assert bare.stdout == inside("--help").stdout
    group = inside("eval")
    assert (group.returncode, group.stderr) == (0, b"")
    assert group.stdout == inside("eval", "--help").stdout


def test_version_is_the_package_s(cli: Cli) -> None:
    done = cli("--version")
    assert (done.returncode, done.stdout) == (0, f"depthcli {depthcli.__version__}\n".encode())


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("nonsense",), "no command named 'nonsense'"),
        (("predikt",), "did you mean 'predict'?"),
        (("--nonsense",), "no such option"),
        (("predict",), "IMG..."),
        (("predict", "--nonsense", "a.jpg"), "no such option"),
        (("predict", "a.jpg", "--threads", "0"), "--threads"),
        (("predict", "a.jpg", "--format", "png"), "did you mean 'png16'?"),
        (("models", "nonsense"), "nonsense"),
    ],
)
def test_wrong_usage_is_a_line_and_exit_2(
    inside: Cli, arguments: tuple[str, ...], said: str
) -> None:
    done = inside(*arguments, code=2)
    (line,) = done.stderr.decode().splitlines()
    assert done.stdout == b""
    assert said in line
    assert "--help'" in line or "did you mean" in line


def test_a_traceback_only_with_debug(inside: Cli) -> None:
    plain = inside("models", "show", "nothing")
    debug = inside("models", "show", "nothing", "--debug")
    assert plain.returncode == debug.returncode == 3
    assert len(plain.stderr.splitlines()) == 1
    assert b"Traceback" in debug.stderr
    assert debug.stderr.splitlines()[-1] == plain.stderr.splitlines()[-1]


@pytest.mark.parametrize("command", ["train", "export-onnx"])
def test_a_missing_extra_is_one_clear_line(cli: Cli, command: str, tmp_path: Path) -> None:
    blocked = tmp_path / "blocked"
    blocked.mkdir()
    for name in ("torch", "onnx", "lightning_fabric"):
        text = f'raise ModuleNotFoundError("No module named {name}", name="{name}")'
        (blocked / f"{name}.py").write_text(text)
    (tmp_path / "x").touch()
    arguments = {"train": ("proposed", "--data", "x"), "export-onnx": ("x",)}[command]
    done = cli(command, *arguments, PYTHONPATH=f"{blocked}:{cli.site}", code=3)
    (line,) = done.stderr.decode().splitlines()
    assert "'depthcli[train]'" in line


@pytest.mark.parametrize("words", [("models", "show"), ("--help",), ("--version",), ("eval", "-h")])
def test_a_reader_that_leaves_ends_it_quietly(cli: Cli, words: tuple[str, ...]) -> None:
    process = cli.started(*words)
    process.stdout.close()
    assert process.wait(timeout=60) == 1
    assert process.stderr.read() == b""
    process.stderr.close()


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_shells_can_complete(cli: Cli, shell: str) -> None:
    words = {
        "bash": {"COMP_WORDS": "depthcli mod", "COMP_CWORD": "1"},
        "zsh": {"_TYPER_COMPLETE_ARGS": "depthcli mod"},
        "fish": {"_TYPER_COMPLETE_ARGS": "depthcli mod", "_TYPER_COMPLETE_FISH_ACTION": "get-args"},
    }[shell]
    done = cli(_DEPTHCLI_COMPLETE=f"complete_{shell}", **words)
    assert b"models" in done.stdout
    assert b"predict" not in done.stdout


@pytest.mark.parametrize(
    ("words", "offered"),
    [
        (
            "predict a.jpg --model ",
            ["default", "error", "fast", "float", "other", "prompted", "sharp"],
        ),
        ("predict a.jpg --model o", ["other"]),
        ("batch in --provider d", ["directml"]),
        ("video a.mp4 --profile ", ["mine"]),
        ("eval nyu --model d", ["default"]),
        ("models add a.onnx --card midas-s", ["midas-small-torch", "midas-small"]),
        ("models remove o", ["other"]),
        ("models show meter", ["meter-nyu"]),
        ("models verify o", ["other"]),
        ("doctor --provider cp", ["cpu"]),
        ("train cyc", ["cyclegan"]),
        ("train cut --preset b", ["bundled"]),
        ("train cut --accelerator m", ["mps"]),
    ],
)
def test_names_are_offered_where_names_are_wanted(
    inside: Cli, words: str, offered: list[str]
) -> None:
    write_model(inside.models / "other")
    (inside.folder / "depthcli.toml").write_text("[mine]\nhfov = 80\n")
    typed = f"depthcli {words}"
    done = inside(
        _DEPTHCLI_COMPLETE="complete_bash", COMP_WORDS=typed, COMP_CWORD=str(typed.count(" "))
    )
    assert done.stdout.decode().split() == offered


def test_offered_names_are_those_that_are_taken() -> None:
    from depthcli.cli import options  # noqa: PLC0415
    from depthcli.inference.session import AUTO, PROVIDERS  # noqa: PLC0415

    assert {*options.PROVIDERS} == {AUTO, *PROVIDERS}
