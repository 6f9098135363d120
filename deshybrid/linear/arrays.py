"""Arrays as values: copied, shape-checked, read-only."""

from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray: TypeAlias = NDArray[np.float64]
ComplexArray: TypeAlias = NDArray[np.complex128]


def frozen_array(values: ArrayLike, shape: tuple[int, ...]) -> FloatArray:
    """Return a read-only float copy of `values`; ValueError where the shape differs or a number is not finite.

    >>> frozen_array([[1, 2]], (1, 2)).flags.writeable
    False
    """
    array = np.array(values, dtype=np.float64, order="C")
    if array.shape != shape:
        raise ValueError(f"shape {array.shape}, expected {shape}")
    if not np.isfinite(array).all():
        raise ValueError("a number is not finite")
    array.flags.writeable = False
    return array
