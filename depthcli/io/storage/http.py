"""Files behind HTTP, read with Python's own client; those of Hugging Face also from a mirror."""

import errno
import ipaddress
import os
import re
import socket
from base64 import b64encode
from collections.abc import Callable, Iterator
from contextlib import suppress
from email.utils import parsedate_to_datetime
from functools import partial
from http.client import HTTPException
from itertools import count
from typing import Any
from urllib.error import HTTPError, URLError
from urllib.parse import quote, unquote, urlsplit
from urllib.request import HTTPRedirectHandler, Request, build_opener

_HUB = "https://huggingface.co"  #: HF_ENDPOINT names a mirror, HF_TOKEN is sent to both alone
_TIMEOUT_S = 60
_PART_BYTES = 8 << 20
_PARTIAL = 206
_RANGE = re.compile(r"bytes (\d+)-\d+/(?:(\d+)|\*)", re.ASCII)
_TRANSIENT = frozenset((429, 500, 502, 503, 504))
ERRORS = (HTTPException, OSError, ValueError)  #: of requests; OSError has no number
_SAFE = "%/:=&?~+!$,;'@()*[]"


class _Redirects(HTTPRedirectHandler):
    """Redirects, but none to a private or local address that the user did not name.

    A server outside could have files of the network read that this machine is in, or secrets of a
    cloud machine's metadata service.
    """

    def redirect_request(self, req: Request, *words: Any) -> Request | None:  # noqa: ANN401
        """Make the next request."""
        scheme, host = urlsplit(words[-1]).scheme, urlsplit(words[-1]).hostname or ""
        if scheme not in {"http", "https"}:
            raise OSError(errno.EACCES, f"it leads to {scheme}://, which is not read")
        if host != (req.origin_req_host or "") and _is_private(host):
            raise OSError(errno.EACCES, f"it leads to the private address {host}; name that itself")
        return super().redirect_request(req, *words)


_OPENER = build_opener(_Redirects)


def head(url: str) -> tuple[int, int]:
    """Size in bytes, and time in seconds since the epoch, of a file."""
    with _opened(url, method="HEAD") as answer:
        modified = answer.headers.get("Last-Modified")
        return _size(answer), int(parsedate_to_datetime(modified).timestamp()) if modified else 0


def fetch(
    url: str, retries: int, pause: Callable[[int], None], start: int = 0
) -> tuple[int, Iterator[bytes]]:
    """Size of a file, and its content from a byte on in parts; resumed where it is cut off."""
    headers = {"Range": f"bytes={start}-"} if start else None
    answer = _retried(lambda: _opened(url, headers), retries, pause)
    (first, size), tag = _range_of(answer, start), answer.headers.get("ETag", "")

    def parts() -> Iterator[bytes]:
        source, done = answer, first
        for tries in count():
            with suppress(HTTPException, OSError), source:
                while done < size and (part := source.read(_PART_BYTES)):
                    yield part[max(0, start - done) :]  # a server without ranges sends all of it
                    done += len(part)
            if done >= size:
                return
            if tries == retries:
                raise OSError(errno.EIO, "it is cut off; try again later")
            pause(tries)
            headers = {"Range": f"bytes={done}-", **({"If-Range": tag} if tag else {})}
            source = _retried(partial(_opened, url, headers), retries, pause)
            if _range_of(source, done)[0] != done:
                raise OSError(errno.EIO, "it is cut off, and the server cannot go on there")

    return size, parts()


def _range_of(answer: Any, start: int) -> tuple[int, int]:  # noqa: ANN401
    """First byte of an answer, and the size of the whole file; OSError if another range came."""
    if answer.status != _PARTIAL:
        return 0, _size(answer)
    match = _RANGE.match(answer.headers.get("Content-Range", ""))
    if match is None or int(match[1]) != start:
        raise OSError(errno.EIO, "the server answers with another part of it; try again later")
    return start, int(match[2]) if match[2] else start + _size(answer)


def _opened(url: str, headers: dict[str, str] | None = None, method: str = "GET") -> Any:  # noqa: ANN401
    hub = os.environ.get("HF_ENDPOINT", _HUB).rstrip("/")
    if url.startswith(f"{_HUB}/"):
        url = hub + url.removeprefix(_HUB)
    parts = urlsplit(url)
    path = parts.path if unquote(parts.path) != parts.path else quote(parts.path)
    target = parts._replace(netloc=parts.netloc.rpartition("@")[2], path=path)
    request = Request(quote(target.geturl(), _SAFE), headers=headers or {}, method=method)  # noqa: S310
    if parts.username is not None:
        words = f"{unquote(parts.username)}:{unquote(parts.password or '')}"
        secret = b64encode(words.encode()).decode()
        request.add_unredirected_header("Authorization", f"Basic {secret}")
    elif (token := os.environ.get("HF_TOKEN")) and url.startswith(f"{hub}/"):
        request.add_unredirected_header("Authorization", f"Bearer {token}")
    return _OPENER.open(request, timeout=_TIMEOUT_S)


def _retried(request: Callable[[], Any], retries: int, pause: Callable[[int], None]) -> Any:  # noqa: ANN401
    """The answer to a request, which is repeated if it fails for a moment."""
    for tries in range(retries + 1):
        try:
            return request()
        except HTTPError as error:
            if error.code not in _TRANSIENT or tries == retries:
                raise
        except (URLError, HTTPException, ConnectionError, TimeoutError) as error:
            is_final = isinstance(getattr(error, "reason", None), PermissionError | socket.gaierror)
            if is_final or tries == retries:
                raise
        pause(tries)
    return None


def _size(answer: Any) -> int:  # noqa: ANN401
    length = answer.headers.get("Content-Length")
    if length is None:
        advice = "download it to a file, or give a live stream to 'depthcli video --live'"
        raise OSError(errno.EINVAL, f"the server does not say how large it is; {advice}")
    return int(length)


def _is_private(host: str) -> bool:
    """Whether a host has an address that is not of the public internet."""
    try:
        addresses = {info[4][0] for info in socket.getaddrinfo(host, None)}
    except OSError:
        return False  # connecting says what is wrong
    return not all(ipaddress.ip_address(str(ip).partition("%")[0]).is_global for ip in addresses)
