"""The table of the commands, and the text of the root help; imports nothing."""

PROGRAM = "depthcli"
COMMANDS = {
    "predict": (
        "depthcli.cli.commands.predict",
        "Depth maps from pictures: 16-bit PNG, EXR, NPY, preview, PLY.",
    ),
    "batch": ("depthcli.cli.commands.batch", "Depth maps for a folder tree; can be resumed."),
    "manifest": (
        "depthcli.cli.commands.manifest",
        "Sum up, search and merge the manifests of a batch.",
    ),
    "video": (
        "depthcli.cli.commands.video",
        "Depth video: lossless 16-bit, preview, or image sequence.",
    ),
    "models": ("depthcli.cli.commands.models", "List, inspect, verify, add and remove models."),
    "profile": ("depthcli.cli.commands.profile", "Save options under a name, for --profile."),
    "convert": (
        "depthcli.cli.commands.convert",
        "Convert a depth file and report the conversion error.",
    ),
    "info": ("depthcli.cli.commands.info", "Show unit, scale and range of a depth file."),
    "probe": ("depthcli.cli.commands.probe", "Show the depth at given pixels of a depth file."),
    "eval": (
        "depthcli.cli.commands.eval.app",
        "Measure accuracy on NYU Depth v2 or your pairs.",
    ),
    "render": ("depthcli.cli.commands.render", "Render rooms with exact depth as training data."),
    "train": ("depthcli.cli.commands.train", "Train a model; can be resumed."),
    "export-onnx": (
        "depthcli.cli.commands.export",
        "Export a checkpoint to ONNX with a model card.",
    ),
    "bench": ("depthcli.cli.commands.bench", "Benchmark a model: latency, throughput, memory."),
    "doctor": ("depthcli.cli.commands.doctor", "Check the installation: provider, model, codecs."),
}
"""Name -> (module whose ``app`` is the command, one line of help)."""
PROFILE_COMMANDS = frozenset({"predict", "batch", "video"})
"""Commands that accept ``--profile``."""

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
