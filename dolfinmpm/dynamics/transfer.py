"""Sums from the points to the nodes and back, along their stencils.

Σ_p S_ap w_p q_p sums values of the points at node a, and Σ_a S_ap q_a interpolates nodal values at
point p. With an affine part, point p has the value q_p + C_p (x_a − x_p) at node a.
"""

from __future__ import annotations

import functools

import numba
import numpy as np
import numpy.typing as npt

from dolfinmpm.basis.incidence import by_nodes
from dolfinmpm.basis.stencils import Stencils
from dolfinmpm.body.points import MaterialPoints

__all__ = [
    "collect",
    "mass_entries",
    "moments",
    "scatter",
    "scatter_affine",
    "scatter_stress",
    "scatter_tensor",
]

Array = npt.NDArray[np.float64]


@numba.njit(cache=True, error_model="numpy")
def _scatter(order, groups, node_start, nodes, value_start, N, weight, q, out):
    components = q.shape[1]
    for g in range(groups.size - 1):
        first = node_start[g]
        m = node_start[g + 1] - first
        for position in range(groups[g], groups[g + 1]):
            p = order[position]
            at = value_start[g] + (position - groups[g]) * m
            for a in range(m):
                w = N[at + a] * weight[p]
                for i in range(components):
                    out[nodes[first + a], i] += w * q[p, i]


@functools.cache
def _scatter_loop(d: int):
    """The loop of `scatter` for vectors of two or three components, which stay in registers."""
    three = d == 3

    @numba.njit(cache=True, error_model="numpy")
    def kernel(order, groups, node_start, nodes, value_start, N, weight, q, out):
        for g in range(groups.size - 1):
            first, at = node_start[g], value_start[g]
            m = node_start[g + 1] - first
            for position in range(groups[g], groups[g + 1]):
                p = order[position]
                x, y, z = q[p, 0], q[p, 1], q[p, 2] if three else 0.0
                for a in range(m):
                    node, w = nodes[first + a], N[at + a] * weight[p]
                    out[node, 0] += w * x
                    out[node, 1] += w * y
                    if three:
                        out[node, 2] += w * z
                at += m

    return kernel


@numba.njit(cache=True, error_model="numpy")
def _scatter_affine(order, groups, node_start, nodes, value_start, N, x_node, x, weight, q, C, out):
    d = x.shape[1]
    for g in range(groups.size - 1):
        first = node_start[g]
        m = node_start[g + 1] - first
        for position in range(groups[g], groups[g + 1]):
            p = order[position]
            at = value_start[g] + (position - groups[g]) * m
            for a in range(m):
                node = nodes[first + a]
                w = N[at + a] * weight[p]
                for i in range(d):
                    value = q[p, i]
                    for j in range(d):
                        value += C[p, i, j] * (x_node[node, j] - x[p, j])
                    out[node, i] += w * value


@numba.njit(cache=True, error_model="numpy")
def _collect(order, groups, node_start, nodes, value_start, N, q, out):
    components = q.shape[1]
    for g in range(groups.size - 1):
        first = node_start[g]
        m = node_start[g + 1] - first
        for position in range(groups[g], groups[g + 1]):
            p = order[position]
            at = value_start[g] + (position - groups[g]) * m
            for i in range(components):
                out[p, i] = 0.0
            for a in range(m):
                for i in range(components):
                    out[p, i] += N[at + a] * q[nodes[first + a], i]


@functools.cache
def _collect_loop(d: int):
    """The loop of `collect` for vectors of two or three components, which stay in registers."""
    three = d == 3

    @numba.njit(cache=True, error_model="numpy")
    def kernel(order, groups, node_start, nodes, value_start, N, q, out):
        for g in range(groups.size - 1):
            first, at = node_start[g], value_start[g]
            m = node_start[g + 1] - first
            for position in range(groups[g], groups[g + 1]):
                x = y = z = 0.0
                for a in range(m):
                    node, w = nodes[first + a], N[at + a]
                    x += w * q[node, 0]
                    y += w * q[node, 1]
                    if three:
                        z += w * q[node, 2]
                p = order[position]
                out[p, 0], out[p, 1] = x, y
                if three:
                    out[p, 2] = z
                at += m

    return kernel


@numba.njit(cache=True, error_model="numpy")
def _moments(order, groups, node_start, nodes, value_start, N, q, q_point, r, r_point, out):
    d, e = q.shape[1], r.shape[1]
    for g in range(groups.size - 1):
        first = node_start[g]
        m = node_start[g + 1] - first
        for position in range(groups[g], groups[g + 1]):
            p = order[position]
            at = value_start[g] + (position - groups[g]) * m
            for i in range(d):
                for j in range(e):
                    out[p, i, j] = 0.0
            for a in range(m):
                node = nodes[first + a]
                for j in range(e):
                    arm = N[at + a] * (r[node, j] - r_point[p, j])
                    for i in range(d):
                        out[p, i, j] += (q[node, i] - q_point[p, i]) * arm


@functools.cache
def _stress_loop(d: int):
    """The loop of `scatter_stress` in d dimensions, which are constant when it is compiled."""

    @numba.njit(cache=True, error_model="numpy")
    def kernel(order, groups, node_start, nodes, value_start, dN, stress, out):
        sigma = np.empty((d, d))
        for g in range(groups.size - 1):
            first, at = node_start[g], value_start[g]
            m = node_start[g + 1] - first
            for position in range(groups[g], groups[g + 1]):
                p = order[position]
                for i in range(d):
                    for j in range(d):
                        sigma[i, j] = stress[p, i, j]
                for a in range(m):
                    node = nodes[first + a]
                    for i in range(d):
                        force = out[node, i]
                        for j in range(d):
                            force += sigma[i, j] * dN[at + a, j]
                        out[node, i] = force
                at += m

    return kernel


@numba.njit(cache=True, error_model="numpy")
def _mass_entries(order, groups, node_start, nodes, value_start, N, mass, rows, columns, values):
    """Write the entries row by row, with increasing columns; returns their number."""
    low, start, lists, places = by_nodes(0, groups.size - 1, node_start, nodes)
    size, count = start.size - 1, 0
    # entry of a column in the present row, or -1
    slot = np.full(size, -1, np.int32)
    for a in range(size):
        begin = count
        for e in range(start[a], start[a + 1]):
            first = node_start[lists[e]]
            for c in range(first, node_start[lists[e] + 1]):
                column = nodes[c]
                if slot[column - low] < 0:
                    slot[column - low] = 0
                    k = count
                    while k > begin and columns[k - 1] > column:
                        columns[k] = columns[k - 1]
                        k -= 1
                    columns[k] = column
                    count += 1
        for k in range(begin, count):
            slot[columns[k] - low] = k
            rows[k], values[k] = low + a, 0.0
        for e in range(start[a], start[a + 1]):
            g = lists[e]
            first = node_start[g]
            m = node_start[g + 1] - first
            for position in range(groups[g], groups[g + 1]):
                at = value_start[g] + (position - groups[g]) * m
                weight = mass[order[position]] * N[at + places[e]]
                for b in range(m):
                    values[slot[nodes[first + b] - low]] += weight * N[at + b]
        for k in range(begin, count):
            slot[columns[k] - low] = -1
    return count


def _rows(s: Stencils):
    return s.order, s.groups, s.node_start, s.nodes, s.value_start, s.N


def scatter(s: Stencils, weight: Array, q: Array, out: Array) -> None:
    """Add Σ_p S_ap w_p q_p to nodal sums.

    Args:
        s: Stencils.
        weight: w, shape (points,).
        q: Values of the points, shape (points, components).
        out: Sums, shape (nodes, components).
    """
    loop = _scatter_loop(q.shape[1]) if q.shape[1] in (2, 3) else _scatter
    loop(*_rows(s), weight, q, out)


def scatter_affine(
    s: Stencils, x_node: Array, x: Array, weight: Array, q: Array, C: Array, out: Array
) -> None:
    """Add Σ_p S_ap w_p (q_p + C_p (x_a − x_p)) to nodal sums.

    Args:
        s: Stencils.
        x_node: Positions of the nodes (m), shape (nodes, at least d).
        x: Positions of the points (m), shape (points, d).
        weight: w, shape (points,).
        q: Shape (points, d).
        C: Shape (points, d, d).
        out: Sums, shape (nodes, d).
    """
    _scatter_affine(*_rows(s), x_node, x, weight, q, C, out)


def scatter_stress(s: Stencils, stress: Array, out: Array) -> None:
    """Add Σ_p σ_p · ∇S_ap to nodal forces (N).

    Args:
        s: Stencils.
        stress: Stresses times volumes (N m), shape (points, d, d).
        out: Sums, shape (nodes, d).
    """
    loop = _stress_loop(s.dN.shape[1])
    loop(s.order, s.groups, s.node_start, s.nodes, s.value_start, s.dN, stress, out)


def scatter_tensor(points: MaterialPoints, s: Stencils, stress: Array, out: Array) -> None:
    """Add the forces (N) of stresses at the points to nodal sums, with any hoop stress.

    Args:
        points: Material points.
        s: Their stencils.
        stress: Stresses times volumes (N m), shape (points, e, e), e being 3 or `strain_dim`.
        out: Sums, shape (nodes, d).
    """
    d = points.gdim
    scatter_stress(s, stress[:, :d, :d], out)
    if points.axisymmetric:
        radial = np.zeros((len(stress), d))
        radial[:, 0] = stress[:, 2, 2] / points["x"][:, 0]
        scatter(s, np.ones(len(stress)), radial, out)


def collect(s: Stencils, q: Array, size: int | None = None) -> Array:
    """Σ_a S_ap q_a at the points, shape (points, components).

    Args:
        s: Stencils.
        q: Nodal values, shape (nodes, components).
        size: Number of all points, if the stencils are those of some points. Other points get 0.
    """
    out = np.zeros((s.order.size if size is None else size, q.shape[1]))
    loop = _collect_loop(q.shape[1]) if q.shape[1] in (2, 3) else _collect
    loop(*_rows(s), q, out)
    return out


def moments(s: Stencils, q: Array, q_point: Array, r: Array, r_point: Array) -> Array:
    """Σ_a S_ap (q_a − q_p) ⊗ (r_a − r_p) at the points.

    With q = r = x the result is the D of APIC (Jiang et al. 2015, doi 10.1145/2766996). D is h²/4
    and h²/3 times the identity for quadratic and cubic splines. It is singular for linear functions
    and a point at a node. For GIMP it is at least h/2 times the half-length of the domain.

    Args:
        s: Stencils.
        q: Nodal values, shape (nodes, c).
        q_point: The sums Σ_a S_ap q_a, shape (points, c).
        r: Nodal values, shape (nodes, e).
        r_point: The sums Σ_a S_ap r_a, shape (points, e).

    Returns:
        Shape (points, c, e).
    """
    out = np.empty((s.order.size, q.shape[1], r.shape[1]))
    _moments(*_rows(s), q, q_point, r, r_point, out)
    return out


def mass_entries(s: Stencils, mass: Array) -> tuple[npt.NDArray, npt.NDArray, Array]:
    """Entries Σ_p m_p S_ap S_bp of the consistent mass, by rows and then by columns.

    Args:
        s: Stencils.
        mass: m (kg), shape (points,).

    Returns:
        Nodes of the rows, of the columns and values (kg), shape (n,) each.
    """
    # largest number of entries: no two groups share a pair of nodes
    most = int(np.sum(np.diff(s.node_start).astype(np.int64) ** 2))
    rows, columns = np.empty(most, np.int32), np.empty(most, np.int32)
    values = np.empty(most)
    count = _mass_entries(*_rows(s), mass, rows, columns, values) if most else 0
    return rows[:count].copy(), columns[:count].copy(), values[:count].copy()
