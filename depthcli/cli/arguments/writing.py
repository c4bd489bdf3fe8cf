"""How outputs are written, as the command line says it."""

from __future__ import annotations

from depthcli.cli.arguments.formats import Colormap, ExrChannel, Near
from depthcli.errors import UsageError
from depthcli.io.writers.formats import MILLIMETRES
from depthcli.io.writers.options import WriterOptions


def check_writing(
    png_scale: float | None,
    vmin: float | None,
    vmax: float | None,
    colormap: str | None,
    near: str | None,
    *,
    png_normalize: bool,
) -> None:
    """Refuse options that contradict each other.

    Raises:
        UsageError: they do.
    """
    if png_normalize and png_scale is not None:
        raise UsageError("give --png-scale or --png-normalize, not both")
    if vmin is not None and vmax is not None:
        if vmin == vmax:
            raise UsageError("--vmin and --vmax are equal; give different values")
        if vmin > vmax:
            raise UsageError(f"--vmin {vmin:g} is above --vmax {vmax:g}; swap them")
    if near == Near.WARM and colormap == Colormap.GRAY:
        raise UsageError("gray has no warm end; give --near white or --near black")
    if near in {Near.WHITE, Near.BLACK} and colormap not in {None, Colormap.GRAY}:
        raise UsageError(
            f"--near {near} is for --colormap gray; with {colormap}, near is the warm end"
        )


def writer_options(
    *,
    png_scale: float | None = None,
    png_normalize: bool = False,
    exr_channel: ExrChannel = ExrChannel.Y,
    half: bool = False,
    colormap: Colormap | None = None,
    near: Near | None = None,
    vmin: float | None = None,
    vmax: float | None = None,
    legend: bool = False,
    side_by_side: bool = False,
) -> WriterOptions:
    """The writers' options that the words describe.

    Raises:
        UsageError: they contradict each other.
    """
    check_writing(png_scale, vmin, vmax, colormap, near, png_normalize=png_normalize)
    near = near or Near.WARM
    if colormap is None:
        colormap = Colormap.INFERNO if near is Near.WARM else Colormap.GRAY
    return WriterOptions(
        png_scale=MILLIMETRES if png_scale is None else png_scale,
        png_normalize=png_normalize,
        exr_channel=exr_channel.value,
        half=half,
        colormap=colormap.value,
        near=near.value,
        vmin=vmin,
        vmax=vmax,
        legend=legend,
        side_by_side=side_by_side,
    )
