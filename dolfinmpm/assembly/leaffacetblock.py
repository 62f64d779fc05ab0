"""Terms over ghost facets between leaves: one element tensor for all facets of a class.

A facet is a side of the smaller leaf. Both leaves have their own functions on it; hanging nodes
join them afterwards. The size of the cells is that of the smaller leaf.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem

from dolfinmpm._platform.errors import UnsupportedGridError
from dolfinmpm.assembly.facetpenalties import INTERVALS, Pair, by_ratio
from dolfinmpm.assembly.facettensors import FacetTensors, facet_moduli, readable
from dolfinmpm.assembly.latticefacets import gauss_rule, product, splines_between
from dolfinmpm.assembly.leafpairs import leaf_pair
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
        knots: Knots (m) around the first leaf, "+", and around the second one, shape (2, gdim,
            2 degree).
        direction: Direction from the lower to the upper leaf.
        swapped: Whether the first leaf is the upper one.
    """

    knots: Array
    direction: int
    swapped: bool

    @property
    def lines(self) -> list[Array]:
        """Ends of the first leaf in each direction (m)."""
        p = self.knots.shape[2] // 2
        return [around[p - 1 : p + 1] for around in self.knots[0]]

    def sizes(self, side: str) -> tuple[float, ...]:
        """Lengths of the edges of a leaf (m); those of the smaller one for different sizes."""
        p = self.knots.shape[2] // 2
        edges = self.knots[..., p] - self.knots[..., p - 1]
        along = np.arange(edges.shape[1]) != self.direction
        same = np.allclose(edges[0][along], edges[1][along], rtol=1e-9)
        return tuple(float(edge) for edge in edges[int(same and side == "-")])


class _LeafFacetTensors(FacetTensors):
    """Element tensors between the functions of two leaves: first those of the first leaf."""

    def _zeros(self, place, pairs: int) -> Array:
        number = 2 * (self._degree + 1) ** len(place.lines)
        return np.zeros((number, number, pairs))

    def _add(self, total: Array, place, first, second, gauss, block: Array) -> None:
        each = len(total) // 2
        (side_a, a), (side_b, b) = first, second
        lines = []
        for d, (low, high) in enumerate(place.lines):
            if d == place.direction:
                x, w = np.array([low if place.swapped else high]), np.ones(1)
            else:
                points, weights = gauss_rule(gauss or self._degree + 1)
                x, w = low + 0.5 * (high - low) * (points + 1), 0.5 * (high - low) * weights
            A, B = (
                splines_between(place.knots["+-".index(side), d], x, powers[d])
                for side, powers in ((side_a, a), (side_b, b))
            )
            lines.append((w[:, None] * A).T @ B)
        rows, columns = ("+-".index(side) * each for side in (side_a, side_b))
        part = product(lines)[:, :, None] * block
        total[rows : rows + each, columns : columns + each] += part


@dataclass(frozen=True)
class _LeafFacets:
    """Facets of the integration, and entries of the matrix.

    Attributes:
        kind: Class of each facet, shape (facets,).
        keys: Key of each class, that of facets between leaves of the same sizes and places.
        places: One facet of each class.
        rows, columns: Nodes of the entries.
        entry: Entry of each pair of functions of each facet, shape (facets, m, m) flattened.
    """

    kind: npt.NDArray[np.intp]
    keys: list[tuple[float, bytes]]
    places: list[_LeafFacet]
    rows: Ints
    columns: Ints
    entry: npt.NDArray[np.intp]

    @classmethod
    def of(cls, facets: Ints, basis: LeafBasis) -> _LeafFacets:
        """The facets with these rows (cell, local facet, cell, local facet)."""
        low, high = basis.cell_corners()
        first, second = facets[:, 0], facets[:, 2]
        scale = float((high - low).max(initial=0.0)) or 1.0
        knots = np.stack([basis.knots[first], basis.knots[second]], axis=1)
        around = (knots - low[first][:, None, :, None]).reshape(len(facets), knots[:1].size)
        shape = np.round(around / scale * 1e9)
        codes = np.hstack([facets[:, 1:2], shape]).astype(np.int64)
        codes, example, kind = np.unique(codes, axis=0, return_index=True, return_inverse=True)
        places = [
            _LeafFacet(knots[f], int(facets[f, 1] // 2), bool(facets[f, 1] % 2 == 0))
            for f in example
        ]
        nodes = np.hstack([basis.corner_nodes[first], basis.corner_nodes[second]]).astype(np.int64)
        pairs, number = nodes[:, :, None] * basis.nodes.size + nodes[:, None, :], basis.nodes.size
        keys, entry = np.unique(pairs, return_inverse=True)
        rows, columns = (part.astype(np.int32) for part in np.divmod(keys, max(number, 1)))
        found = [(scale, code.tobytes()) for code in codes]
        return cls(kind.ravel(), found, places, rows, columns, entry.ravel())


class LeafFacetBlock:
    """A bilinear form over ghost facets between leaves.

    Args:
        form: The form.
        space: Space of both arguments, refined.

    Attributes:
        constants: Constants of the form.
        moduli: Moduli of facets in the form.

    Raises:
        UnsupportedGridError: The form is no form over ghost facets alone, or varies along a facet.
    """

    # subdomain ids of the facets in the form
    moving: ClassVar[set[int]] = {GHOST_FACETS}

    def __init__(self, form: ufl.Form, space: Space):
        check_on_leaves(form, space)
        self._space = space
        self._tensor_of = _LeafFacetTensors(form, space.basis.degree, space.components)
        self.constants: list[fem.Constant] = form.constants()
        self.moduli = facet_moduli(form)
        self._tensors: dict[tuple[float, bytes], Array] = {}
        # adaptive penalties by class, modulus and ratio of moduli, NaN where not known yet
        self._penalties: dict[tuple[float, bytes], Array] = {}
        self._values: Array | None = None
        self._facets: _LeafFacets | None = None
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
        self._tensors, self._penalties, self._facets = {}, {}, None

    def attach(self, entities: dict[int, Ints], basis: LeafBasis) -> None:
        """Set the ghost facets of the integration.

        Args:
            entities: Under the key GHOST_FACETS, rows (cell, local facet, cell, local facet).
            basis: Basis on the leaves.
        """
        if self._facets is not None and basis is self._basis:
            return
        self._basis = basis
        self._facets = _LeafFacets.of(entities[GHOST_FACETS].reshape(-1, 4), basis)

    @property
    def facets(self) -> _LeafFacets:
        """The facets of the integration."""
        assert self._facets is not None
        return self._facets

    @property
    def rows(self) -> Ints:
        """Nodes of the rows of the blocks."""
        return self.facets.rows

    @property
    def columns(self) -> Ints:
        """Nodes of the columns of the blocks."""
        return self.facets.columns

    def matrix(self) -> Array:
        """This rank's share of the matrix, one block per entry of `rows` and `columns`."""
        values = np.concatenate([np.empty(0), *(np.ravel(c.value) for c in self.constants)])
        if self._values is None or not np.array_equal(values, self._values):
            self._values, self._tensors, self._penalties = values, {}, {}
        c, facets, tensors = self._space.components, self.facets, []
        for key, place in zip(facets.keys, facets.places):
            if key not in self._tensors:
                self._tensors[key] = self._tensor_of.parts(place, self.moduli)
            tensors.append(self._tensors[key])
        scale: Array = np.ones((facets.kind.size, 1 + len(self.moduli)))
        for k, modulus in enumerate(self.moduli):
            modulus.values = self._scaled(k)
            scale[:, 1 + k] = modulus.values
        pairs = max((t.shape[-1] for t in tensors), default=1)
        tensors = [t * np.eye(c).ravel() if t.shape[-1] < pairs else t for t in tensors]
        sums = np.zeros((facets.rows.size, pairs))
        for k, tensor in enumerate(tensors):
            of = np.flatnonzero(facets.kind == k)
            m = tensor.shape[1]
            each = np.einsum("fp,pabq->fabq", scale[of], tensor).reshape(-1, pairs)
            at = facets.entry.reshape(-1, m * m)[of].ravel()
            for q in range(pairs):
                sums[:, q] += np.bincount(at, each[:, q], minlength=len(sums))
        if pairs == 1:
            return sums[:, :, None] * np.eye(c)
        return sums.reshape(-1, c, c)

    def _scaled(self, k: int) -> Array:
        """Values of a modulus at the facets."""
        modulus, facets = self.moduli[k], self.facets
        M, G = modulus.moduli.T
        if modulus.target is None:
            return modulus.plain(M, G)
        for key in facets.keys:
            none = np.full((len(self.moduli), INTERVALS + 1), np.nan)
            self._penalties.setdefault(key, none)
        known = np.array([self._penalties[key][k] for key in facets.keys])

        def pair_of(key: tuple[float, bytes], place: _LeafFacet) -> Callable[[], Pair]:
            return lambda: leaf_pair(place.knots, place.direction, self._tensors[key][1 + k])

        pairs = [pair_of(*both) for both in zip(facets.keys, facets.places)]
        ratios = np.divide(G, M, out=np.zeros_like(M), where=M > 0)
        known = known.reshape(-1, INTERVALS + 1)
        values = M * by_ratio(known, ratios, facets.kind, pairs, modulus.target)
        for key, row in zip(facets.keys, known):
            self._penalties[key][k] = row
        return np.asarray(values)

    def state(self) -> dict[str, npt.NDArray]:
        """The tensors kept: rounding differs between the facets that a class was integrated on.

        A rank without ghost facets has none, in arrays of the same shapes but for their rows.
        """
        if self._values is None:
            return {}
        tensors, d = list(self._tensors.values()), self._space.grid.geometry.dim
        codes = [np.frombuffer(code, np.int64) for _, code in self._tensors]
        shape = len(tensors), len(self.moduli), INTERVALS + 1
        none = np.full(shape[1:], np.nan)
        known = [self._penalties.get(key, none) for key in self._tensors]
        return {
            "constants": self._values,
            "scales": np.array([scale for scale, _ in self._tensors], float),
            "codes": np.array(codes, np.int64).reshape(-1, 1 + 4 * d * self._space.basis.degree),
            "pairs": np.array([t.shape[-1] for t in tensors], np.int64),
            "tensors": np.concatenate([np.empty(0), *(t.ravel() for t in tensors)]),
            "penalties": np.array(known, float).reshape(shape),
        }

    def set_state(self, state: dict[str, npt.NDArray]) -> None:
        """Keep the tensors that `state` returned, and no others.

        Those of another basis or kind of stabilisation are not kept, and are computed anew.
        """
        state = state if self._fits(state) else {}
        self._values, self._tensors, self._penalties = state.get("constants"), {}, {}
        m, start = 2 * (self._space.basis.degree + 1) ** self._space.grid.geometry.dim, 0
        of_all = (state.get(name, ()) for name in ("scales", "codes", "pairs"))
        for scale, code, pairs in zip(*of_all):
            shape = 1 + len(self.moduli), m, m, int(pairs)
            end = start + math.prod(shape)
            tensor = state["tensors"][start:end].reshape(shape).copy()
            self._tensors[float(scale), np.ascontiguousarray(code).tobytes()] = tensor
            start = end
        self._penalties = dict(zip(self._tensors, map(np.copy, state.get("penalties", ()))))

    def _fits(self, state: dict[str, npt.NDArray]) -> bool:
        """Whether a state is that of a form with as many moduli, in functions of this degree."""
        if "scales" not in state:  # that of a problem without leaves has none
            return False
        width = 1 + 4 * self._space.grid.geometry.dim * self._space.basis.degree
        moduli = len(self.moduli)
        return state["codes"].shape[1] == width and state["penalties"].shape[1] == moduli


def only_over(form: ufl.Form, kind: str, number: int) -> bool:
    """Whether all integrals of a form are of one kind, over the subdomain with one id."""
    return all(
        integral.integral_type() == kind and integral.subdomain_id() in (number, (number,))
        for integral in form.integrals()
    )


def check_on_leaves(form: ufl.Form, space: Space) -> None:
    """Raise UnsupportedGridError unless a form is over ghost facets alone, and constant on each."""
    kinds = {integral.integral_type() for integral in form.integrals()}
    if not (only_over(form, "interior_facet", GHOST_FACETS) and readable(form, space)):
        raise UnsupportedGridError(
            f"integrals over {', '.join(sorted(kinds))} of the grid do not know the leaves of a "
            "refined space: use sums over points (points.dx, points.dX), surfaces and boundaries, "
            "mpm.ghost for penalties over facets, or a form that is linear in the increment over "
            "active cells (points.dC); or leave refine out"
        )
