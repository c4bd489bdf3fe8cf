"""Pictures in rows and columns, with a title over each column."""

from collections.abc import Sequence

import cv2
import numpy as np
import numpy.typing as npt

_BACKGROUND, _TEXT_COLOUR = 255, (24, 24, 24)
_GAP_PX = 4
_TITLE_PX = 26
_FONT, _SIZE = cv2.FONT_HERSHEY_SIMPLEX, 0.5


def contact_sheet(
    rows: Sequence[Sequence[npt.NDArray[np.uint8]]], titles: Sequence[str]
) -> npt.NDArray[np.uint8]:
    """Arrange pictures (H, W, 3) RGB uint8 on a white sheet, (H', W', 3) RGB uint8.

    A column is as wide as its widest picture, a row as high as its highest. In the titles of the
    columns, characters beyond ASCII become "?".
    """
    widths = [max(p.shape[1] for p in column) for column in zip(*rows, strict=True)]
    heights = [max(picture.shape[0] for picture in row) for row in rows]
    lefts = [_GAP_PX + sum(widths[:i]) + i * _GAP_PX for i in range(len(widths))]
    tops = [_TITLE_PX + sum(heights[:i]) + i * _GAP_PX for i in range(len(heights))]
    size = (tops[-1] + heights[-1] + _GAP_PX, lefts[-1] + widths[-1] + _GAP_PX, 3)
    sheet = np.full(size, _BACKGROUND, np.uint8)
    for title, left, width in zip(titles, lefts, widths, strict=True):
        sheet[:_TITLE_PX, left : left + width] = _title(title, width)
    for row, top in zip(rows, tops, strict=True):
        for picture, left in zip(row, lefts, strict=True):
            height, width = picture.shape[:2]
            sheet[top : top + height, left : left + width] = picture
    return sheet


def _title(text: str, width: int) -> npt.NDArray[np.uint8]:
    """(26, width, 3): the text in the middle, smaller if it is long."""
    text = text.encode("ascii", "replace").decode()
    band = np.full((_TITLE_PX, width, 3), _BACKGROUND, np.uint8)
    (text_width, _), _ = cv2.getTextSize(text, _FONT, _SIZE, 1)
    size = _SIZE * min(1.0, (width - 2) / max(text_width, 1))
    (text_width, text_height), _ = cv2.getTextSize(text, _FONT, size, 1)
    origin = ((width - text_width) // 2, (_TITLE_PX + text_height) // 2)
    cv2.putText(band, text, origin, _FONT, size, _TEXT_COLOUR, 1, cv2.LINE_AA)
    return band
