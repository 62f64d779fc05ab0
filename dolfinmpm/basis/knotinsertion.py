"""Knot insertion: functions of every second line of a grid as sums of those of all lines."""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
import numpy.typing as npt

__all__ = ["Parents", "knot_insertion"]

Array = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int32]


@dataclass(frozen=True)
class Parents:
    """Parents of the integers of one direction on the next coarser level.

    Attributes:
        start: First entry of each integer, shape (n + 1,).
        parent: Integers on the coarser level.
        weight: Their weights (-). The weights of each integer sum to 1.
        size: Number of integers of the coarser level.
    """

    start: Ints
    parent: Ints
    weight: Array
    size: int


@numba.njit(cache=True, error_model="numpy")
def _oslo(coarse, fine, degree, start, parent, weight):
    """Coefficients of coarse B-splines in fine ones; only counts them if `parent` is empty."""
    a, total, span = np.zeros(degree + 2), 0, degree
    for i in range(start.size - 1):
        while span + 1 < coarse.size - degree - 1 and coarse[span + 1] <= fine[i]:
            span += 1
        a[:] = 0.0
        a[degree] = 1.0
        # a[m] belongs to function span − degree + m
        for k in range(1, degree + 1):
            t = fine[i + k]
            for m in range(degree - k, degree + 1):
                j, value = span - degree + m, 0.0
                if m > degree - k:
                    value += (t - coarse[j]) / (coarse[j + k] - coarse[j]) * a[m]
                if m < degree:
                    low, high = coarse[j + 1], coarse[j + k + 1]
                    value += (high - t) / (high - low) * a[m + 1]
                a[m] = value
        for m in range(degree + 1):
            if abs(a[m]) > 1e-12:
                if parent.size:
                    parent[total], weight[total] = span - degree + m, a[m]
                total += 1
        start[i + 1] = total


def knot_insertion(line: Array, degree: int) -> tuple[Array, Parents]:
    """Every second line of a grid, and the coarse B-splines as sums of the fine ones.

    The functions of the coarse lines are sums of functions of the fine lines exactly, by the Oslo
    algorithm (Cohen, Lyche & Riesenfeld 1980, doi 10.1016/0146-664X(80)90023-8). For degree 1
    the weights are those of linear interpolation.

    Args:
        line: Coordinates of the grid lines (m), shape (n,).
        degree: Degree of the functions.

    Returns:
        The coarse lines (m), and the parents of the fine functions. The last line stays also if the
        number of cells is odd.

    >>> lines, parents = knot_insertion(np.arange(5.0), 1)
    >>> lines.tolist(), parents.start.tolist(), parents.weight.tolist()
    ([0.0, 2.0, 4.0], [0, 1, 3, 4, 6, 7], [1.0, 0.5, 0.5, 1.0, 0.5, 0.5, 1.0])
    """
    lines = line[::2] if line.size % 2 else np.append(line[::2], line[-1])
    fine, coarse = (
        np.concatenate([[x[0]] * degree, x, [x[-1]] * degree]) for x in (line, lines)
    )  # fmt: skip
    start = np.zeros(line.size + degree, np.int32)
    parent, weight = np.empty(0, np.int32), np.empty(0)
    for _ in range(2):  # first count, then fill
        parent, weight = np.empty(start[-1], np.int32), np.empty(start[-1])
        _oslo(coarse, fine, degree, start, parent, weight)
    return lines, Parents(start, parent, weight, lines.size - 1 + degree)
