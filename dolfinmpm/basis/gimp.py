"""Generalised interpolation: linear functions averaged over the points' domains, in one direction.

(Bardenhagen & Kober 2004, doi 10.3970/cmes.2004.005.477.) The average over a
domain is the sum over the cells that it overlaps of the linear function at the
middle of the overlap, weighted with the overlap's share of the domain. A point
without a domain is the standard material point method.
"""

from __future__ import annotations

import numba


@numba.njit(cache=True, error_model="numpy")
def domain_weights(line, first, count, x, half, S, dS):
    """Average of the linear functions over a domain and its gradient, in one direction."""
    for i in range(count + 1):
        S[i] = 0.0
        dS[i] = 0.0
    left = max(x - half, line[first])
    right = min(x + half, line[first + count])
    # divisions are most of what this takes
    whole = 1.0 / (right - left) if half > 0.0 else 1.0
    for c in range(count):
        lower, upper = line[first + c], line[first + c + 1]
        share, middle = 1.0, x
        if half > 0.0:
            a, b = max(left, lower), min(right, upper)
            share, middle = (b - a) * whole, 0.5 * (a + b)
        slope = share / (upper - lower)
        S[c] += slope * (upper - middle)
        S[c + 1] += slope * (middle - lower)
        dS[c] -= slope
        dS[c + 1] += slope


@numba.njit(cache=True, error_model="numpy")
def uniform_domain_weights(left, right, per_length):
    """`domain_weights` of three functions, for a domain over two cells of a uniform line at most.

    Args:
        left, right: Ends of the domain, in cells from the lower end of the first, whose
            upper end is 1.
        per_length: One over the cells' size (1/m).

    Returns:
        Three values and three slopes; the third function's are 0 where the domain ends in
        the first cell.
    """
    k = per_length
    a, b = min(right, 1.0) - left, max(right - 1.0, 0.0)
    whole = 1.0 / (a + b)
    a_share, b_share = a * whole, b * whole
    first, last = a_share * (1.0 - left - 0.5 * a), 0.5 * b * b_share
    return first, 1.0 - first - last, last, -a_share * k, (a_share - b_share) * k, b_share * k
