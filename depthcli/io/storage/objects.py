"""Requests to object stores and HTTP servers: the only place that knows how they are made.

Requests that fail for a reason that passes (throttling, a server's error, a lost connection) are
made again with exponential backoff and jitter; a body that breaks off is read on from there.
"""

from __future__ import annotations

import errno
import os
import re
import time
from contextlib import contextmanager
from functools import cache
from itertools import count
from typing import TYPE_CHECKING, Any, NamedTuple
from urllib.parse import unquote, urlsplit

from depthcli.core.extras import INSTALL_CLOUD
from depthcli.errors import UsageError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping
    from pathlib import Path

    from obstore.store import ClientConfig, ObjectStore, RetryConfig

RETRIES_VARIABLE = "DEPTHCLI_RETRIES"
_HTTP_URI = r"(?i)(https?://)(?:[^/@\s]*@)?([^?\s]*)(\?\S*)?"
_PART_BYTES = 8 << 20
_PAGE = 1000
_MOST_PARTS = 9_000  # S3 takes 10 000
_REASONS = {
    "NoSuchBucket": (errno.ENOENT, "no such bucket"),
    "incorrectly configured region": (
        errno.EINVAL,
        "it is in another region; set AWS_DEFAULT_REGION",
    ),
    "SlowDown": (errno.EBUSY, "the store is overloaded (SlowDown); try again, with less at once"),
    "InvalidAccessKeyId": (
        errno.EACCES,
        "access denied: the store does not know these credentials",
    ),
    "SignatureDoesNotMatch": (errno.EACCES, "access denied: the secret key is wrong"),
    "ExpiredToken": (errno.EACCES, "access denied: the credentials have expired"),
    "status code: 401": (errno.EACCES, "access denied; check the credentials"),
    "status code: 403": (errno.EACCES, "access denied; check the credentials and their rights"),
    "status code: 404": (errno.ENOENT, "no such object"),
    "status code: 405": (errno.ENOTSUP, "the server cannot do this"),
    "status code: 429": (errno.EBUSY, "too many requests; try again, with less at once"),
    "status code: 501": (errno.ENOTSUP, "the server cannot do this"),
    "status code: 507": (errno.ENOSPC, "the store is full"),
    "status code: 5": (errno.EIO, "the store answers with errors; try again later"),
    "status code: 416": (errno.ERANGE, "the range is beyond its end"),
    "Range request not supported": (errno.ENOTSUP, "the server does not support range requests"),
    "Content-Length Header missing": (
        errno.EINVAL,
        "the server does not say how large it is; download it to a file",
    ),
    "timed out": (errno.ETIMEDOUT, "no answer came in time; check the network"),
    "error sending request": (errno.EHOSTUNREACH, "it cannot be reached; check host and network"),
    "Error parsing Path": (errno.EINVAL, "a name with an empty, '.' or '..' part cannot be read"),
    "empty path segment": (errno.EINVAL, "a name with an empty, '.' or '..' part cannot be read"),
}


class Address(NamedTuple):
    """Where an object or a folder is."""

    base: str  #: scheme and bucket, or server: ``s3://bucket``
    key: str  #: name in it, without a slash at its beginning
    query: str  #: of an HTTP address
    name: str  #: what messages call it


class ObjectInfo(NamedTuple):
    """What a store knows of an object."""

    size: int  #: in bytes
    time_s: int  #: when it was written, in seconds
    notes: Mapping[str, str]  #: what was noted when it was


def object_info(place: Address) -> ObjectInfo:
    """What there is to know of an object without its content."""
    found = _ask("get", place, options={"head": True})
    time_s = int(found.meta["last_modified"].timestamp())
    return ObjectInfo(found.meta["size"], time_s, dict(found.attributes))


def read(place: Address, max_bytes: int | None = None) -> bytes:
    """An object's content, by one request."""
    found = _ask("get", place)
    if max_bytes is not None and found.meta["size"] > max_bytes:
        raise OSError(errno.EFBIG, f"it has more than {max_bytes:,} bytes", place.name)
    with _as_os_errors(place):
        return bytes(found.bytes())


def read_first(place: Address, length: int) -> bytes:
    """The first so many bytes of an object, and no more of it."""
    try:
        return bytes(_ask("get_range", place, start=0, length=length))
    except OSError as error:
        if error.errno == errno.ERANGE:  # of nothing, there is no first byte
            return b""
        if error.errno == errno.ENOTSUP:  # some servers only give all
            return read(place)[:length]
        raise


def parts(place: Address) -> Iterator[bytes]:
    """An object's content, a few megabytes at a time; the first item is its size in decimals."""
    found = _ask("get", place)
    yield str(found.meta["size"]).encode()
    with _as_os_errors(place):
        for part in found.stream(min_chunk_size=_PART_BYTES):
            yield bytes(part)


def put(place: Address, file: Path, notes: Mapping[str, str] | None = None) -> None:
    """Send a file; large ones in parts. The object appears, or is replaced, when all is there."""
    part_bytes = max(_PART_BYTES, file.stat().st_size // _MOST_PARTS)
    _ask("put", place, file, chunk_size=part_bytes, attributes=dict(notes or {}))


def delete(place: Address) -> None:
    """Delete an object; that it is gone already is no error."""
    _ask("delete", place)


def list_names(place: Address, after: str = "") -> Iterator[str]:
    """Names below a folder, as they come, behind one of them."""
    start = f"{place.key}/" if place.key else ""
    pages: Iterator[Any] | None = None

    def page() -> Any:  # noqa: ANN401 - a list of the library's
        nonlocal pages
        if pages is None:  # at the beginning, and where the last one broke off
            offset = start + after if after else None
            pages = _library(place).list(
                _address(place)[0], start or None, offset=offset, chunk_size=_PAGE
            )
        waiting, pages = pages, None
        found = next(waiting, ())
        pages = waiting
        return found

    while found := _tried(place, page):
        for one in found:
            after = one["path"][len(start) :]
            yield after


def masked(text: str) -> str:
    """A text without the passwords and signatures that addresses in it carry."""
    return re.sub(_HTTP_URI, lambda found: found[1] + found[2], text)


def _ask(verb: str, place: Address, *words: Any, **options: Any) -> Any:  # noqa: ANN401
    """Make a request."""
    return _tried(
        place, lambda: getattr(_library(place), verb)(*_address(place), *words, **options)
    )


def _tried(place: Address, request: Callable[[], Any]) -> Any:  # noqa: ANN401
    """Make a request, again where its answer breaks off: the library reads on in objects only.

    Raises:
        OSError: it failed.
    """
    from random import uniform  # noqa: PLC0415 - little used, and slow to load

    for tries in count():
        with _as_os_errors(place):
            try:
                return request()
            except _library(place).exceptions.BaseError as error:
                if "body error" not in str(error) or tries >= _retries():
                    raise
        time.sleep(uniform(0.5, 1) * min(15, 0.1 * 2**tries))  # noqa: S311 - jitter
    return None


def _retries() -> int:
    """How often a request is made again."""
    word = os.environ.get(RETRIES_VARIABLE, "10")
    if not word.isdecimal():
        raise UsageError(f"{RETRIES_VARIABLE} is {word!r}; set it to a number such as 10")
    return int(word)


def _library(place: Address) -> Any:  # noqa: ANN401 - a module
    try:
        import obstore.exceptions  # noqa: PLC0415 - in an extra
    except ModuleNotFoundError:
        reason = f"this needs obstore; install it with: {INSTALL_CLOUD}"
        raise OSError(errno.ENOPKG, reason, place.name) from None
    return obstore


def _address(place: Address) -> tuple[ObjectStore, str]:
    if place.query:  # a signed address is one object
        return _store(f"{place.base}/{place.key}?{place.query}"), ""
    return _store(place.base), place.key


@cache
def _store(uri: str) -> ObjectStore:
    """A bucket, or an HTTP server; connections are kept."""
    from obstore.store import HTTPStore, from_url  # noqa: PLC0415

    client: ClientConfig = {
        "allow_http": True,  # whoever names an http:// address or endpoint wants it
        "connect_timeout": "10s",
        "read_timeout": "60s",
        "timeout": "1d",  # of the whole body: a video may take long
    }
    retry: RetryConfig = {"max_retries": _retries()}
    parts = urlsplit(uri)
    if parts.scheme == "s3":
        provider = _aws_credentials()
        return from_url(
            uri, client_options=client, retry_config=retry, credential_provider=provider
        )
    if not parts.scheme.startswith("http"):
        return from_url(uri, client_options=client, retry_config=retry)
    if parts.username is not None:
        from base64 import b64encode  # noqa: PLC0415 - little used

        words = f"{unquote(parts.username)}:{unquote(parts.password or '')}"
        client["default_headers"] = {"authorization": f"Basic {b64encode(words.encode()).decode()}"}
        uri = uri.replace(f"{parts.netloc.rpartition('@')[0]}@", "", 1)
    return HTTPStore.from_url(uri, client_options=client, retry_config=retry)


def _aws_credentials() -> Any:  # noqa: ANN401 - boto3 has no types
    """Profiles, single sign-on and roles as AWS's own tools find them; None for the variables."""
    if {"AWS_ACCESS_KEY_ID", "AWS_SKIP_SIGNATURE"} & os.environ.keys():
        return None
    try:
        from obstore.auth.boto3 import Boto3CredentialProvider  # noqa: PLC0415 - in an extra

        return Boto3CredentialProvider()
    except ModuleNotFoundError:
        return None
    except ValueError:
        raise PermissionError(
            errno.EACCES,
            "no AWS credentials found; sign in ('aws configure'), or set AWS_SKIP_SIGNATURE=true "
            "for a public bucket",
        ) from None


@contextmanager
def _as_os_errors(place: Address) -> Iterator[None]:
    """The library's errors as those of files, one line each."""
    library = _library(place)
    try:
        yield
    except (library.exceptions.BaseError, ValueError, OSError) as error:
        if isinstance(error, OSError) and error.errno is not None:
            raise
        text = str(error)
        # A traceback would show the signature that the library's text has.
        origin = None if place.query or "@" in place.base else error
        for sign, (number, reason) in _REASONS.items():
            if sign in text:
                raise OSError(number, reason, place.name) from origin
        first = masked(text.partition("\n")[0])
        raise OSError(errno.EIO, first, place.name) from origin
