"""What happened to one input, as text and as JSON."""

from __future__ import annotations

from dataclasses import asdict, astuple
from typing import TYPE_CHECKING, NamedTuple

from depthcli.core.summary import DepthRange
from depthcli.core.text import one_line
from depthcli.io.writers.facts import Facts, camera_words

if TYPE_CHECKING:
    from depthcli.core.types import DepthMap
    from depthcli.errors import DepthcliError


class Done(NamedTuple):
    """An input whose outputs are all written.

    Attributes:
        name: the input, as the user wrote it.
        outputs: the files written, ``-`` for standard output.
        depth: the depth map.
        provider: what ran the model.
        seconds: from opening the input to the last output.
        warnings: one-line texts.
    """

    name: str
    outputs: tuple[str, ...]
    depth: DepthMap
    provider: str
    seconds: float
    warnings: tuple[str, ...]

    def as_json(self) -> dict[str, object]:
        """The fields of one line of ``--json``."""
        known = Facts.of(self.depth)
        return {
            "input": self.name,
            "status": "ok",
            "outputs": list(self.outputs),
            "kind": known.kind,
            "unit": known.unit,
            **asdict(DepthRange.of(self.depth)),
            "width": self.depth.width,
            "height": self.depth.height,
            **known.origin(),
            "provider": self.provider,
            "seconds": round(self.seconds, 6),
            "warnings": list(self.warnings),
        }

    def as_text(self) -> str:
        """One line: where the outputs are, the range of depth, and the camera it belongs to."""
        low, median, high = astuple(DepthRange.of(self.depth))
        names = ", ".join(one_line(name) for name in self.outputs)
        if low is None:
            return f"{one_line(self.name)} -> {names}  no depth"
        unit = " m" if self.depth.is_metric else f" ({self.depth.kind}, no unit)"
        numbers = f"min {low:.3f}, median {median:.3f}, max {high:.3f}{unit}"
        camera = camera_words(self.depth)
        seen_by = f"  camera: {camera}" if camera else ""
        return f"{one_line(self.name)} -> {names}  {numbers}{seen_by}"


class Failed(NamedTuple):
    """An input that could not be used, or whose outputs could not be written.

    Attributes:
        name: the input, as the user wrote it.
        error: why.
    """

    name: str
    error: DepthcliError

    def as_json(self) -> dict[str, object]:
        """The fields of one line of ``--json``."""
        return {"input": self.name, "status": "failed", "error": str(self.error)}

    def as_text(self) -> str:
        """One line: the input, and why it failed."""
        reason = str(self.error)
        return reason if reason.startswith(self.name) else f"{self.name}: {reason}"
