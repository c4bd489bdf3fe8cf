"""The model of a command, loaded while the command does something else."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from depthcli.core.parallel.background import Background
from depthcli.errors import UsageError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from depthcli.inference.session import Session


class Engine(NamedTuple):
    """Which model runs, and how.

    Attributes:
        model: name or path; None for the default.
        provider: ``auto`` or a name.
        threads: None for onnxruntime's choice.
        settings: options of the provider, as ``KEY=VALUE`` words.
    """

    model: str | None
    provider: str
    threads: int | None
    settings: Sequence[str] = ()

    def start(self) -> Background[Session]:
        """Begin to find and load the model; what is wrong with it comes with the result.

        Imports hold the interpreter's lock; reading, checking and loading a model do not. So the
        file is checked while onnxruntime is imported here, and loaded while the caller imports all
        that reads pictures.
        """
        options = provider_options(self.settings)
        from depthcli.models.catalog import find_model

        checking = Background(lambda: find_model(self.model))
        from depthcli.inference.session import Session

        return Background(
            lambda: Session(
                checking.result(),
                provider=self.provider,
                threads=self.threads,
                provider_options=options,
            )
        )


def provider_options(words: Sequence[str]) -> dict[str, str]:
    """Settings of a provider by their keys.

    Args:
        words: as ``--provider-option`` has them, ``KEY=VALUE``.

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
