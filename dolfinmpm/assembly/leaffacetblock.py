"""Terms over ghost facets between leaves: one element tensor for all facets of a class.

A facet is a side of the smaller leaf. Both leaves have their own linear functions on it; hanging
nodes join them afterwards. The size of the cells is that of the smaller leaf.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem

from dolfinmpm._platform.errors import UnsupportedGridError
from dolfinmpm.assembly.facettensors import FacetTensors, facet_moduli, readable
from dolfinmpm.assembly.latticefacets import gauss_rule, product
from dolfinmpm.basis import LeafBasis
from dolfinmpm.basis.space import Space
from dolfinmpm.body.points import GHOST_FACETS

__all__ = ["LeafFacetBlock"]

Array = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int32]


@dataclass(frozen=True)
class _LeafFacet:
    """A facet between two leaves.

    Attributes:
        boxes: Lower and upper corners (m) of the first leaf, "+", and of the second one.
        direction: Direction from the lower to the upper leaf.
        swapped: Whether the first leaf is the upper one.
    """

    boxes: tuple[tuple[Array, Array], tuple[Array, Array]]
    direction: int
    swapped: bool

    @property
    def lines(self) -> list[Array]:
        """Ends of the first leaf in each direction (m)."""
        low, high = self.boxes[0]
        return [np.array(ends) for ends in zip(low, high)]

    def sizes(self, side: str) -> tuple[float, ...]:
        """Lengths of the edges of a leaf (m); those of the smaller one for different sizes."""
        edges = [high - low for low, high in self.boxes]
        along = np.arange(edges[0].size) != self.direction
        same = np.allclose(edges[0][along], edges[1][along], rtol=1e-9)
        return tuple(float(edge) for edge in edges[int(same and side == "-")])


class _LeafFacetTensors(FacetTensors):
    """Element tensors between the functions of two leaves: first those of the first leaf."""

    def _zeros(self, place, pairs: int) -> Array:
        number = 2 * 2 ** len(place.lines)
        return np.zeros((number, number, pairs))

    def _add(self, total: Array, place, first, second, gauss, block: Array) -> None:
        each = len(total) // 2
        (side_a, a), (side_b, b) = first, second
        lines = []
        for d, (low, high) in enumerate(place.lines):
            if d == place.direction:
                x, w = np.array([low if place.swapped else high]), np.ones(1)
            else:
                points, weights = gauss_rule(gauss or 2)
                x, w = low + 0.5 * (high - low) * (points + 1), 0.5 * (high - low) * weights
            A, B = (
                _linear(place.boxes["+-".index(side)], d, x, powers[d])
                for side, powers in ((side_a, a), (side_b, b))
            )
            lines.append((w[:, None] * A).T @ B)
        rows, columns = ("+-".index(side) * each for side in (side_a, side_b))
        part = product(lines)[:, :, None] * block
        total[rows : rows + each, columns : columns + each] += part


def _linear(box: tuple[Array, Array], d: int, x: Array, order: int) -> Array:
    """Derivatives of the two linear functions of a leaf in a direction, shape (x, 2)."""
    low, high = box[0][d], box[1][d]
    if order == 0:
        return np.column_stack([(high - x) / (high - low), (x - low) / (high - low)])
    slope = 1.0 / (high - low) if order == 1 else 0.0
    return np.column_stack([np.full(x.size, -slope), np.full(x.size, slope)])


class LeafFacetBlock:
    """A bilinear form over ghost facets between leaves.

    Args:
        form: The form.
        space: Space of both arguments, refined.

    Attributes:
        constants: Constants of the form.
        moduli: Moduli of facets in the form.
        rows, columns: Nodes of each block, after `attach`.

    Raises:
        UnsupportedGridError: The form is no form over ghost facets alone, varies along a facet, or
            has an adaptive factor.
    """

    # subdomain ids of the facets in the form
    moving: ClassVar[set[int]] = {GHOST_FACETS}

    def __init__(self, form: ufl.Form, space: Space):
        check_on_leaves(form, space)
        self._space = space
        self._tensor_of = _LeafFacetTensors(form, 1, space.components)
        self.constants: list[fem.Constant] = form.constants()
        self.moduli = facet_moduli(form)
        if any(modulus.target is not None for modulus in self.moduli):
            raise UnsupportedGridError(
                'factor="adaptive" of a ghost penalty is not available on a refined space; give '
                "a number, such as factor=1"
            )
        self._tensors: dict[tuple[float, bytes], Array] = {}
        self._values: Array | None = None
        self._facets: Ints | None = None
        self._basis: LeafBasis | None = None

    @property
    def coefficients(self) -> list[fem.Function]:
        """Coefficients of the form, which are its moduli of facets."""
        return list(self.moduli)

    def renew(self) -> None:
        """Forget the facets of the integration."""
        self._facets = None

    def regrid(self) -> None:
        """Forget values that belong to the old lines of the grid."""
        self._tensors, self._facets = {}, None

    def attach(self, entities: dict[int, Ints], basis: LeafBasis) -> None:
        """Set the ghost facets of the integration.

        Args:
            entities: Under the key GHOST_FACETS, rows (cell, local facet, cell, local facet).
            basis: Basis on the leaves.
        """
        if self._facets is not None and basis is self._basis:
            return
        self._basis, facets = basis, entities[GHOST_FACETS].reshape(-1, 4)
        self._facets = facets
        low, high = basis.cell_corners()
        first, second = facets[:, 0], facets[:, 2]
        sizes = np.hstack([high[first] - low[first], high[second] - low[second]])
        apart = low[first] - low[second]
        scale = (high - low).max(initial=0.0) or 1.0
        shape = np.round(np.hstack([sizes, apart]) / scale * 1e9).astype(np.int64)
        codes = np.hstack([facets[:, 1:2].astype(np.int64), shape])
        self._codes, example, kind = np.unique(
            codes, axis=0, return_index=True, return_inverse=True
        )
        self._kind, self._scale = kind.ravel(), scale
        self._places = [self._place(facets[f], low, high) for f in example]
        nodes = np.hstack([basis.corner_nodes[first], basis.corner_nodes[second]])
        m = nodes.shape[1]
        pairs = np.stack([np.repeat(nodes, m, axis=1).ravel(), np.tile(nodes, m).ravel()])
        number = basis.nodes.size
        keys, self._at = np.unique(pairs[0].astype(np.int64) * number + pairs[1],
                                   return_inverse=True)  # fmt: skip
        self._at = self._at.ravel()
        self.rows = (keys // max(number, 1)).astype(np.int32)
        self.columns = (keys % max(number, 1)).astype(np.int32)

    @staticmethod
    def _place(row: Ints, low: Array, high: Array) -> _LeafFacet:
        first, second = row[0], row[2]
        boxes = (low[first], high[first]), (low[second], high[second])
        return _LeafFacet(boxes, int(row[1] // 2), row[1] % 2 == 0)

    def matrix(self) -> Array:
        """This rank's share of the matrix, one block per entry of `rows` and `columns`."""
        values = np.concatenate([np.empty(0), *(np.ravel(c.value) for c in self.constants)])
        if self._values is None or not np.array_equal(values, self._values):
            self._values, self._tensors = values, {}
        c, parts = self._space.components, 1 + len(self.moduli)
        tensors = []
        for code, place in zip(self._codes, self._places):
            key = self._scale, code.tobytes()
            if key not in self._tensors:
                self._tensors[key] = self._tensor(place)
            tensors.append(self._tensors[key])
        assert self._facets is not None
        scale: Array = np.ones((len(self._facets), parts))
        for k, modulus in enumerate(self.moduli):
            modulus.values = modulus.moduli[:, 0].copy()
            scale[:, 1 + k] = modulus.values
        pairs = max((t.shape[-1] for t in tensors), default=1)
        tensors = [t * np.eye(c).ravel() if t.shape[-1] < pairs else t for t in tensors]
        sums = np.zeros((self.rows.size, pairs))
        for k, tensor in enumerate(tensors):
            of = np.flatnonzero(self._kind == k)
            m = tensor.shape[1]
            each = np.einsum("fp,pabq->fabq", scale[of], tensor).reshape(-1, pairs)
            at = self._at.reshape(-1, m * m)[of].ravel()
            for q in range(pairs):
                sums[:, q] += np.bincount(at, each[:, q], minlength=len(sums))
        if pairs == 1:
            return sums[:, :, None] * np.eye(c)
        return sums.reshape(-1, c, c)

    def _tensor(self, place: _LeafFacet) -> Array:
        """Tensors of a facet: without moduli, and per modulus, shape (1 + moduli, m, m, n)."""
        base = self._tensor_of(place)
        slopes = [self._tensor_of(place, one) for one in self.moduli]
        most, c = max(t.shape[2] for t in (base, *slopes)), self._space.components
        tensors = [t * np.eye(c).ravel() if t.shape[2] < most else t for t in (base, *slopes)]
        return np.array([tensors[0], *(t - tensors[0] for t in tensors[1:])])


def check_on_leaves(form: ufl.Form, space: Space) -> None:
    """Raise UnsupportedGridError unless a form is over ghost facets alone, and constant on each."""
    ids = [integral.subdomain_id() for integral in form.integrals()]
    flat = {i for given in ids for i in (given if isinstance(given, tuple) else (given,))}
    kinds = {integral.integral_type() for integral in form.integrals()}
    if kinds != {"interior_facet"} or flat != {GHOST_FACETS} or not readable(form, space.cell_size):
        raise UnsupportedGridError(
            f"integrals over {', '.join(sorted(kinds))} of the grid do not know the leaves of a "
            "refined space: use sums over points (points.dx, points.dX), surfaces and boundaries, "
            "or mpm.ghost for penalties over facets; or leave refine out"
        )
