"""What outputs of a video take and do, whatever their format."""

from dataclasses import dataclass
from typing import Any, Protocol

from depthcli.core.types import DepthMap, Frame


@dataclass(frozen=True, slots=True)
class VideoFrame:
    """One frame, ready to be written."""

    picture: Frame  #: what is seen
    depth: DepthMap  #: its depth
    spread: tuple[float, float]  #: low and high end of the preview's range
    is_kept: bool = False  #: whether an earlier run wrote it

    @property
    def time_s(self) -> float:
        """When the frame is shown."""
        return self.picture.timestamp_s or 0.0


class VideoOutput(Protocol):
    """One output of a video."""

    def encode(self, frame: VideoFrame) -> Any:  # noqa: ANN401 - each output has its own
        """The part of the work that any thread can do, for any frame."""
        ...

    def append(self, encoded: Any) -> None:  # noqa: ANN401
        """The part that is done frame after frame."""
        ...

    def finish(self) -> tuple[str, ...]:
        """Complete the output.

        Returns:
            Warnings, one line each.
        """
        ...
