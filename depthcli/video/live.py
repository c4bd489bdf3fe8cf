"""Names of live streams: addresses and cameras, which are read until they are stopped."""

from __future__ import annotations

import re
import sys
import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from depthcli.errors import UsageError
from depthcli.io.storage.paths import safe_name

_ADDRESS = re.compile(r"(?i)(rtsps?|https?)://")
_PLAYLIST = re.compile(r"(?i)https?://[^?#]*\.m3u8([?#]|$)")
_DEVICE = re.compile(r"/dev/video\d+", re.ASCII)
_CAMERA_FORMATS = {"linux": "v4l2", "darwin": "avfoundation"}


@dataclass(frozen=True, slots=True)
class LiveStream:
    """A camera or an address, which is read until it is stopped."""

    address: str  #: what FFmpeg opens: an address, or a camera's device
    device_format: str | None = None  #: FFmpeg's reader of cameras; None for an address
    stop: threading.Event = field(default_factory=threading.Event)  #: ends the frames once set
    say: Callable[[str], object] = str  #: told, in another thread, when it is lost and found again

    def __str__(self) -> str:
        return safe_name(self.address)


def live_stream(
    name: str, *, is_live: bool = False, say: Callable[[str], object] = str
) -> LiveStream | None:
    """The stream that an input's name stands for; None for a file.

    That is a camera by its number or device, and an address of RTSP or an HLS playlist; with
    ``is_live``, any address of HTTP, which is a file otherwise. UsageError if a file is to be live,
    or this system's cameras cannot be read.
    """
    is_camera = _DEVICE.fullmatch(name) or (name.isdecimal() and not Path(name).exists())
    if is_camera:
        reader = _CAMERA_FORMATS.get(sys.platform)
        if reader is None:
            raise UsageError(f"{name}: cameras can be read on Linux and macOS only")
        device = f"/dev/video{name}" if name.isdecimal() and reader == "v4l2" else name
        return LiveStream(device, reader, say=say)
    if _PLAYLIST.match(name) or (_ADDRESS.match(name) and (is_live or name[:4].lower() == "rtsp")):
        return LiveStream(name, say=say)
    if is_live:
        raise UsageError(f"{safe_name(name)} is neither a camera nor an address", option="live")
    return None
