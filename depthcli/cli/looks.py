"""How each output format looks."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal, NamedTuple

from depthcli.cli.predict_choices import Colormap, ExrChannel, Near
from depthcli.errors import UsageError
from depthcli.io.writers.formats import MILLIMETRES, Format

if TYPE_CHECKING:
    from depthcli.inference.card import ModelCard
    from depthcli.io.writers.base import Writer


class Looks(NamedTuple):
    """Options of the formats; see the writers.

    Attributes:
        png_scale: steps a metre in 16-bit PNG.
        png_normalize: stretch each 16-bit PNG to its whole range.
        exr_channel: name of the channel in EXR.
        half: 16-bit floats in EXR.
        colormap: colours of the preview.
        near: the colormap's end that is near.
        vmin: depth at the near end; None for a percentile.
        vmax: depth at the far end; None for a percentile.
        legend: a scale beside the preview.
        side_by_side: the picture beside its preview.
    """

    png_scale: float
    png_normalize: bool
    exr_channel: str
    half: bool
    colormap: str
    near: Literal["warm", "white", "black"]
    vmin: float | None
    vmax: float | None
    legend: bool
    side_by_side: bool

    def writer(self, name: Format, card: ModelCard) -> Writer:
        """The writer of a format, for depth of a model."""
        # Imported one by one: OpenEXR alone takes longer than writing a PNG.
        match name:
            case Format.PNG16:
                from depthcli.io.writers.png16 import Png16Writer

                return Png16Writer(self.png_scale, self.png_normalize)
            case Format.EXR:
                from depthcli.io.writers.exr import ExrWriter

                return ExrWriter(self.exr_channel, self.half)
            case Format.NPY:
                from depthcli.io.writers.npy import NpyWriter

                return NpyWriter()
            case Format.PREVIEW:
                return self._preview()
            case Format.PLY:
                from depthcli.io.writers.ply import PlyWriter

                return PlyWriter(card.camera.hfov_deg) if card.camera else PlyWriter()
            case Format.JSON:
                from depthcli.io.writers.sidecar import SidecarWriter

                return SidecarWriter(None if self.png_normalize else self.png_scale)

    def _preview(self) -> Writer:
        from depthcli.io.writers.preview import PreviewWriter

        return PreviewWriter(
            colormap=self.colormap,
            near=self.near,
            vmin=self.vmin,
            vmax=self.vmax,
            legend=self.legend,
            side_by_side=self.side_by_side,
        )


def check_looks(
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


def choose_looks(
    *,
    png_scale: float | None,
    png_normalize: bool,
    exr_channel: ExrChannel,
    half: bool,
    colormap: Colormap | None,
    near: Near | None,
    vmin: float | None,
    vmax: float | None,
    legend: bool,
    side_by_side: bool,
) -> Looks:
    """The looks that the options describe.

    Raises:
        UsageError: they contradict each other.
    """
    check_looks(png_scale, vmin, vmax, colormap, near, png_normalize=png_normalize)
    near = near or Near.WARM
    if colormap is None:
        colormap = Colormap.INFERNO if near is Near.WARM else Colormap.GRAY
    return Looks(
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
