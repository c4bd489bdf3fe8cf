"""What NumPy asks of an object that stands for an array."""

from typing import Any

import numpy as np
import numpy.typing as npt


def as_array(
    values: npt.NDArray[Any], dtype: npt.DTypeLike | None, copy: bool | None
) -> npt.NDArray[Any]:
    """The answer of ``__array__``, by the protocol of NumPy 2.

    Raises:
        ValueError: a copy is needed and forbidden.
    """
    # NumPy 1 has no None for its copy, and asks for nothing but a type.
    return np.asarray(values, dtype) if copy is None else np.array(values, dtype, copy=copy)
