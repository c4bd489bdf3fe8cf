"""A real S3 server and a misbehaving way to it, both on this machine."""

import contextlib
import logging
from collections import Counter
from collections.abc import Callable, Iterator
from http.client import HTTPConnection
from http.server import BaseHTTPRequestHandler
from typing import Any

import boto3
from moto.server import ThreadedMotoServer

from depthcli.io.storage.paths import RemotePath, path_of
from helpers.web import Server

KEYS = {"AWS_ACCESS_KEY_ID": "tester", "AWS_SECRET_ACCESS_KEY": "not-to-be-seen"}
REGION = "us-east-1"
_HOP = {"connection", "transfer-encoding", "content-length", "date", "server"}


def remote(uri: str) -> RemotePath:
    """A URI that names an object or a folder of a store."""
    path = path_of(uri)
    assert isinstance(path, RemotePath)
    return path


class Bucket:
    """A bucket, as its owner sees it."""

    def __init__(self, endpoint: str, name: str) -> None:
        self.name, self.endpoint = name, endpoint
        self.client: Any = boto3.client(
            "s3",
            endpoint_url=endpoint,
            region_name=REGION,
            aws_access_key_id=KEYS["AWS_ACCESS_KEY_ID"],
            aws_secret_access_key=KEYS["AWS_SECRET_ACCESS_KEY"],
        )
        self.client.create_bucket(Bucket=name)

    def uri(self, key: str = "") -> str:
        return f"s3://{self.name}/{key}"

    def put(self, key: str, data: bytes) -> str:
        self.client.put_object(Bucket=self.name, Key=key, Body=data)
        return self.uri(key)

    def names(self) -> list[str]:
        pages = self.client.get_paginator("list_objects_v2").paginate(Bucket=self.name)
        return [entry["Key"] for page in pages for entry in page.get("Contents", ())]

    def objects(self) -> dict[str, bytes]:
        return {
            key: self.client.get_object(Bucket=self.name, Key=key)["Body"].read()
            for key in self.names()
        }


@contextlib.contextmanager
def s3_server() -> Iterator[str]:
    """An S3 server; its address."""
    logging.getLogger("werkzeug").setLevel(logging.ERROR)
    server = ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    server.start()
    try:
        yield "http://{}:{}".format(*server.get_host_and_port())
    finally:
        server.stop()


@contextlib.contextmanager
def credentials_checked(endpoint: str) -> Iterator[None]:
    """The server refuses whoever it does not know, which is everybody, for a while."""

    def let_pass(requests: str) -> None:
        connection = HTTPConnection(endpoint.removeprefix("http://"))
        connection.request("POST", "/moto-api/reset-auth", requests.encode())
        assert connection.getresponse().status == 200
        connection.close()

    let_pass("0")
    try:
        yield
    finally:
        let_pass("inf")


class Faults(Server):
    """A proxy before a server that answers some requests badly, each a few times only.

    Attributes:
        endpoint: its address.
        seen: how often each method and path came.
        passed: how often each reached the server.
        failed: how many requests were answered badly.
        fault: says for a method, a path and how often it came before what happens: ``"503"`` (or
            another status), ``"cut"`` (half of the body comes), ``"drop"`` (nothing comes), None.
    """

    def __init__(self, behind: str) -> None:
        super().__init__(protocol="HTTP/1.1")
        self.endpoint, self.behind = self.url.rstrip("/"), behind.removeprefix("http://")
        self.seen: Counter[tuple[str, str]] = Counter()
        self.passed: Counter[tuple[str, str]] = Counter()
        self.failed = 0
        self.fault: Callable[[str, str, int], str | None] = lambda *_: None

    def answer(self, request: BaseHTTPRequestHandler) -> None:
        body = request.rfile.read(int(request.headers.get("content-length", 0)))
        place = request.command, request.path.partition("?")[0]
        before = self.seen[place]
        self.seen[place] += 1
        fault = self.fault(*place, before)
        self.failed += fault is not None
        self.passed[place] += fault in {None, "cut"}
        if fault == "drop":
            request.close_connection = True
            return
        if fault is not None and fault != "cut":
            status, _, code = fault.partition(" ")
            text = f"<Error><Code>{code}</Code><Message>no</Message></Error>".encode()
            _send(request, int(status), {}, text, len(text))
            return
        behind = HTTPConnection(self.behind, timeout=30)
        headers = {name: value for name, value in request.headers.items() if name.lower() != "host"}
        behind.request(request.command, request.path, body, headers | {"Host": self.behind})
        reply = behind.getresponse()
        data = reply.read()
        size = len(data) or int(reply.headers.get("content-length", 0))
        fields = {k: v for k, v in reply.getheaders() if k.lower() not in _HOP}
        _send(request, reply.status, fields, data[: len(data) // 2] if fault else data, size)
        request.close_connection = fault is not None
        behind.close()


def _send(
    request: BaseHTTPRequestHandler, status: int, headers: dict[str, str], data: bytes, stated: int
) -> None:
    request.send_response(status)
    for name, value in headers.items():
        request.send_header(name, value)
    request.send_header("Content-Length", str(stated))
    request.end_headers()
    if request.command != "HEAD":
        request.wfile.write(data)
        request.wfile.flush()
