"""Model, provider and provider options from the command line."""

from collections.abc import Sequence

from depthcli.errors import UsageError
from depthcli.inference.loading import SessionLoader


def session_loader(
    model: str | None, provider: str, threads: int | None, words: Sequence[str] | None
) -> SessionLoader:
    """The loader for ``--model``, ``--provider``, ``--threads`` and ``--provider-option``.

    Raises:
        UsageError: a provider option is not ``KEY=VALUE``.
    """
    return SessionLoader(model, provider, threads, provider_options(words or ()))


def provider_options(words: Sequence[str]) -> dict[str, str]:
    """Parse provider options ``KEY=VALUE``.

    Raises:
        UsageError: one is not ``KEY=VALUE``.
    """
    pairs = [word.partition("=") for word in words]
    for (key, equals, _), word in zip(pairs, words, strict=True):
        if not (key and equals):
            raise UsageError(
                f"--provider-option {word!r} is not KEY=VALUE; for example device_id=1"
            )
    return {key: value for key, _, value in pairs}
