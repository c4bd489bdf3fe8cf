"""Loading a session, at once or in the background."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from depthcli.core.parallel import Background

if TYPE_CHECKING:
    import os
    from collections.abc import Mapping

    from depthcli.inference.session import Session
    from depthcli.models.catalog import Model


@dataclass(frozen=True, slots=True)
class SessionLoader:
    """The arguments of a session; small, and can be pickled for another process."""

    #: a name in the catalog, a folder, or an ``.onnx`` file; None for the default model
    model: str | os.PathLike[str] | None = None
    provider: str = "auto"  #: ``auto``, or a name such as ``cpu`` or ``cuda``, which is required
    threads: int | None = None  #: threads within one operator; None for onnxruntime's choice
    #: for a provider given by name, as onnxruntime documents them
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
        """Begin to find and load the model; ``result`` raises its errors.

        Imports hold the GIL; reading, checking and loading a model do not. So the file is checked
        while onnxruntime is imported here, and loaded while the caller imports modules that read
        pictures.
        """
        from depthcli.models.catalog import find_model  # noqa: PLC0415 - see above

        checking = Background(lambda: find_model(self.model))
        from depthcli.inference.providers import CPU  # noqa: PLC0415
        from depthcli.inference.session import Session  # noqa: PLC0415

        def session() -> Session:
            model = checking.result()
            chosen = self._for_provider(model)
            loaded = Session(
                chosen,
                provider=self.provider,
                threads=self.threads,
                provider_options=self.provider_options,
            )
            if chosen is model or loaded.provider != CPU:
                return loaded
            on_cpu = Session(model, provider=CPU, threads=self.threads)  # no GPU works
            on_cpu.warnings = loaded.warnings
            return on_cpu

        return Background(session)

    def _for_provider(self, model: Model) -> Model:
        """The model, or the float model that its card names if the provider prefers floats."""
        from depthcli.inference.providers import prefers_int8  # noqa: PLC0415 - as in start
        from depthcli.models.catalog import find_model  # noqa: PLC0415

        other = model.card.float_model
        if other is None or prefers_int8(self.provider):
            return model
        return find_model(other)
