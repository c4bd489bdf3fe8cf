"""Checking a profile's options together."""

from collections.abc import Mapping

from depthcli.cli.arguments.anchors import check_anchors
from depthcli.cli.arguments.camera import parse_camera
from depthcli.cli.arguments.detail import choose_detail
from depthcli.cli.arguments.provider import provider_options
from depthcli.cli.arguments.span import parse_fps, parse_span
from depthcli.cli.arguments.writing import writer_options
from depthcli.cli.profile_files import Value
from depthcli.core.choices import Upsampling


def check_together(values: Mapping[str, Value]) -> None:
    """Run the checks that ``predict``, ``batch`` and ``video`` run before they read anything.

    Keys are option names without leading dashes.

    Raises:
        UsageError: an option is invalid, or options contradict each other.
    """

    def words(key: str) -> list[str]:
        value = values.get(key, [])
        return [str(part) for part in value] if isinstance(value, list) else [str(value)]

    def word(key: str) -> str | None:
        return words(key)[-1] if key in values else None

    scale = values.get("anchors-scale")
    given = {key.replace("-", "_"): value for key, value in values.items()}
    parse_camera(given)
    check_anchors(words("anchor"), word("anchors"), scale if isinstance(scale, float) else None)
    choose_detail(Upsampling.BILINEAR, word("tile"))
    parse_fps(word("fps"))
    parse_span(word("start"), word("end"), word("every"))
    provider_options(words("provider-option"))
    writer_options(given)
    if "provider" in values:
        from depthcli.inference.providers import check_name

        check_name(str(values["provider"]))
