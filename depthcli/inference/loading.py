"""Which model runs, and how; loaded at once, or while the caller does something else."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from depthcli.core.parallel.background import Background

if TYPE_CHECKING:
    import os
    from collections.abc import Mapping

    from depthcli.inference.session import Session
    from depthcli.models.catalog import Model


@dataclass(frozen=True, slots=True)
class SessionLoader:
    """What a session is made of; a few words that can be sent to another process."""

    #: a name in the catalog, a folder, or an ``.onnx`` file; None for the default model
    model: str | os.PathLike[str] | None = None
    provider: str = "auto"  #: ``auto``, or a name such as ``cpu`` or ``cuda`` that has to be there
    threads: int | None = None  #: threads within one operator; None for onnxruntime's choice
    #: for a provider asked for by name, as onnxruntime documents them
    provider_options: Mapping[str, str] = field(default_factory=dict)

    def load(self) -> Session:
        """Find the model and load it.

        Raises:
            ModelError: the model is not there or is damaged.
            ProviderError: the named provider is not available.
            UsageError: no provider has that name, or it takes no options and some are given.
        """
        return self.start().result()

    def start(self) -> Background[Session]:
        """Begin to find and load the model; what is wrong with it comes with the result.

        Imports hold the interpreter's lock; reading, checking and loading a model do not. So the
        file is checked while onnxruntime is imported here, and loaded while the caller imports all
        that reads pictures.
        """
        from depthcli.models.catalog import find_model  # noqa: PLC0415 - see above

        checking = Background(lambda: find_model(self.model))
        from depthcli.inference.session import Session  # noqa: PLC0415

        return Background(
            lambda: Session(
                self._made_for_provider(checking.result()),
                provider=self.provider,
                threads=self.threads,
                provider_options=self.provider_options,
            )
        )

    def _made_for_provider(self, model: Model) -> Model:
        """The model, or the one of floats that its card names."""
        from depthcli.inference.providers import made_for_int8  # noqa: PLC0415 - as in start
        from depthcli.models.catalog import find_model  # noqa: PLC0415

        other = model.card.float_model
        return model if other is None or made_for_int8(self.provider) else find_model(other)
