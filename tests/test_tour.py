"""The commands of docs/tour.md, run in one shell as a reader would."""

import os
import re
import shutil
import sys

import pytest
from helpers.command_line import ROOT, Cli, finished
from helpers.tiny import synthetic_image
from helpers.videos import write_mp4
from helpers.web import Camera, free_port

COMMANDS = re.compile(r"^```sh\n(.*?)^```$", re.MULTILINE | re.DOTALL)


@pytest.mark.skipif(not shutil.which("curl") or not shutil.which("timeout"), reason="needs curl")
def test_the_commands_run(cli: Cli) -> None:
    (cli.folder / "docs").mkdir()
    shutil.copy(ROOT / "docs" / "room.jpg", cli.folder / "docs")
    write_mp4(cli.folder / "clip.mp4", [synthetic_image(48, 64)] * 3)
    program = cli.folder / "bin" / "depthcli"
    program.parent.mkdir()
    program.write_text(f'#!/bin/sh\nexec {sys.executable} -m depthcli "$@"\n')
    program.chmod(0o755)
    script = "".join(COMMANDS.findall((ROOT / "docs" / "tour.md").read_text("utf-8")))
    script = script.replace("serve &", "serve --port 8000 &").replace("8000", str(free_port()))
    with Camera() as camera:
        script = script.replace("video 0", f"video {camera.url} --live")
        script = script.replace("8080", str(free_port()))
        command = ["timeout", "100", "bash", "-ec", f"trap 'kill $(jobs -p)' ERR\n{script}"]
        path = {"PATH": f"{program.parent}:{os.environ['PATH']}"}
        done = finished(command, cli.folder, env=cli.environment | path)
    assert done.returncode == 0, done.stderr
    assert 'depthcli_requests_total{status="200"} 1.0' in done.stdout
    written = {str(path.relative_to(cli.folder)) for path in cli.folder.rglob("*.*")}
    names = ("html", "glb", "ply", "stereo.png", "depth.png", "preview.png")
    assert written >= {f"out/room.{name}" for name in names}
    assert written >= {"room.exr", "live/live.depth.0000.mkv", "live/live.preview.0001.mp4"}
    assert written >= {"depth/manifest.jsonl", "out/clip.depth.mkv", "out/clip.preview.mp4"}
