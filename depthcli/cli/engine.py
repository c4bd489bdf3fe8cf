"""The model of a command, loaded while the command does something else."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from depthcli.cli.background import Background

if TYPE_CHECKING:
    from depthcli.inference.session import Session


class Engine(NamedTuple):
    """Which model runs, and how.

    Attributes:
        model: name or path; None for the default.
        provider: ``auto`` or a name.
        threads: None for onnxruntime's choice.
    """

    model: str | None
    provider: str
    threads: int | None

    def start(self) -> Background[Session]:
        """Begin to find and load the model; what is wrong with it comes with the result.

        Imports hold the interpreter's lock; reading, checking and loading a model do not. So the
        file is checked while onnxruntime is imported here, and loaded while the caller imports all
        that reads pictures.
        """
        from depthcli.inference.catalog import find_model

        checking = Background(lambda: find_model(self.model))
        from depthcli.inference.session import Session

        return Background(
            lambda: Session(checking.result(), provider=self.provider, threads=self.threads)
        )
