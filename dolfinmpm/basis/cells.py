"""Linear functions on single cells: values, gradients, and reference coordinates of positions.

Vertices are numbered as in DOLFINx: on boxes the first coordinate runs fastest.
"""

from __future__ import annotations

import numba
import numpy as np

SIMPLEX, BOX = 0, 1


@numba.njit(cache=True, error_model="numpy")
def reference_functions(kind, xi, N, dN):
    """Linear functions and their reference gradients at xi.

    Args:
        kind: SIMPLEX or BOX.
        xi: Reference coordinates, shape (d,).
        N, dN: Written: values, shape (m,), and reference gradients, shape (m, d).
    """
    d = xi.size
    if kind == SIMPLEX:
        N[0] = 1.0
        for j in range(d):
            N[0] -= xi[j]
            N[j + 1] = xi[j]
            dN[0, j] = -1.0
            for i in range(d):
                dN[i + 1, j] = 1.0 if i == j else 0.0
        return
    for a in range(N.size):
        N[a] = 1.0
        for j in range(d):
            dN[a, j] = 1.0
        for i in range(d):
            upper = (a >> i) & 1
            value, slope = (xi[i], 1.0) if upper else (1.0 - xi[i], -1.0)
            N[a] *= value
            for j in range(d):
                dN[a, j] *= slope if i == j else value


@numba.njit(cache=True, error_model="numpy")
def invert(J, K):
    """Write the inverse of a 1x1, 2x2 or 3x3 matrix J to K, and return det J."""
    d = J.shape[0]
    if d == 1:
        det = J[0, 0]
        K[0, 0] = 1.0 / det
    elif d == 2:
        det = J[0, 0] * J[1, 1] - J[0, 1] * J[1, 0]
        K[0, 0], K[1, 1] = J[1, 1] / det, J[0, 0] / det
        K[0, 1], K[1, 0] = -J[0, 1] / det, -J[1, 0] / det
    else:
        for i in range(3):
            for j in range(3):
                a, b, c, e = (j + 1) % 3, (j + 2) % 3, (i + 1) % 3, (i + 2) % 3
                K[i, j] = J[a, c] * J[b, e] - J[a, e] * J[b, c]
        det = J[0, 0] * K[0, 0] + J[0, 1] * K[1, 0] + J[0, 2] * K[2, 0]
        for i in range(3):
            for j in range(3):
                K[i, j] /= det
    return det


@numba.njit(cache=True, error_model="numpy")
def _map(kind, X, xi, N, dN, J, K):
    """Write the functions N, dN at xi, the Jacobian J of the cell with vertices X, and K = J⁻¹."""
    reference_functions(kind, xi, N, dN)
    d = xi.size
    for i in range(d):
        for j in range(d):
            J[i, j] = 0.0
            for a in range(N.size):
                J[i, j] += X[a, i] * dN[a, j]
    invert(J, K)


@numba.njit(cache=True, error_model="numpy")
def pull_back(kind, X, x, xi, N, dN, J, K):
    """Reference coordinates of x in the cell with vertices X, by Newton's method.

    Affine cells take one iteration.

    Args:
        kind: SIMPLEX or BOX.
        X: Vertices of the cell (m), shape (m, d).
        x: Position (m), shape (d,).
        xi: Written: reference coordinates, shape (d,).
        N, dN: Written: functions and reference gradients at xi, shapes (m,) and (m, d).
        J, K: Written: Jacobian at xi and its inverse, shape (d, d).

    Returns:
        Whether the iteration converged.
    """
    d = x.size
    for j in range(d):
        xi[j] = 1.0 / 3.0 if kind == SIMPLEX else 0.5
    for _ in range(25):
        _map(kind, X, xi, N, dN, J, K)
        largest = 0.0
        for j in range(d):
            step = 0.0
            for i in range(d):
                # relative to the first vertex: far from the origin rounding errors are too large
                miss = x[i] - X[0, i]
                for a in range(1, N.size):
                    miss -= N[a] * (X[a, i] - X[0, i])
                step += K[j, i] * miss
            J[j, j] = step  # room for the step: _map writes J again before its next use
            largest = max(largest, abs(step))
        if not largest < 1e3:
            return False
        if largest < 1e-12:
            _map(kind, X, xi, N, dN, J, K)
            return True
        for j in range(d):
            xi[j] += J[j, j]
    return False


@numba.njit(cache=True, error_model="numpy")
def outside_by(kind, xi):
    """Distance by which xi lies outside the reference cell; negative or zero inside."""
    far = -1.0
    total = 0.0
    for j in range(xi.size):
        far = max(far, -xi[j])
        total += xi[j]
        if kind == BOX:
            far = max(far, xi[j] - 1.0)
    if kind == SIMPLEX:
        far = max(far, total - 1.0)
    return far


@numba.njit(cache=True, error_model="numpy")
def contained(kind, vertices, coordinates, cells, x, tolerance, result):
    """Find whether each point lies in its cell.

    Args:
        kind: SIMPLEX or BOX.
        vertices: Vertices of the cells, shape (cells, m).
        coordinates: Coordinates of the vertices (m), shape (vertices, d).
        cells: Cell of each point, -1 for none, shape (points,).
        x: Positions (m), shape (points, d).
        tolerance: Distance outside the reference cell that still counts as inside.
        result: Written: the answers, shape (points,).
    """
    m, d = vertices.shape[1], x.shape[1]
    X, N, dN = np.empty((m, d)), np.empty(m), np.empty((m, d))
    J, K, xi = np.empty((d, d)), np.empty((d, d)), np.empty(d)
    for p in range(x.shape[0]):
        result[p] = False
        if cells[p] >= 0:
            for a in range(m):
                for i in range(d):
                    X[a, i] = coordinates[vertices[cells[p], a], i]
            if pull_back(kind, X, x[p], xi, N, dN, J, K):
                # positions are rounded too; the rounding error grows with distance from the origin
                rounding = 0.0
                for i in range(d):
                    for j in range(d):
                        rounding = max(rounding, abs(K[j, i]) * abs(x[p, i]))
                result[p] = outside_by(kind, xi) <= tolerance + 1e-15 * rounding
