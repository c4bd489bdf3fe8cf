"""Reading a depth map from any file of depth, also one frame of a depth video."""

from pathlib import Path

from depthcli.errors import InputError, UsageError
from depthcli.io.depth.read import read_stored_depth
from depthcli.io.depth.stored import StoredDepth
from depthcli.io.storage.transfer import local_copy
from depthcli.video.depth import DepthVideo

_VIDEO_SUFFIX = ".mkv"
_SCALED_SUFFIXES = (".png", _VIDEO_SUFFIX, ".npy")


def read_map(path: Path, *, scale: float | None = None, frame: int | None = None) -> StoredDepth:
    """A depth map from any file that depthcli writes; for a video, that of frame number ``frame``.

    ``scale`` is units per metre of integers; None for what the file states.

    Raises:
        InputError: missing, damaged, without depth, or a video without this frame.
        UsageError: a video without a frame number, or a frame number or scale for another file.
    """
    check_scale(path, scale)
    if is_depth_video(path):
        if frame is None:
            raise UsageError(
                f"{path} is a video; name one frame with --frame, 0 for the first ('convert' "
                "writes all to a pattern such as depth.%04d.exr)"
            )
        with local_copy(path) as video:
            return _video_frame(DepthVideo(video, scale=scale), str(path), scale, frame)
    if frame is not None:
        raise UsageError(f"--frame is for depth videos (.mkv), but {path} is not one; remove it")
    return read_stored_depth(path, png_scale=scale)


def is_depth_video(path: Path) -> bool:
    """Whether a file is a depth video, by its suffix."""
    return path.suffix.lower() == _VIDEO_SUFFIX


def check_scale(path: Path, scale: float | None) -> None:
    """Refuse a scale for a file that cannot hold integers.

    Raises:
        UsageError: there is one.
    """
    if scale is not None and path.suffix.lower() not in _SCALED_SUFFIXES:
        raise UsageError(
            f"a scale is for PNG, depth videos (.mkv) and NPY of integers, but {path} is none of "
            "them; remove it"
        )


def _video_frame(video: DepthVideo, name: str, scale: float | None, number: int) -> StoredDepth:
    from depthcli.video.depth_frames import depth_frames  # noqa: PLC0415 - loads FFmpeg

    count = 0
    for count, stored in enumerate(depth_frames(video, name=name, scale=scale), start=1):
        if count > number:
            return stored
    raise InputError(f"{name} has no frame {number}; its last one is {count - 1}")
