"""``depthcli eval``: comparing models and training runs on a data set."""

import typer

from depthcli.cli.commands.eval.nyu import nyu
from depthcli.cli.commands.eval.pairs import pairs
from depthcli.cli.commands.eval.runs import runs

app = typer.Typer(rich_markup_mode=None, no_args_is_help=True, help="Compare models on a data set.")


@app.callback()
def _eval_group() -> None:
    """Compare models on a data set."""


app.command()(nyu)
app.command()(pairs)
app.command()(runs)
