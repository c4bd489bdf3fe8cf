"""Options that nothing of what is written would use."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from depthcli.errors import UsageError

if TYPE_CHECKING:
    from collections.abc import Collection

_PREVIEW_VIDEO = ("mp4", "webm", "mov")
_PREVIEW = ("preview", *_PREVIEW_VIDEO)
_USED_BY = {
    # The sidecar states the scale of the PNG beside it.
    "png_scale": ("png16", "mkv", "json"),
    "png_normalize": ("png16", "json"),
    "exr_channel": ("exr",),
    "half": ("exr",),
    "colormap": _PREVIEW,
    "near": _PREVIEW,
    "vmin": _PREVIEW,
    "vmax": _PREVIEW,
    "legend": _PREVIEW,
    "side_by_side": _PREVIEW,
    "lock": (*_PREVIEW_VIDEO, "mkv"),
    "codec": _PREVIEW_VIDEO,
    "audio": _PREVIEW_VIDEO,
    # Those of convert, which scales no metres.
    "cloud_focal_px": ("ply",),
    "cloud_hfov": ("ply",),
    "picture": ("ply",),
}
"""The formats that an option is for, by the name of its parameter."""


def refuse_unused(
    context: Any,  # noqa: ANN401 - typer's own
    formats: Collection[str],
    available: Collection[str],
) -> None:
    """Refuse an option of the command line which no format that is written uses.

    A profile's options are for many runs, so that it may hold more than one of them uses.

    Args:
        context: of the command that runs.
        formats: names of what is written.
        available: names of all that the command can write.

    Raises:
        UsageError: there is such an option.
    """
    for name, word in given_options(context).items():
        users = _USED_BY.get(name, tuple(formats))
        if set(users).isdisjoint(formats):
            meant = next(user for user in users if user in available)
            raise UsageError(
                f"{word} is for {meant}, and only {' and '.join(formats)} would be written; "
                f"remove it, or write {meant}"
            )


def given_options(context: Any) -> dict[str, str]:  # noqa: ANN401 - typer's own
    """The options that stand on the command line: parameter's name -> option."""
    parameters = {str(parameter.name): parameter.opts for parameter in context.command.params}
    return {
        name: max(words, key=len) for name, words in parameters.items() if is_given(context, name)
    }


def is_given(context: Any, name: str) -> bool:  # noqa: ANN401 - typer's own
    """Whether a parameter stands on the command line, not only in a profile."""
    source = context.get_parameter_source(name)
    return source is not None and source.name == "COMMANDLINE"
