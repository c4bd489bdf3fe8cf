"""Options of a provider, as the command line has them."""

from collections.abc import Sequence

from depthcli.errors import UsageError
from depthcli.inference.loading import SessionLoader


def session_loader(
    model: str | None, provider: str, threads: int | None, words: Sequence[str] | None
) -> SessionLoader:
    """The model that ``--model``, ``--provider`` and ``--provider-option`` name, and what runs it.

    Raises:
        UsageError: an option of the provider is none.
    """
    return SessionLoader(model, provider, threads, provider_options(words or ()))


def provider_options(words: Sequence[str]) -> dict[str, str]:
    """Settings of a provider by their keys, of the words ``KEY=VALUE``.

    Raises:
        UsageError: a word is none.
    """
    pairs = [word.partition("=") for word in words]
    for (key, equals, _), word in zip(pairs, words, strict=True):
        if not (key and equals):
            raise UsageError(
                f"--provider-option {word!r} is not KEY=VALUE; for example device_id=1"
            )
    return {key: value for key, _, value in pairs}
