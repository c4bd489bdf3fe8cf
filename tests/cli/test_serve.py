"""``depthcli serve``: a server asked as its clients ask it."""

import http.client
import json
import re
import resource
import select
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from queue import SimpleQueue
from typing import Any, NamedTuple
from urllib.parse import urlencode, urlsplit

import cv2
import numpy as np
import pytest
from helpers.bad_images import JPEGS
from helpers.command_line import Cli, unmeasured
from helpers.tiny import synthetic_image

from depthcli.cli.commands.serve import _REFUSED, _command, parse_request
from depthcli.core.options import DepthMask, Eye
from depthcli.errors import UsageError
from depthcli.inference.loading import SessionLoader
from depthcli.jobs import serve


class Reply(NamedTuple):
    status: int
    headers: http.client.HTTPMessage
    body: bytes


class Server(NamedTuple):
    process: subprocess.Popen[str]
    address: str

    def ask(
        self, path: str, body: bytes | None = None, headers: Mapping[str, str] | None = None
    ) -> Reply:
        connection = http.client.HTTPConnection(self.address, timeout=60)
        connection.request("GET" if body is None else "POST", path, body, dict(headers or {}))
        reply = connection.getresponse()
        answer = Reply(reply.status, reply.headers, reply.read())
        connection.close()
        return answer

    def predict(
        self, image: bytes, headers: Mapping[str, str] | None = None, **query: str
    ) -> Reply:
        return self.ask(f"/predict?{urlencode(query)}", image, headers)


@contextmanager
def serving(cli: Cli, *words: str, **environment: str) -> Iterator[Server]:
    """A running server; it is ended in the end."""
    process = subprocess.Popen(
        cli.command("serve", "--port", "0", *words),
        stderr=subprocess.PIPE,
        text=True,
        cwd=cli.folder,
        env={**cli.environment, **environment},
    )
    try:
        lines = iter(process.stderr.readline, "")
        address = next(line for line in lines if line.startswith("http"))  # after the log
        yield Server(process, urlsplit(address.strip()).netloc)
    finally:
        process.kill()
        process.communicate()


def png(height: int = 48, width: int = 64) -> bytes:
    return cv2.imencode(".png", synthetic_image(height, width))[1].tobytes()


LARGE = png(2000, 3000)
ANY_ADDRESS = "0.0.0.0"  # noqa: S104 - what the token is for


def test_answers_the_bytes_and_facts_of_predict(cli: Cli, inside: Cli) -> None:
    (inside.folder / "a.png").write_bytes(png())
    with serving(cli) as server:
        for format_ in ("png16", "exr", "npy", "preview"):
            words = ("predict", "a.png", "-o", "-", "--format", format_, "--focal-px", "60")
            reply = server.predict(png(), format=format_, focal_px="60")
            assert (reply.status, reply.body) == (200, inside(*words).stdout)
        headers = server.predict(png(), hfov="70").headers
    wanted = json.loads(inside("predict", "a.png", "-o", "a.npy", "--hfov", "70", "--json").stdout)
    facts = json.loads(headers["Depth-Facts"])
    assert facts == {name: wanted[name] for name in facts}
    assert float(headers["Depth-Median"]) == wanted["median"]
    assert (headers["Depth-Unit"], headers["Content-Type"]) == ("m", "image/png")


def test_no_answer_holds_pixels_of_another_client(cli: Cli) -> None:
    """A JPEG cut within a table returned the image before as the texture of a mesh."""
    jpeg = JPEGS["progressive"]
    table = jpeg.index(b"\xff\xc4", jpeg.index(b"\xff\xda"))
    cuts = [jpeg[:length] for length in (*range(table + 5, table + 25), *range(300, len(jpeg), 97))]
    with serving(cli, "--workers", "1") as server:
        for cut in cuts:
            for format_ in ("glb", "ply"):
                assert server.predict(jpeg, format=format_).status == 200
                assert server.predict(cut, format=format_).status == 422


def form_of(**files: tuple[str, bytes]) -> tuple[bytes, dict[str, str]]:
    """A multipart form of files by name, and its header."""
    parts = [
        b'--x\r\nContent-Disposition: form-data; name="%s"; filename="%s"\r\n\r\n%s\r\n'
        % (field.encode(), name.encode(), data)
        for field, (name, data) in files.items()
    ]
    return b"".join(parts) + b"--x--\r\n", {"Content-Type": "multipart/form-data; boundary=x"}


def test_accepts_a_form_and_anchors(cli: Cli) -> None:
    form, kind = form_of(image=("/etc/a.png", png()))
    with serving(cli) as server:
        reply = server.predict(form, kind, format="npy", anchor="3,4,2.5")
        assert server.predict(form.replace(b"image", b"photo"), kind).status == 400
        assert server.predict(form.replace(b"image", b"file"), kind).status == 200
        field = b'--x\r\nContent-Disposition: form-data; name="format"\r\n\r\nexr\r\n'
        mixed = server.predict(field + form, kind)
        assert (mixed.status, b"query" in mixed.body) == (400, True)
        answer = server.predict(form, kind, anchor="3,4,2.5", anchors_fit="network")
    (cli.folder / "a.npy").write_bytes(reply.body)
    assert np.load(cli.folder / "a.npy")[4, 3] == pytest.approx(2.5)
    assert json.loads(reply.headers["Depth-Facts"])["anchors"]["fit"] == "global"
    assert json.loads(answer.headers["Depth-Facts"])["anchors"]["fit"] == "network"


def test_known_depth_comes_as_a_file_in_the_form(cli: Cli, inside: Cli) -> None:
    sparse = np.zeros((48, 64), np.uint16)
    sparse[4, 3], sparse[40, 60] = 2500 * 2, 4000 * 2
    files = {
        "a.csv": (b"x,y,depth_m\n3,4,2.5\n60,40,4\n", ()),
        "A.PNG": (cv2.imencode(".png", sparse)[1].tobytes(), ("--anchors-scale", "2000")),
    }
    (inside.folder / "image.png").write_bytes(png())
    with serving(cli) as server:
        for name, (data, more) in files.items():
            (inside.folder / name.lower()).write_bytes(data)
            words = ("--anchors", name.lower(), "--anchors-fit", "global", "--format", "npy", *more)
            expected = inside("predict", "image.png", "-o", "-", *words).stdout
            form, kind = form_of(image=("a.png", png()), anchors=(name, data))
            query = {"anchors_scale": "2000"} if "PNG" in name else {}
            reply = server.predict(form, kind, format="npy", anchors_fit="global", **query)
            assert (reply.status, reply.body) == (200, expected)
        form, kind = form_of(image=("a.png", png()), anchors=("../../etc/passwd", b"root"))
        assert server.predict(form, kind).status == 422
        form, kind = form_of(anchors=("a.csv", files["a.csv"][0]))
        assert server.predict(form, kind).status == 400


def test_refuses_requests_that_cannot_be_answered(cli: Cli) -> None:
    with serving(cli, "--max-bytes", str(len(LARGE) - 1), "--max-pixels", "5000") as server:
        statuses = [
            server.predict(png(), calibration="/etc/passwd").status,
            server.predict(png(), anchors="/etc/passwd").status,
            server.predict(png(), focal_px="-1").status,
            server.predict(png(), half="maybe").status,
            server.predict(png(), mask="model").status,
            server.predict(b"no image").status,
            server.predict(png(100, 100)).status,
            server.predict(LARGE).status,
            server.ask("/predict").status,
            server.ask("/health", headers={"Host": "attacker.example"}).status,
            server.predict(png()).status,
        ]
        assert b"the server's --max-pixels" in server.predict(png(100, 100)).body
    assert statuses == [400, 400, 400, 400, 422, 422, 422, 413, 405, 400, 200]


def test_no_option_of_a_request_names_a_file() -> None:
    for name in ("points", "anchors", "extrinsics", "calibration", "anchors_scale", "baseline"):
        with pytest.raises(UsageError):
            parse_request(((name, "1"),))
    taken = [p for p in _command.params if p.name not in _REFUSED and p.opts[-1] != "--help"]
    assert not [p.name for p in taken if p.metavar in {"FILE", "DIR", "PATH"}]


def test_a_request_may_name_options_as_the_command_does() -> None:
    assert parse_request((("mask", "model"),)).detail.mask is DepthMask.MODEL
    assert parse_request((("eye", "right"),)).reading.eye is Eye.RIGHT
    assert parse_request((("focal-px", "50"),)) == parse_request((("focal_px", "50"),))


def test_answers_429_when_the_queue_is_full(cli: Cli) -> None:
    with serving(cli, "--workers", "1", "--queue", "1") as server, ThreadPoolExecutor(6) as pool:
        replies = list(pool.map(server.predict, [LARGE] * 6))
    assert {reply.status for reply in replies} == {200, 429}
    assert all("Retry-After" in reply.headers for reply in replies if reply.status == 429)


def test_answers_503_when_an_image_takes_too_long(cli: Cli) -> None:
    with serving(cli, "--timeout", "0.01") as server:
        assert server.predict(LARGE).status == 503
        assert json.loads(server.ask("/health").body)["in_flight"] == 1  # it is still in work


def test_addresses_that_others_reach_need_a_token(cli: Cli) -> None:
    cli("serve", "--host", ANY_ADDRESS, "--port", "0", code=2)
    with serving(cli, "--host", ANY_ADDRESS, DEPTHCLI_TOKEN="secret") as server:  # noqa: S106
        local = server._replace(address=server.address.replace(ANY_ADDRESS, "127.0.0.1"))
        pod = {"Host": "10.0.0.5:8000"}  # as kubelet: kubeflow/mcp-server#91
        assert local.ask("/health", headers=pod).status == 200
        statuses = [
            local.predict(png(), {"Authorization": words}).status
            for words in ("Bearer secret", "bearer secret", "Bearer other", "Bearer ", "secret")
        ]
        assert (statuses, local.ask("/metrics").status) == ([200, 200, 401, 401, 401], 401)


def test_pages_of_an_allowed_origin_may_call_it(cli: Cli) -> None:
    # pinecone-io/canopy#319, superdesk/superdesk-core#2384
    origin = "http://localhost:3000"
    wish = {
        "Access-Control-Request-Method": "POST",
        "Access-Control-Request-Headers": "authorization",
    }
    with serving(cli, "--allow-origin", origin, "--token", "secret") as server:
        connection = http.client.HTTPConnection(server.address, timeout=60)
        for allowed in (origin, "http://other.example"):
            connection.request("OPTIONS", "/predict", headers={"Origin": allowed, **wish})
            reply = connection.getresponse()
            reply.read()
            assert (reply.status == 200) == (allowed == origin)
            sent = {"Origin": allowed, "Authorization": "Bearer secret"}
            headers = server.predict(png(), sent).headers
            assert (headers["Access-Control-Allow-Origin"] == origin) == (allowed == origin)
        connection.close()


def test_a_calibrated_camera_is_that_of_requests_that_name_none(cli: Cli) -> None:
    (cli.folder / "a.png").write_bytes(png())
    assert cli("serve", "--port", "0", "--camera", "wide").returncode == 2
    cli("calibrate", "wide", "a.png", "--anchor", "3,4,5", code=0)
    with serving(cli, "--camera", "wide") as server:
        (cli.folder / "a.npy").write_bytes(server.predict(png(), format="npy").body)
    assert np.load(cli.folder / "a.npy")[4, 3] == pytest.approx(5)


@pytest.mark.parametrize(
    ("sent", "answer"),
    [(b"GET /health HTTP/1.1\r\nX-A: ", b""), (b"POST /predict HTTP/1.1\r\n{}\r\n", b"408")],
)
def test_what_never_ends_is_ended(
    cli: Cli, sent: bytes, answer: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(serve, "IDLE_S", 1)
    session = SessionLoader(cli.models / "default", "cpu").load()
    server = serve.DepthServer(session, parse_request, serve.Limits(1, 1, 60, 10**6, 10**6))
    urls = SimpleQueue[str]()
    words = ("127.0.0.1", 0, urls.put)
    threading.Thread(target=server.run, args=words, daemon=True).start()
    host, port = urlsplit(urls.get()).netloc.split(":")
    with socket.create_connection((host, port), 60) as client:
        client.sendall(sent.replace(b"{}", b"Host: localhost\r\nContent-Length: 9\r\n"))
        assert client.recv(999)[9:12] == answer


def test_a_port_that_is_taken_is_one_line(cli: Cli) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        done = cli("serve", "--port", str(taken.getsockname()[1]))
    assert (done.returncode, b"--port" in done.stderr, done.stderr.count(b"\n")) == (2, True, 1)


@pytest.mark.parametrize("host", ["127.0.0.1", "::1"])
def test_states_health_and_metrics_and_shows_a_page(cli: Cli, host: str) -> None:
    with serving(cli, "--host", host) as server:
        server.predict(png())
        health = json.loads(server.ask("/health").body)
        assert (health["status"], health["in_flight"]) == ("ok", 0)
        metrics = server.ask("/metrics").body.decode().splitlines()
        assert 'depthcli_requests_total{status="200"} 1.0' in metrics
        assert "depthcli_seconds_count 1.0" in metrics
        page = server.ask("/")
        assert page.headers["Content-Type"].startswith("text/html")
        assert b"http" not in page.body.replace(b"HTTP", b"")  # nothing from elsewhere
        assert b'<input type="file" accept="image/*">' in page.body  # hidden, no key would reach it


def test_a_client_that_leaves_is_counted_and_no_error_of_the_server(cli: Cli) -> None:
    with serving(cli) as server:
        with socket.create_connection(server.address.split(":"), 60) as client:
            client.sendall(
                b"POST /predict HTTP/1.1\r\nHost: localhost\r\nContent-Length: 9\r\n\r\n"
            )
            client.shutdown(socket.SHUT_WR)
            assert client.recv(1) == b""
        assert b'{status="499"} 1.0' in server.ask("/metrics").body
        server.process.terminate()
        assert server.process.stderr.read() == ""


def test_a_connection_stays_open_for_proxies_that_use_it_again(cli: Cli) -> None:
    # A proxy whose request meets the end of a connection answers 502: lsst-sqre/phalanx#5103.
    with serving(cli) as server:
        connection = http.client.HTTPConnection(server.address, timeout=60)
        connection.request("GET", "/health")
        connection.getresponse().read()
        assert not select.select([connection.sock], [], [], 6)[0]  # uvicorn's default is 5 s
        connection.close()


def test_a_signal_lets_requests_end_that_have_begun(cli: Cli) -> None:
    with serving(cli) as server, ThreadPoolExecutor(1) as pool:
        answer = pool.submit(server.predict, LARGE)
        while json.loads(server.ask("/health").body)["in_flight"] == 0:
            pass
        server.process.send_signal(signal.SIGTERM)
        assert answer.result().status == 200
        assert server.process.wait(30) == 128 + signal.SIGTERM


def test_without_the_extra_it_says_what_to_add(
    inside: Cli, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delitem(sys.modules, serve.__name__)
    monkeypatch.setitem(sys.modules, "uvicorn", None)
    done = inside("serve")
    assert (done.returncode, b"[serve]" in done.stderr) == (3, True)


@pytest.mark.skipif(sys.platform != "linux", reason="limits of another process are Linux's")
def test_a_temporary_folder_that_cannot_be_written_is_no_fault_of_an_image(cli: Cli) -> None:
    # Containers with a read-only root: metal3-io/ironic-standalone-operator#221; a full tmpfs that
    # was taken for bad requests: geolens-io/geolens#101.
    words = ("bash", "-c", 'ulimit -f 0; exec "$@"', "bash", *cli.command("serve", "--port", "0"))
    environment = unmeasured(cli.environment)
    done = subprocess.run(words, capture_output=True, env=environment, timeout=60, check=False)
    assert (done.returncode, b"TMPDIR" in done.stderr, done.stderr.count(b"\n")) == (1, True, 1)
    with serving(cli) as server:
        resource.prlimit(server.process.pid, resource.RLIMIT_FSIZE, (0, 0))
        replies = [server.predict(png()), server.predict(*form_of(image=("a", LARGE)))]
        assert [(r.status, b"temporary" in r.body) for r in replies] == [(500, True)] * 2
        assert b'{status="500"} 2.0' in server.ask("/metrics").body


def test_no_file_is_written_beside_the_server(cli: Cli, tmp_path: Path) -> None:
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    with serving(cli, TMPDIR=str(temporary)) as server:
        server.predict(png())
        server.predict(b"no image")
        assert list(cli.folder.iterdir()) == list(temporary.iterdir()) == []


#: values of what takes a text or has a range of its own, and what is needed beside others
_TEXTS = {"anchor": "1,2,3", "centre_px": "3,4", "tile": "auto", "focal_35mm": "28", "vmin": "0.1"}
_BESIDE = {
    "anchors_fit": {"anchor": "1,2,3"},
    "near": {"format": "preview"},
    "half": {"format": "exr"},
    "black_level": {"white_level": "65535"},
}
_OTHERS = {
    "camera",
    "error",
    "max_error",
    "layer",
    "projection",
    "eye",
    "mask",
    "anchors_scale",
    "anchors_kind",
    "baseline",
}
"""Those that another image, model or file would need."""


def values_of(schema: dict[str, Any]) -> list[str]:
    """All values of a schema, or the ends of its range and what lies between."""
    if "enum" in schema:
        return [*schema["enum"]]
    if schema["type"] == "boolean":
        return ["true", "false"]
    ends = [schema[end] for end in ("minimum", "maximum", "default") if end in schema]
    return [*map(str, ends), *([] if len(ends) > 1 else ["2"])]


def test_each_value_in_the_description_for_programs_is_accepted(cli: Cli) -> None:
    with serving(cli) as server:
        description = json.loads(server.ask("/openapi.json").body)
        assert b"openapi.json" in server.ask("/docs").body
        assert b"://" not in server.ask("/docs").body  # nothing from elsewhere
        operation = description["paths"]["/predict"]["post"]
        assert description["openapi"].startswith("3.1")
        assert len(operation["parameters"]) > 30
        for parameter in operation["parameters"]:
            name, schema = parameter["name"], parameter["schema"]
            assert parameter["description"].count("--") == 0
            values = [_TEXTS[name]] if name in _TEXTS else values_of(schema.get("items", schema))
            values = [value for value in values if value != "error"]  # of which tiny knows nothing
            for value in values if name not in _OTHERS else []:
                reply = server.predict(png(), **{**_BESIDE.get(name, {}), name: value})
                assert reply.status == 200, (parameter, value, reply.body)
            if "enum" in schema:
                assert server.predict(png(), **{name: "other"}).status == 400
    form = operation["requestBody"]["content"]["multipart/form-data"]["schema"]
    assert {*form["properties"]} == {"image", "file", "anchors"}
    assert operation["security"] == [{}, {"token": []}]


def test_errors_are_problems_in_json_for_those_who_accept_it(cli: Cli) -> None:
    with serving(cli) as server:
        plain = server.predict(b"no image")
        reply = server.predict(b"no image", {"Accept": "application/problem+json"})
        assert server.predict(png(), white_level="5", black_level="9").status == 400
    assert (plain.headers.get_content_type(), plain.status) == ("text/plain", 422)
    assert reply.headers.get_content_type() == "application/problem+json"
    problem = json.loads(reply.body)
    assert problem["detail"] + "\n" == plain.body.decode()
    assert (problem["status"], problem["type"]) == (422, "about:blank")


def test_requests_are_logged_with_verbose(cli: Cli) -> None:
    with serving(cli, "-v") as server:
        server.predict(png())
        server.ask("/nowhere")
        server.process.send_signal(signal.SIGTERM)
        log = server.process.communicate(timeout=60)[1]
    assert re.search(r'INFO uvicorn.access: \S+ - "POST /predict HTTP/1.1" 200', log)
    assert '"GET /nowhere HTTP/1.1" 404' in log
