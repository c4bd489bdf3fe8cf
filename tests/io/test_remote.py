"""Objects in a store as paths: read, listed, written, and told of in one line when that fails."""

import io
import json
import os
import pickle
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from http.server import BaseHTTPRequestHandler
from pathlib import Path

import pytest
from helpers.batches import row
from helpers.command_line import ROOT, finished
from helpers.stores import KEYS, Bucket, Faults, remote
from helpers.web import Server

from depthcli.errors import InputError, OutputError, UsageError
from depthcli.io.guard import Guard
from depthcli.io.listing import InputFile, Skipped, list_folder
from depthcli.io.manifest import Journal, known_rows
from depthcli.io.storage import objects
from depthcli.io.storage.atomic import atomic_path
from depthcli.io.storage.paths import (
    RemotePath,
    join,
    local_copy,
    object_checksum,
    path_of,
    read_bytes,
    read_regular,
    safe_name,
)
from depthcli.video.numbering import listed_names

SIGNED = "https://user:word@host/a/b.jpg?X-Signature=secret/x&y=z"


@pytest.mark.parametrize(
    "uri", ["s3://b/k.jpg", "gs://b/a b/ü#?.jpg", "az://c/100%.jpg", "http://h:8/a/b.jpg"]
)
def test_a_uri_stays_what_it_is(uri: str) -> None:
    path = remote(uri)
    assert str(path) == os.fspath(path) == uri
    assert path == path_of(uri) == path_of(path)
    assert pickle.loads(pickle.dumps(path)) == path  # noqa: S301 - our own
    assert path.name == uri.rpartition("/")[2]
    assert str(path.parent / "other.png") == f"{uri.rpartition('/')[0]}/other.png"
    assert isinstance(path.with_suffix(".json"), RemotePath)
    assert path.relative_to(path.parent).as_posix() == path.name
    assert (path / "x/y").relative_to(path).as_posix() == "x/y"
    assert path.absolute() == path.resolve() == path


def test_plain_paths_and_file_uris_are_this_machines() -> None:
    for name in ("a/b.jpg", "./x", "/y", "s3:/b/k", "C:\\x"):
        assert path_of(name) == Path(name)
        assert type(path_of(name)) is type(Path())
    assert path_of("file:///a%20b/c.jpg") == Path("/a b/c.jpg")
    assert path_of("file://localhost/c.jpg") == Path("/c.jpg")
    assert join("s3://b/k/", "a.jpg") == "s3://b/k/a.jpg"
    assert join("s3://b/k", "./a.jpg") == "s3://b/k/a.jpg"
    assert join("s3://b/k", "/a.jpg") == "/a.jpg"
    assert join("here", "s3://b/a.jpg") == "s3://b/a.jpg"
    assert join("here", "a.jpg") == os.path.join("here", "a.jpg")  # noqa: PTH118


@pytest.mark.parametrize(
    "uri",
    [
        *("hdfs://a/b", "s3://", "s3:///k", "http://?x", "file://h/a"),
        *("s3://b/a//b.jpg", "gs://b//", "az://c/./b.jpg", "s3://b/../b.jpg"),
    ],
)
def test_other_addresses_are_refused(uri: str) -> None:
    with pytest.raises(UsageError):
        path_of(uri)


def test_passwords_and_signatures_are_not_shown() -> None:
    path = remote(SIGNED)
    assert str(path) == safe_name(SIGNED) == "https://host/a/b.jpg"
    assert path.query == "X-Signature=secret/x&y=z"
    assert pickle.loads(pickle.dumps(path)).query == path.query  # noqa: S301
    assert not (path.parent / "c.jpg").query  # a signature is for one object
    assert objects.masked(f"error at {SIGNED}: no") == "error at https://host/a/b.jpg no"
    assert safe_name("what?.jpg") == "what?.jpg"


def test_objects_are_read_and_described(bucket: Bucket, faults: Faults) -> None:
    names = ["a b/ü#?.jpg", "100%.jpg", "%20.jpg", "p+q&=.jpg", "empty.jpg"]
    for name in names:
        data = b"" if name == "empty.jpg" else name.encode()
        path = remote(bucket.put(name, data))
        assert path.read_bytes() == read_regular(path, 100) == data
        assert not data or path.read_bytes(first=3) == data[:3]
        assert path.stat().st_size == len(data)
        assert path.is_file()
        assert not path.is_dir()
    faults.seen.clear()
    assert remote(bucket.uri("100%.jpg")).stat().st_size == len("100%.jpg")
    assert [method for method, _ in faults.seen] == ["HEAD"]  # not its content
    folder = remote(bucket.uri("a b"))
    assert folder.is_dir()
    assert folder.exists()
    assert not folder.is_file()
    assert not remote(bucket.uri("a")).exists()  # the beginning of a name is no folder
    assert list(remote(bucket.uri()).walk_names()) == sorted(names)
    top = listed_names(remote(bucket.uri()))
    assert list(top) == sorted(name for name in names if "/" not in name)
    with pytest.raises(OSError, match="3"):
        read_regular(remote(bucket.uri("100%.jpg")), 3)


def test_outputs_appear_whole_with_their_checksum(bucket: Bucket, tmp_path: Path) -> None:
    path = remote(bucket.uri("out/map.npy"))
    large = os.urandom(9 << 20)  # in two parts
    with atomic_path(path) as temporary:
        assert temporary.suffix == ".npy"
        temporary.write_bytes(large)
        assert bucket.objects() == {}
    assert bucket.objects() == {"out/map.npy": large}
    assert not temporary.parent.exists()
    with suppress(KeyError), atomic_path(path) as temporary:
        temporary.write_bytes(b"half")
        raise KeyError
    assert bucket.objects() == {"out/map.npy": large}
    size, digest = object_checksum(path) or (0, "")
    assert size == len(large)
    foreign = remote(bucket.put("foreign", large))
    assert object_checksum(foreign) == (size, digest)  # nobody noted it there
    assert object_checksum(remote(bucket.uri("none"))) is None
    with local_copy(path) as copy:
        assert (copy.name, copy.read_bytes()) == ("map.npy", large)
    assert not copy.exists()
    with local_copy(tmp_path) as same:
        assert same is tmp_path
    guard = Guard.of([path], overwrite=True)
    with pytest.raises(OutputError):
        guard.check(path)


def test_errors_name_the_object_and_not_its_copy(bucket: Bucket) -> None:
    path = remote(bucket.put("clip.mp4", b"x"))
    with pytest.raises(InputError) as error, local_copy(path) as copy:
        raise InputError(f"{copy} is damaged")
    assert str(error.value) == f"{path} is damaged"
    with pytest.raises(InputError), local_copy(path / "none"):
        pass


@pytest.mark.parametrize("kind", ["503 SlowDown", "cut", "drop", "500 InternalError"])
def test_failing_request_is_tried_again(bucket: Bucket, faults: Faults, kind: str) -> None:
    data = os.urandom(300_000)
    path = remote(bucket.put("in/a.bin", data))
    faults.fault = lambda _method, _path, before: kind if before < 2 else None
    assert path.read_bytes() == data
    with local_copy(path) as copy:
        assert copy.read_bytes() == data
    with atomic_path(remote(bucket.uri("out/b.bin"))) as temporary:
        temporary.write_bytes(data)
    assert list(remote(bucket.uri("in")).walk_names()) == ["a.bin"]
    assert bucket.objects() == {"in/a.bin": data, "out/b.bin": data}
    assert kind == "cut" or faults.seen["PUT", f"/{bucket.name}/out/b.bin"] == 3


@pytest.mark.parametrize(
    "answer",
    [
        *("403 InvalidAccessKeyId", "403 AccessDenied", "301 PermanentRedirect"),
        *("404 NoSuchBucket", "503 SlowDown", "500 InternalError", "drop"),
    ],
)
def test_request_that_keeps_failing_is_an_error(
    bucket: Bucket, faults: Faults, monkeypatch: pytest.MonkeyPatch, answer: str
) -> None:
    monkeypatch.setenv(objects.RETRIES_VARIABLE, "1")
    faults.fault = lambda *_: answer
    path = remote(bucket.uri("a.jpg"))
    with pytest.raises(InputError) as error:
        read_bytes(path)
    with pytest.raises(OutputError) as failed, atomic_path(path) as temporary:
        temporary.write_bytes(b"x")
    for text in map(str, (error.value, failed.value)):
        assert text.count("\n") == 0
        assert text.count(str(path)) == 1
        assert not any(secret in text for secret in KEYS.values())


def test_without_the_extra_one_line_says_how_to_get_it(tmp_path: Path) -> None:
    blocked = tmp_path / "obstore.py"
    blocked.write_text("raise ModuleNotFoundError('no', name='obstore')")
    words = [sys.executable, "-m", "depthcli", "predict", "s3://bucket/a.jpg", "-o", "x.png"]
    path = f"{tmp_path}{os.pathsep}{os.environ.get('PYTHONPATH', '')}"
    done = finished(words, ROOT, env={**os.environ, "PYTHONPATH": path})
    assert done.returncode == 1
    assert done.stderr.count("\n") == 1
    assert done.stderr.startswith("depthcli: error: s3://bucket/")
    assert "obstore" in done.stderr


def test_a_list_of_a_bucket_comes_page_by_page(
    bucket: Bucket, faults: Faults, once_each: Callable[[], Faults], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MOTO_S3_DEFAULT_MAX_KEYS", "2")  # the server's
    monkeypatch.setattr(objects, "_PAGE_NAMES", 2)
    names = [f"{number}.jpg" for number in range(7)]
    for name in names:
        bucket.put(name, b"")
    listed = remote(bucket.uri()).walk_names()
    first = next(listed)
    assert sum(faults.seen.values()) == 1  # nobody has asked for the second page yet
    once_each()
    assert [first, *listed] == names


class Hello(Server):
    """Gives "hello" for whatever is asked; ``asked`` is what it was asked."""

    def __init__(self) -> None:
        super().__init__(protocol="HTTP/1.1")
        self.asked: list[str] = []

    def answer(self, request: BaseHTTPRequestHandler) -> None:
        request.rfile.read(int(request.headers.get("content-length", 0)))
        is_signed = "signed" if "authorization" in request.headers else "open"
        self.asked.append(f"{request.command} {request.path.partition('?')[0]} {is_signed}")
        here = self.url.replace("127.0.0.1", "localhost")
        places = {
            "/moved": "/there?signature=x",
            "/inside": f"{here}x",
            "/ftp": "ftp://127.0.0.1/x",
        }
        start = int((request.headers.get("Range") or "bytes=0-")[6:].split("-")[0])
        if request.path in places:
            request.send_response(302)
            request.send_header("Location", places[request.path])
        else:
            request.send_response(206 if start else 200)
        request.send_header("ETag", '"e"')
        request.send_header("Last-Modified", "Tue, 21 Oct 2025 07:28:00 GMT")
        data = b"hello"[start:] if request.command == "GET" else b""
        if start:
            request.send_header("Content-Range", f"bytes {start}-4/5")
        if request.path != "/endless":
            request.send_header("Content-Length", str(len(data)))
        request.end_headers()
        request.wfile.write(data[:2] if request.path == "/cut" and not start else data)
        request.close_connection = request.path in ("/endless", "/cut")


@pytest.fixture
def plain_server() -> Iterator[tuple[str, list[str]]]:
    """Its address, and what it was asked."""
    with Hello() as server:
        yield server.url.rstrip("/"), server.asked


def test_google_and_azure_are_asked_as_they_want_it(
    plain_server: tuple[str, list[str]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    endpoint, requests = plain_server
    account = {"gcs_base_url": endpoint, "disable_oauth": True, "client_email": "a"}
    keys = {"private_key": "b", "private_key_id": "c"}
    (tmp_path / "account.json").write_text(json.dumps(account | keys))
    for name, value in {
        "GOOGLE_SERVICE_ACCOUNT": str(tmp_path / "account.json"),
        "AZURE_STORAGE_ACCOUNT_NAME": "account",
        "AZURE_STORAGE_ACCOUNT_KEY": "a2V5",
        "AZURE_STORAGE_ENDPOINT": endpoint,
    }.items():
        monkeypatch.setenv(name, value)
    objects._store.cache_clear()
    for folder in ("gs://bucket", "az://container"):
        assert path_of(f"{folder}/x y/z.jpg").read_bytes() == b"hello"
        with atomic_path(path_of(f"{folder}/out/q.npy")) as temporary:
            temporary.write_bytes(b"123")
    assert [request.rpartition(" ")[0] for request in requests[:2]] == [
        "GET /bucket/x%20y%2Fz%2Ejpg",
        "PUT /bucket/out%2Fq%2Enpy",
    ]
    assert requests[2:] == ["GET /container/x%20y/z.jpg signed", "PUT /container/out/q.npy signed"]


def test_azure_without_an_account_says_how_to_give_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("AZURE_STORAGE_ACCOUNT_NAME", raising=False)
    objects._store.cache_clear()
    with pytest.raises(OSError, match="AZURE_STORAGE_ACCOUNT_NAME"):
        path_of("az://container/x.jpg").read_bytes()


def test_files_behind_http(plain_server: tuple[str, list[str]]) -> None:
    server, requests = plain_server
    moved = remote(f"{server}/moved")
    assert moved.read_bytes() == b"hello"
    assert moved.read_bytes(first=2) == b"he"  # the server knows nothing of ranges
    with pytest.raises(InputError):
        read_bytes(remote(f"{server}/endless"))
    requests.clear()
    assert remote(server.replace("//", "//user:word@") + "/x").read_bytes() == b"hello"
    assert requests == ["GET /x signed"]


def test_interrupted_download_behind_http_is_resumed(plain_server: tuple[str, list[str]]) -> None:
    server, requests = plain_server
    assert remote(f"{server}/cut").read_bytes() == b"hello"
    assert len(requests) == 2


def test_redirect_to_a_private_address_is_refused_unless_named(
    plain_server: tuple[str, list[str]],
) -> None:
    server, requests = plain_server
    for place, problem in (("inside", "private address"), ("ftp", "ftp://")):
        with pytest.raises(InputError, match=problem):
            read_bytes(remote(f"{server}/{place}"))
    assert requests == ["GET /inside open", "GET /ftp open"]
    named = server.replace("127.0.0.1", "localhost")
    assert read_bytes(remote(f"{named}/inside")) == b"hello"


def test_percent_escapes_are_sent_as_they_are(plain_server: tuple[str, list[str]]) -> None:
    server, requests = plain_server
    keys = ["my%20room.jpg", "a%2Fb%C3%BC.jpg", "%E9.jpg", "my%20room.jpg?signature=x"]
    for key in keys:
        assert remote(f"{server}/{key}").read_bytes() == b"hello"
    assert remote(f"{server}/my room 100%.jpg").read_bytes() == b"hello"
    places = [key.partition("?")[0] for key in keys]
    assert requests == [f"GET /{place} open" for place in [*places, "my%20room%20100%25.jpg"]]


def test_credentials_are_those_of_the_usual_chain(
    bucket: Bucket, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = remote(bucket.put("a.jpg", b"data"))
    for name in KEYS:
        monkeypatch.delenv(name)
    file = tmp_path / "credentials"
    for name, value in {
        "AWS_EC2_METADATA_DISABLED": "true",
        "AWS_SHARED_CREDENTIALS_FILE": str(file),
        "AWS_CONFIG_FILE": str(tmp_path / "none"),
    }.items():
        monkeypatch.setenv(name, value)
    with pytest.raises(InputError):
        read_bytes(path)
    keys = "".join(f"{name.lower()} = {value}\n" for name, value in KEYS.items())
    file.write_text(f"[mine]\n{keys}")
    monkeypatch.setenv("AWS_PROFILE", "mine")
    assert path.read_bytes() == b"data"


def test_missing_object_is_an_error(bucket: Bucket) -> None:
    none = remote(bucket.uri("none"))
    with pytest.raises(FileNotFoundError):
        none.read_bytes(first=3)
    with pytest.raises(FileNotFoundError):
        none.stat()
    for path in (none, remote("s3://no-such-bucket/x")):
        assert (path.exists(), path.is_file(), path.is_dir()) == (False, False, False)
    path = remote(bucket.put("a", b"data"))
    with path.open("rb") as file:
        assert file.read() == b"data"
    with pytest.raises(io.UnsupportedOperation):
        path.open("wb")
    path.unlink()
    path.unlink()
    assert bucket.names() == []
    assert not path.is_symlink()


@pytest.mark.parametrize(("word", "count"), [(None, 10), ("0", 0), ("7", 7), ("x", None)])
def test_variable_sets_the_number_of_retries(
    word: str | None, count: int | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("DEPTHCLI_RETRIES", raising=False)
    if word is not None:
        monkeypatch.setenv("DEPTHCLI_RETRIES", word)
    if count is None:
        with pytest.raises(UsageError):
            objects._retries()
    else:
        assert objects._retries() == count


JOURNAL = ".depthcli-batch.jsonl"


@pytest.fixture
def left(bucket: Bucket) -> dict[str, bytes]:
    """What an earlier batch that was killed, and others, left in a folder."""
    half = row("d").as_line()[:40]
    files = {
        "out/manifest.jsonl": row("a", 1.0).as_line() + row("e").as_line(),
        "out/manifest-1-of-2.jsonl": row("f").as_line(),
        f"out/{JOURNAL}.{7:020}-0123abcd": row("a", 2.0).as_line() + row("b").as_line(),
        f"out/{JOURNAL}.{8:020}-0123abcd": row("a", 3.0).as_line(),
        f"out/{JOURNAL}.{10:020}-0123abcd": row("c").as_line() + half,
    }
    others = (
        "out/a.png",
        "out/.depthcli-aside",
        "out/nearby",
        "manifest.jsonl",
        "out2/manifest",
        "out/manifest_old/a.depth.png",
        "out/manifests/day1/a.depth.png",
        "out/.depthcli-batch-notes.txt",
    )
    # The order of two that were written in the same second is that of their names.
    for name, data in (files | dict.fromkeys(others, b"not a row")).items():
        bucket.put(name, data)
        time.sleep(1.0 if name == "out/manifest-1-of-2.jsonl" else 0.0)
    return dict.fromkeys(others, b"not a row")


def test_rows_of_a_killed_batch_are_read_from_a_store(
    bucket: Bucket, left: dict[str, bytes]
) -> None:
    out, before = remote(bucket.uri("out")), bucket.objects()
    expected = [row("a", 3.0), *map(row, "bcef")]
    assert sorted(known_rows(out), key=lambda each: each.input) == expected
    assert bucket.objects() == before
    with pytest.raises(OutputError):
        known_rows(remote("s3://no-such-bucket/out"))
    journal = Journal(out)
    journal.add(row("d"))
    journal.finish(None)
    rows = [*expected[:3], row("d"), *expected[3:]]
    manifest = b"".join(each.as_line() for each in rows)
    assert bucket.objects() == left | {"out/manifest.jsonl": manifest}


@pytest.mark.usefixtures("left")
def test_a_manifest_is_written_before_its_parts_are_removed(bucket: Bucket, faults: Faults) -> None:
    journal, before = Journal(remote(bucket.uri("out"))), bucket.objects()
    faults.fault = lambda method, *_: None if method in {"PUT", "GET", "HEAD"} else "403"
    with pytest.raises(OutputError):
        journal.finish(None)
    after = bucket.objects()
    assert after.pop("out/manifest.jsonl") != before.pop("out/manifest.jsonl")
    assert after == before


def test_folder_of_a_store_is_listed_like_a_local_one(bucket: Bucket) -> None:
    names = [
        *("a.jpg", "in/", "in/.b.jpg", "in/.c/d.jpg", "in/e.txt", "in/f.depth.mkv", "in/g.JPG"),
        *("in/h/i.mp4", "in/h/j/k.png", "in/l/m.jpg", "in/l/n/o.jpg", "in/p", "in/q.out/r.jpg"),
        *("in/out/s.jpg", "in/out.jpg", "in/l.jpg"),
    ]
    for name in names:
        bucket.put(name, b"")
    root = bucket.uri("in")
    listing = list_folder(root, leave_out=f"{root}/out", skip={"l", "h/j"}.__contains__)
    media = ["g.JPG", "l.jpg", "out.jpg", "h/i.mp4", "q.out/r.jpg"]
    assert listing.media == [InputFile(name, bucket.uri(f"in/{name}")) for name in media]
    assert listing.skipped == [
        Skipped(".b.jpg", "hidden"),
        Skipped("e.txt", ".txt"),
        Skipped("f.depth.mkv", "written by depthcli"),
        Skipped("p", "without suffix"),
    ]
    every = list_folder(bucket.uri(), leave_out="elsewhere").media
    assert [f.name for f in every if "out/" in f.name] == ["in/out/s.jpg", "in/q.out/r.jpg"]
    assert every[0] == InputFile("a.jpg", bucket.uri("a.jpg"))


@pytest.mark.parametrize("bad", ["x//e.png", "/e.png"])
def test_a_key_that_is_no_path_fails_alone(bad: str, bucket: Bucket) -> None:
    """developmentseed/obstore#429: one such key made the whole bucket unreadable."""
    for name in ("a.png", bad, "x/b.png", "./f.png", "x/../g.png"):  # two are as hidden
        bucket.put(f"in/{name}", b"")
    media = list_folder(bucket.uri("in"), skip=lambda _: False).media
    assert {file.name: file.problem is None for file in media} == {
        "a.png": True,
        bad: False,
        "x/b.png": True,
    }
    assert bad in str(next(file.problem for file in media if file.problem))


def test_empty_or_forbidden_folder_of_a_store_is_a_usage_error(
    bucket: Bucket, faults: Faults
) -> None:
    with pytest.raises(UsageError):
        list_folder(bucket.uri("in"), leave_out="out")
    faults.fault = lambda *_: "403"
    with pytest.raises(UsageError):
        list_folder(bucket.uri("in"), leave_out="out")
