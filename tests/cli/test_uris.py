"""The command line with URIs: models that are fetched, secrets that are not shown, refusals."""

import hashlib
import json
import sys
from pathlib import Path

from helpers.command_line import Cli, finished
from helpers.rooms import large_rooms, write_rooms
from helpers.runs import RESNET_TOML
from helpers.stores import KEYS, Bucket, Faults, credentials_checked
from helpers.tiny import card_with, tiny_onnx, write_image, write_model
from helpers.videos import flat_frames, write_mp4

WATCHED = """
import sys
met = []
def watch(event, values):
    if event.startswith("socket."):
        met.append((event, values))
sys.addaudithook(watch)
from depthcli.cli.app import main
for words in sys.stdin.read().splitlines():
    assert main(words.split()) == 0, words
    print(met, {"obstore", "boto3"} & set(sys.modules))
"""
LOCAL = """\
predict in/a.png
batch in -o out
batch in -o out --workers 2
video in/clip.mp4 -o clip.mkv
models add models/default/model.onnx --card models/default/card.json --name own
models list
models verify own
info out/a.depth.png
convert out/a.depth.png a.exr
eval nyu --data nyu --split val
bench --seconds 0.1 --workers 1
doctor
train fastcut --data nyu --out run --threads 1 --config tiny.toml
"""


def fetched(bucket: Bucket, faults: Faults, data: bytes) -> str:
    """Address of a file behind HTTP, the way to which breaks off twice."""
    bucket.client.put_object(
        Bucket=bucket.name, Key="some/model.onnx", Body=data, ACL="public-read"
    )
    faults.fault = lambda _method, _path, before: "cut" if before < 2 else None
    return f"{faults.endpoint}/{bucket.name}/some/model.onnx"


def test_a_model_is_added_from_its_url(inside: Cli, bucket: Bucket, faults: Faults) -> None:
    data = tiny_onnx(card=json.dumps(card_with({"name": "far"})))
    digest = hashlib.sha256(data).hexdigest()
    url = fetched(bucket, faults, data)
    wrong = inside("models", "add", url, "--sha256", "0" * 64)
    assert (wrong.returncode, wrong.stdout) == (3, b"")
    assert wrong.stderr.decode().strip() == (
        f"depthcli: error: {url} is another file: its sha256 is {digest}; it is not added"
    )
    assert not (inside.models / "far").exists()
    done = inside("models", "add", url, "--sha256", digest.upper(), code=0)
    assert done.stdout.decode().startswith("far: metric depth up to 10 m, in ")
    assert (inside.models / "far" / "model.onnx").read_bytes() == data
    faults.seen.clear()
    taken = inside("models", "add", url, "--name", "far")
    assert (taken.returncode, faults.seen.total()) == (2, 0)  # said before anything is fetched
    again = inside("models", "add", url, "--name", "again")
    assert f"--sha256 {digest}" in again.stderr.decode()
    assert all(method == "GET" for method, _ in faults.seen)
    assert inside("models", "add", url, "--sha256", "abc").returncode == 3
    gone = inside("models", "add", f"{url}x", "--name", "gone", code=1)
    assert b"cannot be read: no such object" in gone.stderr


def test_a_model_is_used_where_it_lies(inside: Cli, bucket: Bucket, tmp_path: Path) -> None:
    folder = write_model(tmp_path / "m")
    for file in folder.iterdir():
        bucket.put(f"models/m/{file.name}", file.read_bytes())
    image = write_image(inside.folder / "a.png")
    done = inside("predict", image, "--model", bucket.uri("models/m"), "-o", "a.npy")
    assert (done.returncode, done.stderr) == (0, b"")
    inside("predict", image, "--model", folder, "-o", "b.npy", code=0)
    assert (inside.folder / "a.npy").read_bytes() == (inside.folder / "b.npy").read_bytes()
    none = inside("predict", image, "--model", bucket.uri("none"))
    assert (none.returncode, none.stderr.count(b"\n")) == (3, 1)
    assert b"no model at 's3://" in none.stderr


def test_signatures_and_passwords_are_not_shown(inside: Cli, bucket: Bucket) -> None:
    key = bucket.put("a.png", write_image(inside.folder / "a.png").read_bytes())
    signed = bucket.client.generate_presigned_url(
        "get_object", Params={"Bucket": bucket.name, "Key": key.rpartition("/")[2]}
    ).replace("//", "//somebody:word@", 1)
    assert "Signature=" in signed
    for words in (["predict", signed], ["batch", "--files", "list.txt"]):
        (inside.folder / "list.txt").write_text(f"{signed}\n{signed.replace('a.png', 'b.png')}\n")
        done = inside(*words, "-o", "out/", "--json")
        output = done.stdout + done.stderr
        assert b"127.0.0.1" in output
        for secret in (b"Signature", b"word", *map(str.encode, KEYS.values())):
            assert secret not in output
        for path in (inside.folder / "out").rglob("*"):
            assert path.is_dir() or b"Signature" not in path.read_bytes()
    assert (inside.folder / "out" / "a.depth.png").exists()


def test_wrong_credentials_are_one_line(inside: Cli, bucket: Bucket) -> None:
    write_image(inside.folder / "a.png")
    with credentials_checked(bucket.endpoint):
        for words, code in (
            (["predict", bucket.uri("a.png"), "-o", "x.png"], 1),
            (["predict", "a.png", "-o", bucket.uri("out/")], 1),
            (["batch", bucket.uri("in"), "-o", "out"], 2),
        ):
            done = inside(*words, DEPTHCLI_RETRIES="0")
            assert (done.returncode, done.stderr.count(b"\n")) == (code, 1)
            assert b"access denied" in done.stderr
            assert not any(secret.encode() in done.stderr for secret in KEYS.values())


def test_plain_paths_open_no_connection(cli: Cli) -> None:
    write_image(cli.folder / "in" / "a.png")
    write_mp4(cli.folder / "in" / "clip.mp4", flat_frames(range(40, 44)))
    (cli.folder / "tiny.toml").write_text(RESNET_TOML)
    write_rooms(cli.folder / "nyu", large_rooms())
    (cli.folder / "models").symlink_to(cli.models)
    home = cli.folder / "user"
    home.mkdir()
    environment = {**cli.environment, "HOME": str(home), "XDG_CACHE_HOME": str(home / "cache")}
    watched = [sys.executable, "-c", WATCHED]
    done = finished(watched, cli.folder, input=LOCAL, env=environment)
    assert done.returncode == 0, done.stderr
    # Where onnxruntime would keep what it is about to send, by a library that opens no connection
    # of Python's.
    assert not list(home.rglob("*onnxruntime*"))
    assert done.stdout.splitlines().count("[] set()") == len(LOCAL.splitlines())
