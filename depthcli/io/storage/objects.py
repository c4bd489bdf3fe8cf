"""Paths of objects in a store and of files behind HTTP, and the requests for them.

Requests that fail for a transient reason (throttling, a server error, a lost connection) are
retried with exponential backoff and jitter; an interrupted download is resumed.
"""

from __future__ import annotations

import errno
import hashlib
import io
import os
import re
import stat
import time
from contextlib import contextmanager
from functools import lru_cache
from itertools import count
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any

from depthcli.core.options import INSTALL_CLOUD
from depthcli.errors import UsageError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from obstore.store import ClientConfig, ObjectStore, RetryConfig

RETRIES_VARIABLE = "DEPTHCLI_RETRIES"
_HTTP_URI = r"(?i)((?:https?|rtsps?)://)(?:[^/@\s]*@)?([^?\s]*)(\?\S*)?"
_PART_BYTES = 8 << 20
_PAGE_NAMES = 1000
_MAX_PARTS = 9_000  # S3 takes 10 000
SHA256_KEY = "sha256"  #: of an object's metadata
_MAX_CLIENTS = 32  # each keeps connections open
NO_PATH = "a name with an empty, '.' or '..' part cannot be read"
_REASONS = {
    "NoSuchBucket": (errno.ENOENT, "no such bucket"),
    "configured region": (errno.EINVAL, "it is in another region; set AWS_DEFAULT_REGION"),
    "get_credentials": (
        errno.EACCES,
        "no AWS credentials; sign in ('aws configure'), or set AWS_SKIP_SIGNATURE=true if public",
    ),
    "Account must be": (errno.EACCES, "no account is given; set AZURE_STORAGE_ACCOUNT_NAME"),
    "status code: 401": (errno.EACCES, "access denied; check the credentials"),
    "status code: 403": (errno.EACCES, "access denied; check the credentials and their rights"),
    "status code: 404": (errno.ENOENT, "no such object"),
    "status code: 5": (errno.EIO, "the store answers with errors; try again later"),
    "status code: 416": (errno.ERANGE, "it is empty"),
    "timed out": (errno.ETIMEDOUT, "no answer came in time; check the network"),
    "urlopen error": (errno.EHOSTUNREACH, "it cannot be reached; check host and network"),
    "error sending request": (errno.EHOSTUNREACH, "it cannot be reached; check host and network"),
    "Error parsing Path": (errno.EINVAL, NO_PATH),
    "object with invalid path": (errno.EINVAL, NO_PATH),
}


class RemotePath(Path, PurePosixPath):
    """An object, or a prefix as a folder, with the methods of a path that are used here.

    ``str`` gives the URI without its password and its query, for messages; no local file has such
    a name.
    """

    query = ""  #: of an HTTP address, such as a signature; paths derived from this one have none

    @property
    def base(self) -> str:
        """Scheme and bucket or host, as ``s3://bucket``; with the password, if there is one."""
        return "//".join(self.parts[:2])

    @property
    def key(self) -> str:
        """The name inside the bucket."""
        return "/".join(self.parts[2:])

    @property
    def url(self) -> str:
        """The whole address, with its password and its query."""
        return f"{self.base}/{self.key}" + (f"?{self.query}" if self.query else "")

    @property
    def is_http(self) -> bool:
        """Whether it is behind HTTP, where files cannot be written or listed."""
        return self.parts[0].startswith("http")

    def __str__(self) -> str:
        if not self.parts or not self.parts[0].endswith(":"):  # relative to a folder
            return "/".join(self.parts) or "."
        return masked(f"{self.base}/{self.key}").rstrip("/")

    def __fspath__(self) -> str:
        return str(self)

    def __reduce__(self) -> Any:  # noqa: ANN401 - what pickle asks for
        return RemotePath, (f"{self.base}/{self.key}",), {"query": self.query}

    def stat(self, **_: Any) -> os.stat_result:  # noqa: ANN401
        """Size and time of the object; a prefix with objects below it is a folder."""
        try:
            size, time_s = head(self)[:2]
        except FileNotFoundError:
            if not self.is_dir():
                raise
            return os.stat_result((stat.S_IFDIR, *bytes(9)))
        return os.stat_result((stat.S_IFREG, *bytes(5), size, time_s, time_s, time_s))

    def exists(self, **_: Any) -> bool:  # noqa: ANN401 - as a path has it
        """Whether there is such an object or folder."""
        try:
            self.stat()
        except FileNotFoundError:
            return False
        return True

    def is_file(self, **_: Any) -> bool:  # noqa: ANN401
        """Whether there is such an object."""
        try:
            # A signed address allows reading only; without the right to list, S3 answers 403 for
            # missing objects.
            return bool(self.query or head(self))
        except (FileNotFoundError, PermissionError):
            return False

    def is_dir(self, **_: Any) -> bool:  # noqa: ANN401
        """Whether there are objects below it; False behind HTTP."""
        try:
            return not self.is_http and next(self.walk_names(), None) is not None
        except FileNotFoundError:  # the bucket itself
            return False

    def absolute(self, *_: Any, **__: Any) -> RemotePath:  # noqa: ANN401
        """Return the path itself."""
        return self

    resolve = absolute

    def mkdir(self, *_: Any, **__: Any) -> None:  # noqa: ANN401
        """Do nothing: stores have no folders to make."""

    def unlink(self, *_: Any, **__: Any) -> None:  # noqa: ANN401
        """Delete the object; a missing one is not an error."""
        _send_request("delete", self)

    def read_bytes(self, max_bytes: int | None = None, *, first: int = -1) -> bytes:
        """The object, if it is not larger than ``max_bytes``, or its ``first`` bytes."""
        if first < 0:
            return b"".join(fetch(self, max_bytes)[1])
        if self.is_http:
            return next(fetch(self)[1], b"")[:first]
        return bytes(_send_request("get_range", self, start=0, length=first))

    def open(self, mode: str = "r", *_: Any, **__: Any) -> Any:  # noqa: ANN401
        """Open the content for reading; the mode is ``rb``."""
        if mode != "rb":
            raise io.UnsupportedOperation(f"{self} is written as a whole, not opened as {mode!r}")
        return io.BytesIO(self.read_bytes())

    def walk_names(self, after: str = "") -> Iterator[str]:
        """Names of all objects below it after a name, in the order of their bytes, page by page."""
        start = f"{self.key}/" if self.key else ""
        pages: Iterator[Any] | None = None

        def page() -> Any:  # noqa: ANN401 - a list of the library's
            nonlocal pages
            if pages is None:  # at the beginning, and after a failed request
                offset = start + after if after else None
                pages = _library(self).list(
                    _store(self.base), start or None, offset=offset, chunk_size=_PAGE_NAMES
                )
            waiting, pages = pages, None
            batch = next(waiting, ())
            pages = waiting
            return batch

        try:
            while batch := _with_retries(self, page):
                for entry in batch:
                    after = entry["path"][len(start) :]
                    yield after
        except OSError as error:  # one key of a page that is no path ends it
            if error.strerror != NO_PATH or not self.base.startswith("s3://"):
                raise
            yield from _names_by_boto3(self.base.removeprefix("s3://"), start, after)


def _names_by_boto3(bucket: str, start: str, after: str) -> Iterator[str]:
    """Names after one of all objects below a prefix of S3, also those that are no paths."""
    import boto3  # noqa: PLC0415 - in an extra

    client = boto3.client("s3", region_name=os.environ.get("AWS_REGION"))
    place = {"Bucket": bucket, "Prefix": start, "StartAfter": start + after}
    for page in client.get_paginator("list_objects_v2").paginate(**place):
        yield from (entry["Key"][len(start) :] for entry in page.get("Contents", ()))


def head(address: RemotePath) -> tuple[int, int, Mapping[str, str]]:
    """Size in bytes, time in seconds since the epoch, and user metadata of an object."""
    if address.is_http:
        with _as_os_errors(address):
            return *_http().head(address.url), {}
    answer = _send_request("get", address, options={"head": True})
    time_s = int(answer.meta["last_modified"].timestamp())
    return answer.meta["size"], time_s, dict(answer.attributes)


def fetch(
    address: RemotePath, max_bytes: int | None = None, start: int = 0
) -> tuple[int, Iterator[bytes]]:
    """Size of an object, and its content from a byte on in parts, by one request."""
    if address.is_http:
        with _as_os_errors(address):
            size, content = _http().fetch(address.url, _retries(), _pause, start)
    else:
        options = {"range": {"offset": start}} if start else None
        answer = _send_request("get", address, options=options)
        size, content = answer.meta["size"], answer.stream(min_chunk_size=_PART_BYTES)
    if max_bytes is not None and size > max_bytes:
        raise OSError(errno.EFBIG, f"it has more than {max_bytes:,} bytes", str(address))

    def parts() -> Iterator[bytes]:
        with _as_os_errors(address):
            yield from map(bytes, content)

    return size, parts()


def put(address: RemotePath, file: Path) -> None:
    """Upload a file, in parts if it is large, with its checksum as metadata.

    The object appears, or is replaced, at the end.
    """
    part_bytes = max(_PART_BYTES, file.stat().st_size // _MAX_PARTS)
    with file.open("rb") as content:
        metadata = {SHA256_KEY: hashlib.file_digest(content, SHA256_KEY).hexdigest()}
    _send_request("put", address, file, chunk_size=part_bytes, attributes=metadata)


def masked(text: str) -> str:
    """A text without the passwords and signatures of URLs in it."""
    return re.sub(_HTTP_URI, lambda match: match[1] + match[2], text)


def _send_request(verb: str, address: RemotePath, *words: Any, **options: Any) -> Any:  # noqa: ANN401
    call = getattr(_library(address), verb)
    return _with_retries(
        address, lambda: call(_store(address.base), address.key, *words, **options)
    )


def _with_retries(address: RemotePath, request: Callable[[], Any]) -> Any:  # noqa: ANN401
    """Make a request again if its body is interrupted: obstore resumes only object downloads."""
    for tries in count():
        with _as_os_errors(address):
            try:
                return request()
            except _library(address).exceptions.BaseError as error:
                if "body error" not in str(error) or tries >= _retries():
                    raise
        _pause(tries)
    return None


def _pause(tries: int) -> None:
    from random import uniform  # noqa: PLC0415 - little used, and slow to load

    time.sleep(uniform(0.5, 1) * min(15, 0.1 * 2**tries))  # noqa: S311 - jitter


def _retries() -> int:
    word = os.environ.get(RETRIES_VARIABLE, "10")
    if not word.isdecimal():
        raise UsageError(f"{RETRIES_VARIABLE} is {word!r}; set it to a number such as 10")
    return int(word)


def _http() -> Any:  # noqa: ANN401 - a module
    from depthcli.io.storage import http  # noqa: PLC0415 - Python's client is slow to load

    return http


def _library(address: RemotePath) -> Any:  # noqa: ANN401 - a module
    try:
        import obstore.exceptions  # noqa: PLC0415 - in an extra
    except ModuleNotFoundError:
        reason = f"this needs obstore; install it with: {INSTALL_CLOUD}"
        raise OSError(errno.ENOPKG, reason, str(address)) from None
    return obstore


@lru_cache(_MAX_CLIENTS)
def _store(uri: str) -> ObjectStore:
    """The client of a bucket, cached to reuse connections."""
    from obstore.store import from_url  # noqa: PLC0415

    client: ClientConfig = {
        "allow_http": True,  # whoever names an http:// address or endpoint wants it
        "connect_timeout": "10s",
        "read_timeout": "60s",
        "timeout": "1d",  # of the whole body: a video may take long
    }
    retry: RetryConfig = {"max_retries": _retries()}
    more: dict[str, Any] = (
        {"credential_provider": _aws_credentials()} if uri.startswith("s3://") else {}
    )
    return from_url(uri, client_options=client, retry_config=retry, **more)


def _aws_credentials() -> Any:  # noqa: ANN401 - boto3 has no types
    """Credentials of profiles, single sign-on and roles; None if obstore reads the environment."""
    if {"AWS_ACCESS_KEY_ID", "AWS_SKIP_SIGNATURE"} & os.environ.keys():
        return None
    try:
        from obstore.auth.boto3 import Boto3CredentialProvider  # noqa: PLC0415 - in an extra

        return Boto3CredentialProvider()
    except ModuleNotFoundError:
        return None


@contextmanager
def _as_os_errors(address: RemotePath) -> Iterator[None]:
    """Raise the library's errors as ``OSError``, of one line each."""
    errors = _http().ERRORS if address.is_http else (_library(address).exceptions.BaseError,)
    try:
        yield
    except (*errors, ValueError, OSError) as error:
        if isinstance(error, OSError) and error.errno is not None:
            raise
        code = getattr(error, "code", None)  # of an answer of HTTP
        text = str(error) if code is None else f"status code: {code}"
        # A traceback would show the signature in the library's message.
        origin = None if address.query or "@" in address.base else error
        for sign, (number, reason) in _REASONS.items():
            if sign in text:
                raise OSError(number, reason, str(address)) from origin
        first = masked(text.partition("\n")[0])
        raise OSError(errno.EIO, first, str(address)) from origin
