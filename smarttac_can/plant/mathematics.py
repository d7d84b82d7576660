"""One set of formulas for one finger and for a population.

A formula takes its functions as an argument: :data:`SCALAR` works on plain floats, :data:`ARRAY`
on numpy arrays with one element a finger. The two agree to 1e-12, not by bit.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Generic, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
Float = TypeVar("Float", float, FloatArray)


class Mathematics(NamedTuple, Generic[Float]):
    """The functions that a formula needs beside the arithmetic operators."""

    exp: Callable[[Float], Float]
    sqrt: Callable[[Float], Float]
    power: Callable[[Float, Float], Float]
    select: Callable[[Float, Float, Float], Float]
    """``select(x, a, b)`` is a where x > 0, else b."""


def _select_scalar(x: float, a: float, b: float) -> float:
    return a if x > 0.0 else b


def _select_array(x: FloatArray, a: FloatArray, b: FloatArray) -> FloatArray:
    return np.where(x > 0.0, a, b)


SCALAR: Mathematics[float] = Mathematics(math.exp, math.sqrt, math.pow, _select_scalar)
ARRAY: Mathematics[FloatArray] = Mathematics(np.exp, np.sqrt, np.power, _select_array)
