"""The codec of a video's previews."""

from collections.abc import Sequence
from typing import Any

from depthcli.cli.arguments.unused import is_given
from depthcli.video.codecs import PREVIEW_CODECS, Codec, PreviewCodec
from depthcli.video.formats import VideoFormat


def choose_codec(
    context: Any,  # noqa: ANN401 - typer's own
    codec: PreviewCodec | None,
    formats: Sequence[VideoFormat],
) -> PreviewCodec | None:
    """The codec to use; None for the default of each container.

    A codec of a profile, which serves several runs, is ignored where a container does not hold it;
    one on the command line is an error later.
    """
    containers = [PREVIEW_CODECS[f".{which}"] for which in formats if which.facts.is_preview]
    if codec is None or is_given(context, "codec"):
        return codec
    return codec if all(Codec(codec) in held for held in containers) else None
