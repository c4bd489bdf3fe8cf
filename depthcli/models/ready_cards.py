"""Cards for well-known models, complete except for the fields about the file."""

import json
from pathlib import Path
from typing import Any

from depthcli.errors import UsageError
from depthcli.models.card import ModelCard

FOLDER = Path(__file__).parent / "cards"
_NO_FILE_YET = {"opset": 1, "ir": 1}


def ready_names() -> tuple[str, ...]:
    """Names of the ready cards, in alphabetic order."""
    return tuple(path.stem for path in sorted(FOLDER.glob("*.json")))


def ready_fields(name: str) -> dict[str, Any]:
    """A ready card's JSON object, without the fields that depend on the file.

    Raises:
        UsageError: there is no such card.
    """
    if name not in ready_names():
        raise UsageError(
            f"no ready card named {name!r}; see 'depthcli models cards', or give a .json file"
        )
    fields: dict[str, Any] = json.loads((FOLDER / f"{name}.json").read_text("utf-8"))
    return fields


def ready_card(name: str) -> ModelCard:
    """A ready card, with placeholders for opset and IR version.

    Raises:
        UsageError: there is no such card.
    """
    fields = ready_fields(name) | {"onnx": _NO_FILE_YET}
    return ModelCard.from_json(json.dumps(fields), where=f"card {name}")
