"""Converting the frames of a depth video to numbered files."""

from collections.abc import Generator
from contextlib import closing
from dataclasses import replace

from depthcli.core.parallel.opencv_threads import one_thread_each
from depthcli.core.parallel.ordered_map import ordered_map
from depthcli.errors import InputError, UsageError
from depthcli.io.depth.stored import StoredDepth
from depthcli.io.storage.remote import path_of, safe_name
from depthcli.io.storage.transfer import local_copy
from depthcli.jobs.convert import ConvertRequest, ConvertResult, target_format, write_converted
from depthcli.jobs.depth_files import is_depth_video
from depthcli.jobs.naming import is_folder
from depthcli.video.depth import DepthVideo
from depthcli.video.number_pattern import check_folders, is_pattern, numbered_name


def is_sequence_name(target: str, source: str) -> bool:
    """Whether a target is the name of numbered files, such as ``depth.%04d.exr``.

    It is that of one file if the source is a depth file with a placeholder in its own name.
    """
    place = path_of(source)
    is_plain = is_pattern(place.name) and not is_depth_video(place)
    return is_pattern(path_of(target).name) and not is_folder(target) and not is_plain


def check_sequence(request: ConvertRequest) -> None:
    """Check a request whose target is a pattern.

    Raises:
        UsageError: the source is no depth video, or the request is for a single map.
    """
    name = safe_name(request.target)
    if not is_depth_video(path_of(request.source)):
        raise UsageError(
            f"{name} is a pattern for the frames of a depth video (.mkv), but "
            f"{safe_name(request.source)} is not one; name one file, or a folder with --out"
        )
    if request.frame is not None or request.picture is not None:
        what = "--frame" if request.frame is not None else "--picture"
        raise UsageError(
            f"{what} is for one map, but {name} is a pattern for all frames; remove it"
        )
    check_folders(path_of(request.target))


def convert_video(request: ConvertRequest, workers: int) -> Generator[ConvertResult, None, None]:
    """Convert every frame of a depth video, in their order.

    Args:
        request: its target is a pattern, into which each frame's number is put.
        workers: frames written in parallel.

    Yields:
        The result of each frame.

    Raises:
        InputError: the video is damaged; the frames before are written.
        OutputError: a file cannot be written, or is one that depthcli did not write.
        UsageError: as for :func:`check_sequence`, or the target's suffix is of no format.
    """
    check_sequence(request)
    target_format(request.target, request.format)

    def convert_frame(stored: StoredDepth) -> ConvertResult:
        target = numbered_name(request.target, stored.frame.index)
        return write_converted(stored, replace(request, target=target))

    from depthcli.video.depth_frames import depth_frames  # noqa: PLC0415 - loads FFmpeg

    problem: InputError | None = None

    def readable(video: DepthVideo) -> Generator[StoredDepth, None, None]:
        # Raised at the end, so that all frames before it are written.
        nonlocal problem
        try:
            yield from depth_frames(video, name=name, scale=request.scale)
        except InputError as error:
            problem = error

    name = safe_name(request.source)
    with local_copy(path_of(request.source)) as path, one_thread_each(workers):
        frames = readable(DepthVideo(path, scale=request.scale))
        with closing(ordered_map(convert_frame, frames, workers=workers)) as results:
            yield from results
    if problem is not None:
        raise problem
