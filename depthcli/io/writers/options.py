"""How outputs are written, whatever their format."""

from dataclasses import dataclass
from typing import Literal

from depthcli.io.writers.base import Writer
from depthcli.io.writers.formats import FORMATS, MILLIMETRES, Format, writer_class


@dataclass(frozen=True, slots=True)
class WriterOptions:
    """Options of all formats; each writer takes those that its line of the table names.

    Attributes:
        png_scale: steps a metre in 16-bit PNG.
        png_normalize: stretch each 16-bit PNG to its whole range.
        exr_channel: name of the channel in EXR.
        half: 16-bit floats in EXR.
        colormap: colours of the preview.
        near: the colormap's end that is near.
        vmin: least depth with a colour of its own; None for a percentile.
        vmax: largest such depth; None for a percentile.
        legend: a scale beside the preview.
        side_by_side: the picture beside its preview.
    """

    png_scale: float = MILLIMETRES
    png_normalize: bool = False
    exr_channel: str = "Y"
    half: bool = False
    colormap: str = "inferno"
    near: Literal["warm", "white", "black"] = "warm"
    vmin: float | None = None
    vmax: float | None = None
    legend: bool = False
    side_by_side: bool = False

    def writer(self, name: Format) -> Writer:
        """The writer of a format; its module is loaded now."""
        return writer_class(name)(**{own: getattr(self, own) for own in FORMATS[name].options})
