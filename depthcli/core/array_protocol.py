"""What NumPy asks of an object that stands for an array."""

from typing import Any

import numpy as np
import numpy.typing as npt


def as_array(
    values: npt.NDArray[Any], dtype: npt.DTypeLike | None, copy: bool | None
) -> npt.NDArray[Any]:
    """The answer of ``__array__``, by the protocol of NumPy 2.

    Args:
        values: the array that the object stands for.
        dtype: the type that is wanted; None for its own.
        copy: whether to copy; None for only where the type asks for it.

    Raises:
        ValueError: a copy is needed and forbidden.
    """
    # NumPy 1 has no None for its copy, and asks for nothing but a type.
    return np.asarray(values, dtype) if copy is None else np.array(values, dtype, copy=copy)
