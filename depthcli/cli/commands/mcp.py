"""``depthcli mcp``: tools of depth for agents."""

from depthcli.cli import options as groups
from depthcli.errors import ExitCode


def mcp(*, model: groups.ModelOptions) -> int:
    """Serve tools for agents on standard input and output (Model Context Protocol).

    Tools: estimate_depth of an image file, distance at a pixel or in a box of a depth file, view in
    three dimensions. Add 'depthcli mcp' to the configuration of your agent.
    """
    from depthcli.cli import parse
    from depthcli.jobs.agent import make_server

    make_server(parse.session_loader(model.model, model.runtime)).run("stdio")
    return ExitCode.OK
