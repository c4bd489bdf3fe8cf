"""The interface of a video's outputs."""

from dataclasses import dataclass, replace
from typing import Any, Protocol, Self

from depthcli.core.overscan import displayed_depth, displayed_frame
from depthcli.core.types import DepthMap, Frame


@dataclass(frozen=True, slots=True)
class DepthFrame:
    """A frame with its depth, ready to be written."""

    picture: Frame  #: the frame
    depth: DepthMap  #: its depth
    spread: tuple[float, float]  #: low and high end of the preview's range
    is_kept: bool = False  #: whether an earlier run wrote it

    @property
    def time_s(self) -> float:
        """When the frame is shown."""
        return self.picture.timestamp_s or 0.0

    def displayed(self) -> Self:
        """The frame without overscan, which formats without a display window cannot mark."""
        depth = displayed_depth(self.depth, self.picture.windows)
        return replace(self, picture=displayed_frame(self.picture), depth=depth)


class VideoOutput(Protocol):
    """One output of a video."""

    @property
    def has_overscan(self) -> bool:
        """Whether its frames include the pixels outside the display window."""
        ...

    def encode(self, frame: DepthFrame) -> Any:  # noqa: ANN401 - each output has its own
        """Encode a frame; in any thread, in any order."""
        ...

    def append(self, encoded: Any) -> None:  # noqa: ANN401
        """Write an encoded frame; called in the order of the frames."""
        ...

    def finish(self) -> tuple[str, ...]:
        """Complete the output.

        Returns:
            Warnings, one line each.
        """
        ...
