"""Functions of one direction of a rectangular grid, at a point or averaged over its domain."""

from __future__ import annotations

import math

import numba

from dolfinmpm.basis.bspline import averaged_spline_weights, weights_at
from dolfinmpm.basis.gimp import domain_weights
from dolfinmpm.grid.linecells import cell_of, rounding

__all__ = [
    "INNER",
    "cell_shares",
    "line_shares",
    "line_weights",
    "overlapped",
    "ring_slopes",
    "snapped",
]

# Part of a domain's half-length within which it has shares in cells for averages. After the
# smallest motion, all domains beside a grid line reach across it. With shares of whole domains,
# tangents with F-bar would have twice as many entries in 3D, most of them below 1e-6 of the
# diagonal.
INNER = 1.0 - 2e-3


@numba.njit(cache=True, error_model="numpy")
def overlapped(line, uniform, x, half):
    """First cell that a domain overlaps, and number of overlapped cells, in one direction.

    A point without a domain is in one cell. On a grid line it is in the upper cell.

    Args:
        line: Coordinates of the grid lines (m).
        uniform: Whether all cells have the same size.
        x, half: Position and half-length of the domain (m); 0 for a point without a domain.
    """
    first = cell_of(line, uniform, x - half)
    last = first
    least = rounding(line[first], line[first + 1])
    if half == 0.0 and first < line.size - 2 and line[first + 1] - x < least:
        return first + 1, 1
    if half > 0.0:
        last = cell_of(line, uniform, x + half)
        left, right = max(x - half, line[0]), min(x + half, line[line.size - 1])
        if last > first and line[first + 1] - left < least:
            first += 1
        if last > first and right - line[last] < rounding(line[last], line[last + 1]):
            last -= 1
    return first, last - first + 1


@numba.njit(cache=True, inline="always")
def snapped(line, first, x, half):
    """Move a point without a domain onto the edge of its cell if only rounding separates them."""
    if half == 0.0:
        least = rounding(line[first], line[first + 1])
        if x - line[first] < least:
            x = line[first]
        elif line[first + 1] - x < least:
            x = line[first + 1]
    return x


@numba.njit(cache=True, error_model="numpy")
def line_weights(line, uniform, degree, first, count, x, half, S, dS, part, slope):
    """Values and slopes (1/m) of the functions that a point sees in one direction.

    Stencils and explicit steps both take their weights from this function.

    Args:
        line: Coordinates of the lattice in this direction (m).
        uniform: Whether all cells have the same size.
        degree: Degree of the functions.
        first, count: First cell that the point's domain overlaps, and number of overlapped cells;
            see `overlapped`.
        x, half: Position and half-length (m); the half-length is 0 for a point without a domain.
        S, dS: Written: values (-) and slopes (1/m), count + degree numbers each.
        part, slope: Scratch arrays, degree + 1 numbers each.
    """
    x = snapped(line, first, x, half)
    if degree == 1:
        domain_weights(line, first, count, x, half, S, dS)
    elif half > 0.0:
        averaged_spline_weights(line, uniform, first, count, degree, x, half, S, dS, part, slope)
    else:
        weights_at(line, uniform, first, degree, x, S, dS)


@numba.njit(cache=True, error_model="numpy")
def ring_slopes(line, uniform, degree, first, count, x, half, dS, part, slope):
    """Averages of the radial slopes over an axisymmetric domain: mean of r dN/dr over mean r.

    The hoop term has S/r. The averages are the remaining part of the integral of (r N)'. A uniform
    pressure is then in balance for all functions, even if slopes vary within a domain.

    Args:
        line, uniform, degree, first, count, x, half, part, slope: See `line_weights`; the
            half-length is positive.
        dS: Written: averages of the slopes (1/m), count + degree numbers.
    """
    for i in range(count + degree):
        dS[i] = 0.0
    left = max(x - half, line[first])
    right = min(x + half, line[first + count])
    mean = 0.5 * (left + right)
    for c in range(count):
        a, b = max(left, line[first + c]), min(right, line[first + c + 1])
        share, middle = 0.5 * (b - a) / (right - left) / mean, 0.5 * (a + b)
        if degree == 1:
            # the slope is the same in a whole cell
            rise = 2.0 * share * middle / (line[first + c + 1] - line[first + c])
            dS[c] -= rise
            dS[c + 1] += rise
            continue
        reach = 0.5 * (b - a) / math.sqrt(3.0)
        for side in range(2):
            at = middle - reach if side == 0 else middle + reach
            weights_at(line, uniform, first + c, degree, at, part, slope)
            for i in range(degree + 1):
                dS[c + i] += share * at * slope[i]


@numba.njit(cache=True, error_model="numpy")
def line_shares(line, uniform, degree, first, count, x, half, shares, room, part, slope):
    """Weights of a point for averages over cells: splines of one degree less, in one direction.

    For linear functions the weights are the shares of the inner part of the point's domain in the
    cells, see `cell_shares`; `dolfinmpm.cut.cellaverages` has the averages.

    Args:
        line, uniform, degree, first, count, x, half: See `line_weights`.
        shares: Written: weights (-), count + degree - 1 numbers.
        room: Scratch array, count + degree - 1 numbers.
        part, slope: Scratch arrays, degree numbers each.
    """
    if degree > 1:
        line_weights(line, uniform, degree - 1, first, count, x, half, shares, room, part, slope)
        return
    cell_shares(line, first, count, x, half, shares)
    total = 0.0
    for c in range(count):
        total += shares[c]
    # parts of a domain outside the grid do not count
    for c in range(count):
        shares[c] /= total


@numba.njit(cache=True, error_model="numpy", inline="always")
def cell_shares(line, first, count, x, half, shares):
    """Shares of the inner part of a domain in cells, in one direction.

    Args:
        line: Coordinates of the lattice in this direction (m).
        first, count: First cell that the point's domain overlaps, and number of overlapped cells.
        x, half: Position and half-length of the domain (m); the half-length is positive if there
            are several cells.
        shares: Written: parts of the inner domain's length (-), count numbers.
    """
    if count == 1:
        shares[0] = 1.0
        return
    inner = INNER * half
    for c in range(count):
        left, right = max(x - inner, line[first + c]), min(x + inner, line[first + c + 1])
        shares[c] = max(right - left, 0.0) / (2.0 * inner)
