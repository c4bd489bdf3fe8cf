"""The writers' options from the command line."""

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

from depthcli.core.choices import Colormap, Near
from depthcli.errors import UsageError
from depthcli.io.formats.table import WriterOptions


def writer_options(parameters: Mapping[str, Any]) -> WriterOptions:
    """The writers' options from a command's parameters of the same names.

    Those that are missing or None get their defaults.

    Raises:
        UsageError: they contradict each other.
    """
    given = {
        field.name: parameters[field.name]
        for field in fields(WriterOptions)
        if parameters.get(field.name) is not None
    }
    _check_together(given)
    if given.get("near", Near.WARM) != Near.WARM:
        given["colormap"] = Colormap.GRAY
    return WriterOptions(**given)


def _check_together(given: Mapping[str, Any]) -> None:
    """Refuse options that contradict each other."""
    if given.get("png_normalize") and "png_scale" in given:
        raise UsageError("give --png-scale or --png-normalize, not both")
    if "vmin" in given and "vmax" in given:
        if given["vmin"] == given["vmax"]:
            raise UsageError("--vmin and --vmax are equal; give different values")
        if given["vmin"] > given["vmax"]:
            raise UsageError(
                f"--vmin {given['vmin']:g} is above --vmax {given['vmax']:g}; swap them"
            )
    near, colormap = given.get("near"), given.get("colormap")
    if near == Near.WARM and colormap == Colormap.GRAY:
        raise UsageError("gray has no warm end; give --near white or --near black")
    if near in {Near.WHITE, Near.BLACK} and colormap not in {None, Colormap.GRAY}:
        raise UsageError(
            f"--near {near} is for --colormap gray; with {colormap}, near is the warm end"
        )
