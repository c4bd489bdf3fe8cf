"""The table of the commands, and the text of the root help; imports nothing."""

PROGRAM = "depthcli"
COMMANDS = {
    "predict": ("predict", "Depth maps from pictures: 16-bit PNG, EXR, NPY, preview, PLY."),
    "batch": ("batch", "Depth maps for a folder tree; can be resumed."),
    "manifest": ("manifest", "Sum up, search and merge the manifests of a batch."),
    "video": ("video", "Depth video: lossless 16-bit, preview, or image sequence."),
    "models": ("models", "List, inspect, verify, add and remove models."),
    "profile": ("profile", "Save options under a name, for --profile."),
    "convert": ("convert", "Convert depth files and report the conversion error."),
    "info": ("info", "Show unit, scale and range of a depth file."),
    "probe": ("probe", "Show the depth at given pixels of a depth file."),
    "eval": ("eval", "Measure accuracy on NYU Depth v2 or your pairs."),
    "render": ("render", "Render rooms with exact depth as training data."),
    "train": ("train", "Train a model; can be resumed."),
    "export-onnx": ("export", "Export a checkpoint to ONNX with a model card."),
    "bench": ("bench", "Benchmark a model: latency, throughput, memory."),
    "doctor": ("doctor", "Check the installation: provider, model, codecs."),
}
"""Name -> (module in ``commands/`` whose ``app`` is the command, one line of help)."""
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
