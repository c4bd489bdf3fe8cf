"""The table of the commands, and the text of the root help; imports nothing by itself."""

TYPE_CHECKING = False  # as in depthcli/cli/app.py
if TYPE_CHECKING:
    from typing import Any

PROGRAM = "depthcli"
COMMANDS = {
    "predict": ("predict:predict", "Depth maps from images: 16-bit PNG, EXR, NPY, preview, mesh."),
    "batch": ("batch:batch", "Depth maps for a folder tree; can be resumed."),
    "manifest": ("batch:MANIFEST", "Sum up, search and merge the manifests of a batch."),
    "video": ("video:video", "Depth video: lossless 16-bit, preview, or image sequence."),
    "models": ("models:COMMANDS", "List, inspect, verify, add and remove models."),
    "view": ("depth_files:view", "Show a depth file in three dimensions, on a web page."),
    "convert": ("depth_files:convert", "Convert depth files and report the conversion error."),
    "info": ("depth_files:info", "Show unit, scale and range of a depth file."),
    "probe": ("depth_files:probe", "Show the depth at pixels, in boxes or masks of a depth file."),
    "calibrate": ("predict:calibrate", "Measure the scale of a camera, once, and keep it."),
    "eval": ("eval:COMMANDS", "Measure accuracy on NYU Depth v2 or your pairs."),
    "train": ("train:train", "Train a model; can be resumed."),
    "export-onnx": ("export:export_onnx", "Export a checkpoint to ONNX with a model card."),
    "bench": ("bench:bench", "Benchmark a model: latency, throughput, memory."),
    "serve": ("serve:serve", "Serve depth over HTTP with one loaded model."),
    "mcp": ("serve:mcp", "Serve depth to agents (Model Context Protocol)."),
    "doctor": ("models:doctor", "Check the installation: provider, model, codecs."),
}  #: name -> (module in ``commands/`` and its function or functions by name, one line of help)
LAB_COMMANDS = ("eval", "train", "export-onnx", "bench")  #: those in ``lab/commands/``
PROFILE_COMMANDS = ("predict", "batch", "video")  #: commands that accept ``--profile``

_HELP = """\
Usage: depthcli COMMAND [OPTIONS] [ARGUMENTS]...

Monocular depth estimation on the command line.

Commands:
{commands}

Options:
  --version             Show the version and exit.
  -h, --help            Show this help, or the help of a command.
  --install-completion  Install completion for the current shell.
  --show-completion     Print the completion script for the current shell.

Exit codes: 0 success, 1 some inputs failed, 2 usage error, 3 model or runtime
error, 130 interrupted.
"""


def help_text() -> str:
    """The text of ``depthcli --help``."""
    rows = (f"  {name:<12} {summary}" for name, (_, summary) in COMMANDS.items())
    return _HELP.format(commands="\n".join(rows))


def plain_command(name: str) -> "Any":  # noqa: ANN401 - typer's own types
    """Import one command, without the options that the shell adds."""
    from pkgutil import resolve_name

    from depthcli.cli.groups import command_of

    place, summary = COMMANDS[name]
    folder = "lab" if name in LAB_COMMANDS else "cli"
    command = command_of(resolve_name(f"depthcli.{folder}.commands.{place}"), summary)
    command.name = name
    return command
