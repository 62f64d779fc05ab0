"""A fast `line_weights` for the middle of a uniform lattice, for compiled loops.

In the middle no knot is repeated, and a domain lies in at most two cells. Closed formulas then
replace searches. Degree and kind of the functions are constants when the loops are compiled, so
that no branch is left at run time.
"""

from __future__ import annotations

import numba

from dolfinmpm.basis.bspline import uniform_averages, uniform_weights
from dolfinmpm.basis.gimp import uniform_domain_weights
from dolfinmpm.grid.linecells import FAR, SNAP

__all__ = ["middle_count", "middle_weights"]


def middle_count(degree: int, averaged: bool) -> int:
    """Number of functions that `middle_weights` writes.

    Averaged functions have one more, because a domain may reach into a second cell.
    """
    return degree + 1 + int(averaged)


@numba.njit(cache=True, error_model="numpy", forceinline=True)
def middle_weights(degree, averaged, x, half, start, per_length, last, S, dS):
    """Values and slopes (1/m) of the functions that a point sees in one direction.

    Args:
        degree, averaged: Degree of the functions, and whether they are averaged over domains.
        x, half: Position and half-length (m).
        start, per_length, last: First coordinate of the line (m), one over its cells' size (1/m),
            and number of its last cell.
        S, dS: Written: values (-) and slopes (1/m), `middle_count` numbers each.

    Returns:
        known: Whether the point is in the middle and its domain in at most two cells. If not, the
            written numbers are wrong: call `line_weights`.
        first: The first cell of the point.
    """
    at = (x - start) * per_length
    # as `linecells.rounding`, in cells
    least = max(SNAP, FAR * (abs(start) * per_length + last + 1))
    if not averaged:
        i = int(at)
        if degree > 1:
            # splines that begin at the point's own grid line are 0 there, see `line_weights`
            if i + 1 - at < least:
                i += 1
            if at - i < least:
                at = float(i)
        known = i >= degree - 1 and i <= last - degree + 1 and (degree > 1 or at >= 0.0)
        a, b, c, e, da, db, dc, de = uniform_weights(degree, at - i, per_length)
        S[0], S[1], dS[0], dS[1] = a, b, da, db
        if degree > 1:
            S[2], dS[2] = c, dc
        if degree > 2:
            S[3], dS[3] = e, de
        return known, i
    reach = half * per_length
    left, right = at - reach, at + reach
    i = int(left)
    known = half > 0.0 and left > 0.0 and right < last and right < i + 2
    # an overlap that rounding makes does not count
    if i + 1 - left < least:
        i += 1
        left = float(i)
    if right > i + 1 and right - i - 1 < least:
        right = float(i + 1)
    left, right = left - i, right - i
    if degree == 1:
        S[0], S[1], S[2], dS[0], dS[1], dS[2] = uniform_domain_weights(left, right, per_length)
        return known, i
    known = known and i >= degree - 1 and i <= last - degree
    # the parts of the domain in the two cells
    whole = 1.0 / (right - left)
    middle, over = min(right, 1.0), max(right - 1.0, 0.0)
    share, rest = (middle - left) * whole, over * whole
    a, b, c, e, da, db, dc, de = uniform_averages(degree, left, middle, per_length)
    f, g, h, j, df, dg, dh, dj = uniform_averages(degree, 0.0, over, per_length)
    S[0], S[1], S[2] = share * a, share * b + rest * f, share * c + rest * g
    dS[0], dS[1], dS[2] = share * da, share * db + rest * df, share * dc + rest * dg
    if degree == 2:
        S[3], dS[3] = rest * h, rest * dh
    else:
        S[3], S[4] = share * e + rest * h, rest * j
        dS[3], dS[4] = share * de + rest * dh, rest * dj
    return known, i
