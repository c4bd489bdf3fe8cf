"""Compare the outputs of two versions of depthcli, byte by byte.

Both run the same commands on the same generated images and video: every format with its options,
a folder, two shards, an object store (a local server of moto), a local Ray cluster, and videos.
The other tree is copied and given this version's number, since outputs state the version.
Manifests are left out, as they state times and options.
Run: ``python benchmarks/same_bytes.py OTHER_TREE``; exit code 1 if a file differs.
"""

import logging
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import boto3
import cv2
from moto.server import ThreadedMotoServer
from tools import DEPTHCLI, parse_options, write_images, write_video

HERE = Path(__file__).parents[1]
IMAGES = 6
FRAMES = 20
MODEL = ("--model", str(HERE / "models" / "default"))
FORMATS = ("png16", "exr", "npy", "preview", "ply", "json")
KEYS = {
    "AWS_ACCESS_KEY_ID": "tester",
    "AWS_SECRET_ACCESS_KEY": "tester",
    "AWS_DEFAULT_REGION": "us-east-1",
}


def commands(folder: Path, address: str) -> dict[str, list[list[str]]]:
    """Commands of each comparison; each writes to ``out/`` in its working directory."""
    images, video = str(folder / "in"), str(folder / "room.avi")
    image, gray = str(folder / "in" / "00000.jpg"), str(folder / "gray16.png")
    every = [word for name in FORMATS for word in ("--format", name)]
    batch = ["batch", images, "-o", "out/", *every]
    store = ["batch", images, "-o", "s3://bucket/out/", "--format", "png16", "--format", "exr"]
    return {
        "predict": [["predict", image, gray, "-o", "out/", *every]],
        "predict, options": [
            ["predict", image, "-o", "out/half.exr", "--half", "--exr-channel", "Z"],
            ["predict", image, "-o", "out/kitti.png", "--png-scale", "256", "--hfov", "70"],
            ["predict", image, "-o", "out/full.png", "--png-normalize", "--upsample", "bilinear"],
            ["predict", image, "-o", "out/a.preview.png", "--colormap", "turbo", "--legend"],
            ["predict", image, "-o", "out/b.preview.png", "--near", "white", "--side-by-side"],
            ["predict", image, "-o", "out/tiles.npy", "--tile", "auto"],
            ["predict", image, "-o", "out/fit.exr", "--anchor", "9,9,3", "--anchor", "600,400,1"],
        ],
        "batch": [batch],
        "batch in shards": [[*batch, "--shard", f"{i}/2"] for i in (1, 2)],
        "batch on Ray": [[*batch, "--engine", "ray", "--ray-address", "local", "--workers", "1"]],
        "batch to a store": [store, ["fetch", address]],
        "video": [["video", video, "-o", "out/", "--format", "mkv", "--format", "mp4"]],
        "video, frames": [["video", video, "-o", "out/d.%04d.exr", "--smooth", "0.5"]],
    }


def run(tree: Path, words: list[str], where: Path) -> None:
    """Run one command of a tree."""
    if words[0] == "fetch":
        client = boto3.client("s3", endpoint_url=words[1])
        for listed in client.list_objects_v2(Bucket="bucket").get("Contents", ()):
            path = where / listed["Key"]
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(client.get_object(Bucket="bucket", Key=listed["Key"])["Body"].read())
            client.delete_object(Bucket="bucket", Key=listed["Key"])
        return
    command = [*DEPTHCLI, *words, *MODEL, "--quiet"]
    environment = {**os.environ, "PYTHONPATH": str(tree)}
    subprocess.run(command, env=environment, cwd=where, check=True, stdout=subprocess.DEVNULL)


def outputs(folder: Path) -> dict[str, bytes]:
    """Files below a folder by name, without manifests."""
    files = {str(path.relative_to(folder)): path for path in sorted(folder.rglob("*"))}
    return {
        name: path.read_bytes()
        for name, path in files.items()
        if path.is_file() and "manifest" not in name and "/." not in name
    }


def main() -> int:
    """Run everything with both trees, and print what differs."""
    other = parse_options(__doc__, "other").other
    logging.getLogger("werkzeug").setLevel(logging.ERROR)
    server = ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    server.start()
    address = "http://{}:{}".format(*server.get_host_and_port())
    os.environ |= {**KEYS, "AWS_ENDPOINT_URL": address, "AWS_ALLOW_HTTP": "true"}
    boto3.client("s3", endpoint_url=address).create_bucket(Bucket="bucket")
    differing = 0
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        shutil.copytree(other / "depthcli", folder / "other" / "depthcli")
        version = Path("depthcli", "_version.py")
        shutil.copy(HERE / version, folder / "other" / version)
        write_images(folder / "in" / "a", IMAGES - 1)
        first = write_images(folder / "in", 1)[0]
        gray = cv2.imread(str(first), cv2.IMREAD_GRAYSCALE).astype("uint16") * 257
        cv2.imwrite(str(folder / "gray16.png"), gray[:333, :500])
        write_video(folder / "room.avi", FRAMES)
        for what, lines in commands(folder, address).items():
            written = []
            for tree in (HERE, folder / "other"):
                where = folder / "run"
                (where / "out").mkdir(parents=True)
                for words in lines:
                    run(tree, words, where)
                written.append(outputs(where))
                shutil.rmtree(where)
            here, there = written
            wrong = sorted(n for n in here | there if here.get(n) != there.get(n))
            differing += len(wrong)
            print(f"{what}: {len(here)} files, {len(wrong)} differ {' '.join(wrong)}", flush=True)
    server.stop()
    return int(differing > 0)


if __name__ == "__main__":
    sys.exit(main())
