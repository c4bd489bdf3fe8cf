"""The specification of a worker, which can be pickled."""

from dataclasses import dataclass
from pathlib import Path

from depthcli._version import __version__
from depthcli.core.fingerprint import fingerprint
from depthcli.errors import ModelError
from depthcli.inference.loading import SessionLoader
from depthcli.inference.pipeline import Pipeline
from depthcli.inference.session import Session
from depthcli.io.manifest.row import Origin
from depthcli.jobs.batch.options import BatchOptions
from depthcli.jobs.batch.pictures import PictureWorker


@dataclass(frozen=True, slots=True)
class WorkerSpec:
    """What a worker is built from: plain values that can be pickled."""

    model: SessionLoader  #: model, provider and threads
    model_sha256: str  #: checksum of the model's file, 64 hex digits; another one is refused
    options: BatchOptions  #: how each input is processed
    out: Path  #: the output folder

    def build(self, session: Session | None = None) -> PictureWorker:
        """Build the worker in this process.

        Args:
            session: the model, if it is loaded already.

        Raises:
            ModelError: the model cannot be loaded here, or it is another one.
            ProviderError: the requested provider is not available.
        """
        session = session or self.model.load()
        if session.model.sha256 != self.model_sha256:
            raise ModelError(
                f"{session.model.path} is not the model that this batch began with "
                f"(sha256 {self.model_sha256}); copy that one here"
            )
        pipeline = Pipeline(session, self.options.detail)
        return PictureWorker(self.options, self.out, self.origin(session), pipeline)

    def origin(self, session: Session) -> Origin:
        """Fingerprint of the options, model and version that outputs are made with."""
        loaded, options = session.model, self.options
        # Providers differ in the last digits; threads, workers and batch sizes do not. The card
        # matters as much as the weights, and is not part of their file.
        checksum = fingerprint(
            sorted(set(options.formats)),
            options.writing,
            options.camera,
            options.reading,
            options.detail,
            session.provider,
            self.model.provider_options,
            (loaded.card.input, loaded.card.output, loaded.card.camera),
        )
        return Origin(checksum, loaded.card.name, loaded.sha256, __version__)
