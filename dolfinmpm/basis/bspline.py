"""B-splines with open knots in one direction, and their numbering on a rectangular grid.

A line of n cells carries n + p functions of degree p. The functions c ... c + p are not zero in
cell c. The first and the last knot are repeated. Only the first and the last function then differ
from zero at the ends, and essential conditions at the ends are exact (Piegl & Tiller 1997, The
NURBS Book, §2).
"""

from __future__ import annotations

import math

import numba
import numpy as np
import numpy.typing as npt
from dolfinx.common import IndexMap
from mpi4py import MPI

from dolfinmpm._platform.compat import make_index_map

__all__ = [
    "averaged_spline_weights",
    "extended",
    "extension_weights",
    "functions_of",
    "greville",
    "integrals",
    "middles",
    "spline_weights",
    "uniform_averages",
    "uniform_weights",
    "weights_at",
]

Array = npt.NDArray[np.float64]


@numba.njit(cache=True, inline="always")
def _knot(line, degree, i):
    return line[min(max(i - degree, 0), line.size - 1)]


@numba.njit(cache=True, error_model="numpy")
def spline_weights(line, cell, degree, x, S, dS):
    """Values and slopes (1/m) at x of the degree + 1 functions of a cell (Cox & de Boor).

    Args:
        line: Coordinates of the grid lines (m).
        cell: Number of the cell.
        degree: Degree of the functions.
        x: Position (m).
        S, dS: Written: values (-) and slopes (1/m), degree + 1 numbers each.
    """
    span = cell + degree
    for i in range(degree + 1):
        S[i] = 1.0 if i == 0 else 0.0
        dS[i] = 0.0
    for k in range(1, degree + 1):
        if k == degree:
            for i in range(degree + 1):
                slope = 0.0
                if i > 0:
                    j = span - degree + i
                    slope += S[i - 1] / (_knot(line, degree, j + degree) - _knot(line, degree, j))
                if i < degree:
                    j = span - degree + i + 1
                    slope -= S[i] / (_knot(line, degree, j + degree) - _knot(line, degree, j))
                dS[i] = degree * slope
        saved = 0.0
        for i in range(k):
            right = _knot(line, degree, span + i + 1)
            left = _knot(line, degree, span + 1 - k + i)
            share = S[i] / (right - left)
            S[i] = saved + (right - x) * share
            saved = (x - left) * share
        S[k] = saved


@numba.njit(cache=True, error_model="numpy")
def uniform_weights(degree, xi, per_length):
    """Values and slopes (1/m) of the degree + 1 functions in a cell of a uniform line.

    From degree 2 on, the formulas hold only away from the ends of the line, where no knot is
    repeated. The function returns numbers and no arrays: compiled loops keep numbers in registers.

    Args:
        degree: 1, 2 or 3.
        xi: Local coordinate in the cell, from 0 to 1.
        per_length: One over the cell's size (1/m).

    Returns:
        Four values and four slopes. Entries behind degree + 1 are 0.
    """
    rest, k = 1.0 - xi, per_length
    if degree == 1:
        return rest, xi, 0.0, 0.0, -k, k, 0.0, 0.0
    if degree == 2:
        middle = 0.5 + xi * rest
        return (
            0.5 * rest * rest, middle, 0.5 * xi * xi, 0.0, -rest * k, (rest - xi) * k, xi * k, 0.0
        )  # fmt: skip
    xx, rr = xi * xi, rest * rest
    second, third = 2.0 / 3.0 + xx * (0.5 * xi - 1.0), 2.0 / 3.0 + rr * (0.5 * rest - 1.0)
    return (
        rr * rest / 6.0, second, third, xx * xi / 6.0, -0.5 * rr * k, xi * (1.5 * xi - 2.0) * k,
        rest * (2.0 - 1.5 * rest) * k, 0.5 * xx * k,
    )  # fmt: skip


@numba.njit(cache=True, error_model="numpy")
def uniform_averages(degree, left, right, per_length):
    """Averages of `uniform_weights` over a part of a cell, for degree 2 or 3.

    The average of a cubic over m ± r is f(m) + r²/6 f''(m). A difference of primitives would lose
    digits in small domains.

    Args:
        degree: 2 or 3.
        left, right: Ends of the part in local coordinates of the cell, from 0 to 1.
        per_length: One over the cell's size (1/m).

    Returns:
        Four values and four slopes. The fourth ones are 0 for degree 2.
    """
    xi, r, k = 0.5 * (left + right), (right - left) ** 2 / 24.0, per_length
    a, b, c, d, da, db, dc, dd = uniform_weights(degree, xi, k)
    if degree == 2:
        return a + r, b - 2.0 * r, c + r, 0.0, da, db, dc, 0.0
    third = 3.0 * xi
    return (
        a + r * (1.0 - xi), b + r * (third - 2.0), c + r * (1.0 - third), d + r * xi,
        da - r * k, db + 3.0 * r * k, dc - 3.0 * r * k, dd + r * k,
    )  # fmt: skip


@numba.njit(cache=True, error_model="numpy")
def weights_at(line, uniform, cell, degree, x, S, dS):
    """Values and slopes (1/m) of the degree + 1 functions of a cell at x; see `spline_weights`.

    On a uniform line away from its ends the faster `uniform_weights` are taken.
    """
    if uniform and cell >= degree - 1 and cell <= line.size - 1 - degree:
        k = 1.0 / (line[cell + 1] - line[cell])
        found = uniform_weights(degree, (x - line[cell]) * k, k)
        for i in range(degree + 1):
            S[i], dS[i] = found[i], found[4 + i]
    else:
        spline_weights(line, cell, degree, x, S, dS)


@numba.njit(cache=True, error_model="numpy")
def averaged_spline_weights(line, uniform, first, count, degree, x, half, S, dS, part, slope):
    """Averages of functions and slopes (1/m) over a point's domain, in one direction.

    The domain is cut at the edges of the cells. Two Gauss points per piece integrate cubic
    polynomials exactly.

    Args:
        line: Coordinates of the grid lines (m).
        uniform: Whether all cells have the same size.
        first, count: First cell that the domain overlaps, and number of overlapped cells.
        degree: Degree of the functions.
        x, half: Position and half-length of the domain (m).
        S, dS: Written: averages of the count + degree functions (-) and of their slopes (1/m).
        part, slope: Scratch arrays, degree + 1 numbers each.
    """
    for i in range(count + degree):
        S[i] = 0.0
        dS[i] = 0.0
    left = max(x - half, line[first])
    right = min(x + half, line[first + count])
    for c in range(count):
        a, b = max(left, line[first + c]), min(right, line[first + c + 1])
        share, middle = 0.5 * (b - a) / (right - left), 0.5 * (a + b)
        reach = 0.5 * (b - a) / math.sqrt(3.0)
        for side in range(2):
            at = middle - reach if side == 0 else middle + reach
            weights_at(line, uniform, first + c, degree, at, part, slope)
            for i in range(degree + 1):
                S[c + i] += share * part[i]
                dS[c + i] += share * slope[i]


def greville(line: Array, degree: int) -> Array:
    """Greville points (m) of the functions: means of the inner knots, shape (cells + degree,)."""
    knots = np.concatenate([[line[0]] * degree, line, [line[-1]] * degree])
    return np.array([knots[i + 1 : i + degree + 1].mean() for i in range(line.size - 1 + degree)])


def integrals(line: Array, degree: int) -> Array:
    """Integrals (m) of the functions over the line: length of the support over degree + 1."""
    knots = np.concatenate([[line[0]] * degree, line, [line[-1]] * degree])
    return (knots[degree + 1 :] - knots[: -degree - 1]) / (degree + 1)


def middles(line: Array, degree: int) -> Array:
    """Centroids (m) of the functions over the line: means of all knots of each function.

    The formula is the first moment of a B-spline as a density (Curry & Schoenberg 1966, doi
    10.1007/BF02788653).
    """
    knots = np.concatenate([[line[0]] * degree, line, [line[-1]] * degree])
    windows = np.lib.stride_tricks.sliding_window_view(knots, degree + 2)
    return np.asarray(windows.mean(axis=1), np.float64)


def _blossoms(knots: Array) -> Array:
    """Coefficients of functions in the expansions of 1, t, ..., t^p, shape (..., p + 1).

    The coefficient for the power k is the mean of all products of k inner knots of the function
    (blossoming, Ramshaw 1989).

    Args:
        knots: Inner knots of the functions, shape (..., p).
    """
    p = knots.shape[-1]
    # elementary symmetric sums are the coefficients of Π (1 + t z)
    sums = np.zeros((*knots.shape[:-1], p + 1))
    sums[..., 0] = 1.0
    for k in range(p):
        sums[..., 1:] += knots[..., k, None] * sums[..., :-1]
    return np.asarray(sums / [math.comb(p, k) for k in range(p + 1)])


def extended(knots: Array, inner: Array) -> Array:
    """Weights that extend polynomials of cells to functions elsewhere, shape (n, p + 1).

    The coefficient of the other function is a weighted sum of the coefficients of the cell's own
    functions. The weights reproduce polynomials of the degree for any knots.

    Args:
        knots: Knots around each cell, shape (n, 2 p); the cell is between the middle two.
        inner: Inner knots of each other function, shape (n, p).
    """
    p = inner.shape[1]
    low, high = knots[:, p - 1, None], knots[:, p, None]
    own, other = ((t - 0.5 * (low + high)) / (high - low) for t in (knots, inner))
    windows = np.stack([own[:, m : m + p] for m in range(p + 1)], axis=1)
    return np.asarray(
        np.linalg.solve(_blossoms(windows).transpose(0, 2, 1), _blossoms(other)[..., None])[..., 0]
    )


def extension_weights(line: Array, degree: int, cell: int, function: int) -> Array:
    """Weights of a cell's functions for a function outside of it, see `extended`.

    With equal cells they are Höllig's Π_{μ≠i} (j − l − μ)/(i − l − μ).

    Args:
        line: Coordinates of the grid lines (m).
        degree: Degree of the functions.
        cell: Number of the cell.
        function: Number of the outer function.

    Returns:
        Weights of the functions cell ... cell + degree, shape (degree + 1,).
    """
    knots = np.concatenate([[line[0]] * degree, line, [line[-1]] * degree])
    around = knots[cell + 1 : cell + 2 * degree + 1]
    return extended(around[None], knots[None, function + 1 : function + degree + 1])[0]


def functions_of(
    comm: MPI.Intracomm, cells: npt.NDArray[np.int32], shape: tuple[int, ...], degree: int
) -> tuple[IndexMap, npt.NDArray[np.int32]]:
    """Number the functions that are anchored in each rank's own cells. Collective.

    Args:
        comm: Communicator.
        cells: Lattice positions of this rank's own cells, shape (n, gdim).
        shape: Number of cells of the lattice in each direction.
        degree: Degree of the functions.

    Returns:
        Index map without ghosts, and the lattice positions of its functions, shape (functions,
        gdim).
    """
    last, pieces = np.array(shape) - 1, []
    # function i is anchored at cell i − ⌊p/2⌋, clipped to the first and the last cell
    for shift in np.ndindex(*(degree + 1,) * len(shape)):
        function = cells + np.array(shift)
        anchor = np.clip(function - degree // 2, 0, last)
        pieces.append(function[np.all(anchor == cells, axis=1)])
    ijk = np.unique(np.concatenate(pieces), axis=0).astype(np.int32)
    return make_index_map(comm, len(ijk), [], []), ijk
