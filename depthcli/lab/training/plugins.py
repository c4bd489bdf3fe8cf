"""Methods, losses and callbacks of other packages, named ``module:name`` on the command line."""

import os
import sys
from pkgutil import resolve_name
from typing import Any

from depthcli.errors import UsageError


def imported(name: str) -> Any:  # noqa: ANN401
    """The object ``module:name`` of an installed package or of the working directory."""
    if os.getcwd() not in sys.path:  # noqa: PTH109
        sys.path.append(os.getcwd())  # noqa: PTH109
    try:
        return resolve_name(name)
    except (ImportError, AttributeError, ValueError) as error:
        raise UsageError(f"cannot import {name} ({error})") from error
