"""Options of all output formats."""

from dataclasses import dataclass

from depthcli.core.choices import Colormap, Near
from depthcli.io.formats.base import Writer
from depthcli.io.formats.table import FORMATS, MILLIMETRES, Format, writer_class


@dataclass(frozen=True, slots=True)
class WriterOptions:
    """Options of all formats; the table of formats states which of them each writer uses."""

    png_scale: float = MILLIMETRES  #: units per metre in 16-bit PNG
    png_normalize: bool = False  #: stretch each 16-bit PNG to its whole range
    exr_channel: str = "Y"  #: name of the channel in EXR
    half: bool = False  #: 16-bit floats in EXR
    colormap: Colormap = Colormap.INFERNO  #: colours of the preview
    near: Near = Near.WARM  #: the colormap's end that is near
    vmin: float | None = None  #: low end of the colour range; None for a percentile
    vmax: float | None = None  #: high end of the colour range; None for a percentile
    legend: bool = False  #: a scale beside the preview
    side_by_side: bool = False  #: the picture beside its preview

    def writer(self, name: Format) -> Writer:
        """The writer of a format; its module is loaded now."""
        return writer_class(name)(**{own: getattr(self, own) for own in FORMATS[name].options})
