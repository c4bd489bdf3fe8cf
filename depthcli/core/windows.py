"""The data window and the display window of an OpenEXR picture."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt


class Window(NamedTuple):
    """A rectangle of pixels in the coordinates of an OpenEXR file: x to the right, y down."""

    left: int  #: its first column
    top: int  #: its first row
    right: int  #: the column after its last one
    bottom: int  #: the row after its last one

    @property
    def width(self) -> int:
        """Columns; 0 if it is empty."""
        return max(0, self.right - self.left)

    @property
    def height(self) -> int:
        """Rows; 0 if it is empty."""
        return max(0, self.bottom - self.top)

    @property
    def is_empty(self) -> bool:
        """Whether it has no pixel."""
        return not (self.width and self.height)

    def moved(self, columns: int, rows: int) -> "Window":
        """The same rectangle elsewhere."""
        left, top = self.left + columns, self.top + rows
        return Window(left, top, self.right + columns, self.bottom + rows)

    def union(self, other: "Window") -> "Window":
        """The smallest window around both."""
        corner = min(self.left, other.left), min(self.top, other.top)
        return Window(*corner, max(self.right, other.right), max(self.bottom, other.bottom))

    def intersection(self, other: "Window") -> "Window":
        """The pixels that are in both; possibly none."""
        corner = max(self.left, other.left), max(self.top, other.top)
        return Window(*corner, min(self.right, other.right), min(self.bottom, other.bottom))

    def within(self, outer: "Window") -> tuple[slice, slice]:
        """Rows and columns of this window in an array that covers an outer one."""
        top, left = self.top - outer.top, self.left - outer.left
        return slice(top, top + self.height), slice(left, left + self.width)


def over_window(
    values: npt.NDArray[np.float32], covered: Window, wanted: Window
) -> npt.NDArray[np.float32]:
    """Values of one window as those of another.

    Args:
        values: (H, W) float32 over ``covered``.
        covered: their window.
        wanted: the window of the result.

    Returns:
        (H', W') float32 over ``wanted``: NaN outside ``covered``. The same array if the windows are
        the same.
    """
    if covered == wanted:
        return values
    found = np.full((wanted.height, wanted.width), np.nan, np.float32)
    both = covered.intersection(wanted)
    if not both.is_empty:
        found[both.within(wanted)] = values[both.within(covered)]
    return found


@dataclass(frozen=True, slots=True)
class Windows:
    """Which part of the image plane a frame's pixels cover."""

    pixels: Window  #: what the array of pixels covers: the display window, and overscan around it
    data: Window  #: the pixels of the file, some of which may be outside ``pixels``
    display: Window  #: the part of ``pixels`` that is shown, and that the field of view is of

    @property
    def valid(self) -> Window:
        """The part of ``pixels`` that the file has; possibly none."""
        return self.data.intersection(self.pixels)

    def only(self, window: Window, values: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
        """Values, (H, W) float32 over ``pixels``, with NaN outside a window."""
        if window == self.pixels:
            return values
        return over_window(over_window(values, self.pixels, window), window, self.pixels)
