"""Options without effect on what is read or written."""

from collections.abc import Collection, Iterable, Mapping

from depthcli.cli.groups import Given
from depthcli.io.formats.table import FORMATS
from depthcli.io.listing.folder import is_exr

FORMAT_OPTIONS: Mapping[str, Collection[str]] = {
    str(name): facts.parameters for name, facts in FORMATS.items()
}
"""The options that each format uses, by parameter name."""
INPUT_OPTIONS: Mapping[str, Collection[str]] = {
    "EXR": ("exposure", "layer"),
    "PNG and TIFF": ("white_level",),
    "image sequences": ("fps",),
}
"""The options that each kind of input uses, by parameter name."""
_STDIN = "-"


def without_effect(
    given: Given, used_by: Mapping[str, Collection[str]], kinds: Collection[str]
) -> list[str]:
    """Warnings about options that another kind of file uses than those in ``kinds``.

    Options of a profile, which serves several runs, are left out.
    """
    warnings = []
    for name, word in given.items():
        users = [kind for kind, options in used_by.items() if name in options]
        if users and not {*users} & {*kinds}:
            warnings.append(f"{word} has no effect: it is for {', '.join(users)}")
    return warnings


def image_kinds(names: Iterable[str]) -> set[str]:
    """The kinds of images, for :data:`INPUT_OPTIONS`."""
    kinds = set()
    for name in names:
        kinds |= {*INPUT_OPTIONS} if name == _STDIN else {"EXR" if is_exr(name) else "PNG and TIFF"}
    return kinds
