"""What ``depthcli export-onnx`` says of the model that it wrote."""

from __future__ import annotations

from typing import TYPE_CHECKING

from depthcli.cli.screen import console

if TYPE_CHECKING:
    from depthcli.export.onnx import Exported


def print_export(done: Exported) -> None:
    """Two lines for people."""
    card, parity = done.card, done.parity
    console.say(
        f"{done.path}  {(card.size_bytes or 0) / 1e6:.1f} MB  sha256 {card.sha256}\n"
        f"parity over {len(parity.cases)} sizes: max {parity.max_abs:.2g}, "
        f"mean {parity.mean_abs:.2g} (allowed {parity.tolerance:g})"
    )


def print_export_json(done: Exported) -> None:
    """One JSON object."""
    parity = done.parity
    console.out_json(
        {
            "path": str(done.path),
            "sha256": done.card.sha256,
            "bytes": done.card.size_bytes,
            "max_abs": parity.max_abs,
            "mean_abs": parity.mean_abs,
            "tolerance": parity.tolerance,
            "cases": [list(case) for case in parity.cases],
        }
    )
