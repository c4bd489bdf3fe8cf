"""``depthcli mcp``: its tools, called by the client of the protocol's own SDK."""

import asyncio
import json
from typing import Any

import numpy as np
import pytest
from helpers.command_line import Cli
from helpers.tiny import write_image
from mcp import ClientSession, StdioServerParameters, stdio_client

import depthcli


def called(cli: Cli, *calls: tuple[str, dict[str, Any]]) -> list[tuple[bool, str]]:
    """Whether each call of a tool failed, and its text."""

    async def talk() -> list[tuple[bool, str]]:
        command, *words = cli.command("mcp")
        server = StdioServerParameters(
            command=command, args=words, env=dict(cli.environment), cwd=str(cli.folder)
        )
        async with stdio_client(server) as streams, ClientSession(*streams) as session:
            await session.initialize()
            names = [tool.name for tool in (await session.list_tools()).tools]
            assert names == ["estimate_depth", "distance", "view"]
            answers = [await session.call_tool(name, arguments) for name, arguments in calls]
            return [(bool(each.is_error), each.content[0].text) for each in answers]

    return asyncio.run(talk())


def test_an_agent_estimates_measures_and_views(cli: Cli) -> None:
    write_image(cli.folder / "a.png")
    estimated, at, box, page = called(
        cli,
        ("estimate_depth", {"image": "a.png", "out": "a.npy", "hfov_deg": 60}),
        ("distance", {"depth_file": "a.npy", "place": [10, 20]}),
        ("distance", {"depth_file": "a.npy", "place": [0, 0, 8, 8]}),
        ("view", {"depth_file": "a.npy", "image": "a.png", "out": "a.html"}),
    )
    values = np.load(cli.folder / "a.npy")
    assert json.loads(estimated[1])["median"] == pytest.approx(float(np.median(values)))
    assert json.loads(at[1])["depth"] == pytest.approx(float(values[20, 10]))
    median = float(np.median(values[:8, :8]))
    assert json.loads(box[1])["quantiles"]["median"] == pytest.approx(median)
    assert not page[0]
    assert (cli.folder / "a.html").read_text().startswith("<!doctype html>")
    assert depthcli.read_depth(cli.folder / "a.npy").is_metric


def test_a_tool_that_fails_says_what_to_do(cli: Cli) -> None:
    (cli.folder / "mine.png").write_bytes(b"of another program")
    write_image(cli.folder / "a.png")
    write_image(cli.folder / "b.png")
    np.save(cli.folder / "d.npy", np.full((48, 64), 2, np.float32))
    missing, foreign, place, *others = called(
        cli,
        ("estimate_depth", {"image": "no.png", "out": "b.npy"}),
        ("estimate_depth", {"image": "a.png", "out": "mine.png"}),
        ("distance", {"depth_file": "no.npy", "place": [1]}),
        ("distance", {"depth_file": "d.npy", "place": [-9, -8, -5, -4]}),
        ("estimate_depth", {"image": "b.png", "out": "-"}),
        ("view", {"depth_file": "d.npy", "image": "b.png", "out": "v.png"}),
    )
    assert all(failed for failed, _ in (missing, foreign, place, *others[:2]))
    assert others[2][0] or (cli.folder / json.loads(others[2][1])["file"]).suffix == ".html"
    assert "no such file" in missing[1]
    assert "does not state that depthcli wrote it" in foreign[1]
    assert (cli.folder / "mine.png").read_bytes() == b"of another program"
