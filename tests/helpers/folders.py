"""Folders of images for ``depthcli batch``, and what became of them."""

import json
import subprocess
from pathlib import Path
from typing import Any

import numpy as np

from helpers import file_trees
from helpers.command_line import Cli
from helpers.tiny import synthetic_image, write_image


def image(cli: Cli, name: str, pixels: np.ndarray[Any, Any]) -> Path:
    """One image in the folder ``in``."""
    return write_image(cli.folder / "in" / name, pixels)


def tree(cli: Cli, *names: str) -> None:
    """Files in the folder ``in``: small images, no two alike, or text."""
    for number, name in enumerate(names):
        path = cli.folder / "in" / name
        if path.suffix == ".txt":
            path.write_text("text")
        else:
            write_image(path, synthetic_image(24, 32 + number))


def contents(cli: Cli, folder: str) -> dict[str, bytes]:
    """Every file below a folder of the command's, hidden ones too."""
    return file_trees.contents(cli.folder / folder)


def here(cli: Cli) -> set[str]:
    """Every file in the command's folder."""
    return {str(p.relative_to(cli.folder)) for p in cli.folder.rglob("*") if p.is_file()}


def rows(cli: Cli, out: str) -> dict[str, dict[str, Any]]:
    """The manifest by input."""
    lines = (cli.folder / out / "manifest.jsonl").read_text().splitlines()
    return {row["input"]: row for row in map(json.loads, lines)}


def printed(done: subprocess.CompletedProcess[bytes]) -> list[dict[str, Any]]:
    """The lines of ``--json``."""
    return [json.loads(line) for line in done.stdout.splitlines()]
