"""Rectangles of eight-node quadrilaterals, for the conforming elements of `conforming.py`."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

# places of the eight nodes in [-1, 1]²: corners, then the middles of the sides
_XI = np.array([-1.0, 1, 1, -1, 0, 1, 0, -1])
_ETA = np.array([-1.0, -1, 1, 1, -1, 0, 1, 0])
# nodes of the sides from end to end, with the middle in between; the body is to their left
_SIDES = {"bottom": (0, 4, 1), "right": (1, 5, 2), "top": (2, 6, 3), "left": (3, 7, 0)}


def shapes(x: float, y: float) -> tuple[Array, Array]:
    """Values, shape (8,), and reference gradients, shape (8, 2), of the eight shape functions."""
    value, gradient = np.empty(8), np.empty((8, 2))
    a, b = _XI[:4], _ETA[:4]
    u, v = 1 + a * x, 1 + b * y
    value[:4] = u * v * (a * x + b * y - 1) / 4
    gradient[:4, 0] = a * v * (2 * a * x + b * y) / 4
    gradient[:4, 1] = b * u * (a * x + 2 * b * y) / 4
    for k in (4, 6):  # middles of the lower and the upper side
        v = 1 + _ETA[k] * y
        value[k] = (1 - x * x) * v / 2
        gradient[k] = -x * v, (1 - x * x) * _ETA[k] / 2
    for k in (5, 7):
        u = 1 + _XI[k] * x
        value[k] = (1 - y * y) * u / 2
        gradient[k] = (1 - y * y) * _XI[k] / 2, -y * u
    return value, gradient


class Mesh:
    """Eight-node quadrilaterals in rows and columns.

    Args:
        xs: Coordinates (m) of the grid's columns, rising.
        ys: Coordinates (m) of its rows, rising.
        place: Where a node goes, from shape (n, 2) to shape (n, 2); it stays by default.

    Attributes:
        x: Nodes (m), shape (nodes, 2).
        cells: Nodes of the elements, shape (elements, 8).
        sides: Side → nodes of its edges, shape (edges, 3), the middle one in between.
        gradients: Gradients of shape functions at the Gauss points (1/m), shape
            (4·elements, 8, 2).
        values: Shape functions there, shape (4·elements, 8).
        weights: Areas of the Gauss points (m²), shape (4·elements,).
    """

    def __init__(self, xs, ys, place: Callable[[Array], Array] = lambda x: x):
        nx, ny = len(xs) - 1, len(ys) - 1
        number = np.full((2 * nx + 1, 2 * ny + 1), -1)
        used = np.ones(number.shape, bool)
        used[1::2, 1::2] = False
        number[used] = np.arange(used.sum())
        fine = [np.sort(np.r_[c, (c[1:] + c[:-1]) / 2]) for c in (np.asarray(xs), np.asarray(ys))]
        grid = np.stack(np.meshgrid(*fine, indexing="ij"), axis=-1)
        self.x = place(grid[used])
        i, j = (2 * k.ravel()[:, None] for k in np.meshgrid(range(nx), range(ny), indexing="ij"))
        self.cells = number[i + 1 + _XI.astype(int), j + 1 + _ETA.astype(int)]
        ends = {
            "bottom": j[:, 0] == 0,
            "right": i[:, 0] == 2 * nx - 2,
            "top": j[:, 0] == 2 * ny - 2,
            "left": i[:, 0] == 0,
        }
        self.sides = {side: self.cells[at][:, _SIDES[side]] for side, at in ends.items()}

        g = 1 / np.sqrt(3)
        tables = [shapes(a, b) for a in (-g, g) for b in (-g, g)]
        reference = np.array([t[1] for t in tables])
        X = self.x[self.cells]
        jacobian = np.einsum("gak,eai->egik", reference, X).reshape(-1, 2, 2)
        self.weights = np.linalg.det(jacobian)
        assert (self.weights > 0).all(), "an element is turned over"
        inverse = np.linalg.inv(jacobian)
        repeated = np.tile(reference, (len(X), 1, 1))
        self.gradients = repeated @ inverse
        self.values = np.tile(np.array([t[0] for t in tables]), (len(X), 1))

    def nodes(self, side: str) -> npt.NDArray[np.int_]:
        """Nodes of a side, each once."""
        return np.unique(self.sides[side])

    def body_load(self, force) -> Array:
        """Nodal forces (N/m) of a body force (N/m³), shape (nodes, 2)."""
        result = np.zeros_like(self.x)
        share = (self.values * self.weights[:, None]).reshape(-1, 4, 8).sum(axis=1)
        np.add.at(result, self.cells, share[:, :, None] * np.asarray(force, float))
        return result

    def edge_load(self, side: str, traction: Callable[[Array, Array], Array]) -> Array:
        """Nodal forces (N/m) of a dead traction on the first configuration, shape (nodes, 2).

        Args:
            side: One of "bottom", "right", "top" and "left".
            traction: Traction (Pa), shape (n, 2), of positions and outer unit normals.
        """
        edges = self.sides[side]
        result = np.zeros_like(self.x)
        for s, weight in zip(*np.polynomial.legendre.leggauss(5)):
            value = np.array([s * (s - 1) / 2, 1 - s * s, s * (s + 1) / 2])
            slope = np.array([s - 0.5, -2 * s, s + 0.5])
            x = np.einsum("a,eai->ei", value, self.x[edges])
            tangent = np.einsum("a,eai->ei", slope, self.x[edges])
            length = np.linalg.norm(tangent, axis=1)[:, None]
            normal = np.stack([tangent[:, 1], -tangent[:, 0]], axis=1) / length
            force = traction(x, normal) * length * weight
            np.add.at(result, edges, value[:, None] * force[:, None, :])
        return result

    def strip_load(self, side: str, traction, low: float, high: float) -> Array:
        """`edge_load` of a constant traction (Pa) on those edges that lie in low ≤ x ≤ high."""
        # edges end at the ends of the strip, so that no edge is loaded in part
        return self.edge_load(
            side, lambda x, n: np.where((x[:, :1] > low) & (x[:, :1] < high), 1.0, 0.0) * traction
        )

    def follower(self, side: str, low: float, high: float) -> Array:
        """What unit pressure does that stays normal to the deformed edges in low ≤ X ≤ high.

        Its nodal forces are linear in the present positions, as an edge's normal times its
        length is its tangent turned by a right angle.

        Returns:
            Element matrices L of the nodal forces L x (N/m), shape (elements, 16, 16).
        """
        L = np.zeros((len(self.cells), 8, 2, 8, 2))
        s, weight = np.polynomial.legendre.leggauss(3)
        value = np.array([s * (s - 1) / 2, 1 - s * s, s * (s + 1) / 2])
        slope = np.array([s - 0.5, -2 * s, s + 0.5])
        table = (value * weight) @ slope.T
        local = np.array(_SIDES[side])
        middle = self.x[self.cells[:, local[1]], 0]
        ends = {tuple(edge) for edge in self.sides[side]}
        for e, cell in enumerate(self.cells):
            if tuple(cell[local]) in ends and low < middle[e] < high:
                # outer normal times length is (t_y, −t_x) of the tangent t
                L[e, local[:, None], 0, local[None, :], 1] = -table
                L[e, local[:, None], 1, local[None, :], 0] = table
        return L.reshape(-1, 16, 16)
