"""``depthcli mcp``: tools of depth for agents."""

from depthcli.cli import options as groups
from depthcli.errors import ExitCode


def mcp(*, model: groups.ModelOptions) -> int:
    """Serve tools for agents on standard input and output (Model Context Protocol).

    Tools: estimate_depth of an image file, distance at a pixel or in a box of a depth file, view in
    three dimensions. Add 'depthcli mcp' to the configuration of your agent.
    """
    from depthcli.api.agent import make_server
    from depthcli.api.model import DepthModel
    from depthcli.cli import parse
    from depthcli.inference.pipeline import Pipeline

    session = parse.session_loader(model.model, model.runtime).load()
    make_server(DepthModel(Pipeline(session))).run("stdio")
    return ExitCode.OK
