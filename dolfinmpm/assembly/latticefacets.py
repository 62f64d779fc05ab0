"""Facets of rectangular grids: their cells, and one-dimensional matrices of splines around them."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

__all__ = ["LatticeFacet", "gauss_rule", "one_dimensional", "product", "splines", "splines_between"]

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class LatticeFacet:
    """Position of a facet in a lattice.

    Attributes:
        lines: Coordinates of the lattice's nodes in each direction (m).
        low: Lattice position of the lower one of the two cells at the facet.
        direction: Direction from the lower to the upper cell.
        swapped: Whether the upper cell is the first cell, "+".
    """

    lines: Sequence[Array]
    low: tuple[int, ...]
    direction: int
    swapped: bool

    def cell(self, side: str) -> tuple[int, ...]:
        """Lattice position of the cell on a side."""
        upper = (side == "+") == self.swapped
        return tuple(i + (upper and d == self.direction) for d, i in enumerate(self.low))

    def sizes(self, side: str) -> tuple[float, ...]:
        """Lengths of the edges of the cell on a side (m)."""
        return tuple(float(x[i + 1] - x[i]) for x, i in zip(self.lines, self.cell(side)))


gauss_rule = functools.cache(np.polynomial.legendre.leggauss)


def splines(line: Array, degree: int, cell: int, x: Array, order: int) -> Array:
    """Derivatives of the functions of a cell of a line, see `splines_between`."""
    knots = np.concatenate([[line[0]] * degree, line, [line[-1]] * degree])
    return splines_between(knots[cell + 1 : cell + 2 * degree + 1], x, order)


def splines_between(knots: Array, x: Array, order: int) -> Array:
    """Derivatives of the functions of a cell, as polynomials also outside it, shape (x, p + 1).

    First come recursions of Cox and de Boor for values, then recursions for derivatives (de Boor,
    A Practical Guide to Splines, 1978, ch. X).

    Args:
        knots: Knots around the cell (m), shape (2 p,); the cell is between the middle two.
        x: Positions (m).
        order: Order of the derivative.
    """
    p = knots.size // 2
    if order > p:
        return np.zeros((x.size, p + 1))
    values: Array = np.ones((x.size, 1))
    for k in range(1, p + 1):
        # functions p − k + 1 ... p of degree k − 1 begin at `start` and end at `end`
        start, end = knots[p - k : p], knots[p : p + k]
        share = values / (end - start)
        before = np.zeros((x.size, k + 1))
        after = np.zeros((x.size, k + 1))
        if k > p - order:
            before[:, 1:], after[:, :-1] = k * share, -k * share
        else:
            before[:, 1:] = (x[:, None] - start) * share
            after[:, :-1] = (end - x[:, None]) * share
        values = before + after
    return values


def one_dimensional(
    place: LatticeFacet, side: str, direction: int, degree: int
) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    """Integrals of products of the splines around a facet, over a cell's edge in one direction.

    Args:
        place: The facet.
        side: Side of the cell, "+" or "-".
        direction: The direction.
        degree: Degree of the splines.

    Returns:
        Matrices of ∫ N_a^(i) N_b^(k), by the orders i and k of derivatives, 0 or 1.
    """
    line, cell, low = place.lines[direction], place.cell(side)[direction], place.low[direction]
    points, weights = gauss_rule(degree + 1)
    h = line[cell + 1] - line[cell]
    x = line[cell] + 0.5 * h * (points + 1)
    values = np.zeros((2, x.size, degree + 1 + (direction == place.direction)))
    for order in (0, 1):
        values[order, :, cell - low : cell - low + degree + 1] = splines(
            line, degree, cell, x, order
        )
    first, second = (
        tuple((0.5 * h * weights * values[i].T) @ values[k] for k in (0, 1)) for i in (0, 1)
    )
    return first, second


def product(lines: Sequence[Array]) -> Array:
    """Kronecker product of matrices, one per direction."""
    product: Array = np.ones((1, 1))
    for matrix in lines:
        product = np.asarray(np.kron(product, matrix))
    return product
