"""Loading a session, at once or in the background."""

from __future__ import annotations

import logging
from dataclasses import dataclass, field
from functools import cache
from typing import TYPE_CHECKING

from depthcli.core.parallel import Background

if TYPE_CHECKING:
    import os
    from collections.abc import Mapping

    from depthcli.inference.session import Session


_LOG = logging.getLogger(__name__)


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
        """Find the model and load it."""
        return self.start().result()

    def start(self) -> Background[Session]:
        """Begin to find and load the model; ``result`` raises its errors.

        Imports hold the GIL; reading, checking and loading a model do not. So the file is checked
        while onnxruntime is imported here, and loaded while the caller imports modules that read
        images.
        """
        from depthcli.models.catalog import KNOWN_DEPTH_MODEL, find_model  # noqa: PLC0415 - see above

        checking = Background(lambda: find_model(self.model))
        from depthcli.inference.session import CPU, Session, wanted_providers  # noqa: PLC0415

        def session() -> Session:
            model = checking.result()
            chosen, other = model, model.card.float_model
            # GPUs run int8 networks slowly; OpenVINO does not gain speed, and rounds differently.
            if other is not None and wanted_providers(self.provider)[0] != CPU:
                chosen = find_model(other)
            options = self.provider_options
            loaded = Session(
                chosen, provider=self.provider, threads=self.threads, provider_options=options
            )
            if chosen is not model and loaded.provider == CPU:  # no GPU works
                warnings = loaded.warnings
                loaded = Session(model, provider=CPU, threads=self.threads)
                loaded.warnings = warnings
            if self.model is None:  # an int8 network, which not all providers run well
                loaded.load_known_depth = SessionLoader(KNOWN_DEPTH_MODEL, CPU, self.threads).load
            card, threads = loaded.model.card, self.threads or "all"
            if card.error_model is not None:
                loaded.load_error = cache(SessionLoader(card.error_model, CPU, self.threads).load)
            facts = card.name, card.version, loaded.model.path, loaded.provider, threads
            _LOG.info("model %s %s from %s on %s, %s threads", *facts)
            return loaded

        return Background(session)
