"""Essential conditions: the components of nodes that are prescribed, per field."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
from dolfinx import fem
from dolfinx.la import InsertMode
from mpi4py import MPI

from dolfinmpm._platform.errors import (
    ConflictingConditionsError,
    UnsupportedGridError,
    raise_together,
)
from dolfinmpm.basis import LatticeBasis, LeafBasis, LinearBasis
from dolfinmpm.basis.conditions import Condition
from dolfinmpm.basis.space import Space
from dolfinmpm.basis.stencils import Stencils
from dolfinmpm.cut.activation import Activation
from dolfinmpm.cut.activecells import active_nodes
from dolfinmpm.cut.conditionsonleaves import on_leaves

__all__ = ["EssentialConditions", "renumbered"]

Basis = LatticeBasis | LinearBasis | LeafBasis
Flags = npt.NDArray[np.bool_]
Array = npt.NDArray[np.float64]

# Number of bases, with overlap and partition, whose flags are kept
_KEPT = 8
# Two values of a node agree up to this share of the largest value that conditions of the field
# prescribe: functions of position round, as cos(pi / 2) does
_AGREE = 1e-12


def renumbered(values: npt.NDArray[Any], base: Basis, basis: Basis) -> npt.NDArray[Any]:
    """Nodal values in the numbering of a basis with another overlap or partition. Collective.

    Args:
        values: Values at the nodes of `base`, shape (nodes, n) or (nodes,). Values of nodes that
            other ranks own do not count.
        base: The basis of the space.
        basis: The same basis with another overlap and partition.

    Returns:
        Values at all nodes of `basis` known on this rank.

    Raises:
        UnsupportedGridError: The basis is on leaves, whose nodes are not those of the grid.
    """
    if isinstance(basis, LeafBasis):
        raise UnsupportedGridError(
            f"the {basis.nodes.owned} nodes of leaves on this rank are not the "
            f"{base.nodes.owned} nodes of the grid: find them by their positions"
        )
    shape = basis.nodes.size, *values.shape[1:]
    own, result = base.nodes.owned, np.zeros(shape, values.dtype)
    at = slice(own) if basis.grid_nodes is None else basis.grid_nodes[:own]
    if basis.nodes.comm.size == 1:
        result[at] = values[:own]
        return result
    width = int(np.prod(shape[1:], dtype=int))
    shared = basis.nodes.vector(width)
    shared.array[:] = 0.0
    shared.array.reshape(len(result), width)[at] = values[:own].reshape(own, width)
    if basis.grid_nodes is not None:
        shared.scatter_reverse(InsertMode.add)
    shared.scatter_forward()
    result[...] = shared.array.reshape(shape)
    return result


@dataclass(frozen=True)
class _KeptForces:
    """Forces of conditions on the body in a step.

    Attributes:
        bases: Basis of each field, with the overlap of the step.
        conditions: The conditions, at their nodes in the step.
        places: Positions of prescribed components of owned nodes in flat nodal arrays, per field.
        values: Forces there (N), per field.
    """

    bases: Sequence[Basis]
    conditions: Sequence[Condition]
    places: Sequence[npt.NDArray[np.intp]]
    values: Sequence[Array]


class EssentialConditions:
    """The conditions of a problem, for any numbering of the nodes. Collective.

    Args:
        conditions: The conditions.
        spaces: Spaces of the fields.

    Attributes:
        given: The argument.
        conditions: The same conditions, at the present nodes of those that follow a place.
        changing: Whether prescribed values may differ from zero in some step.
        follows: Whether some condition's nodes may change.
        read: The user's list, and its entries when the problem was made.

    Raises:
        ConflictingConditionsError: Two conditions prescribe different values of a component.
    """

    def __init__(self, conditions: Sequence[Condition], spaces: Sequence[Space]):
        self.given, self.conditions = list(conditions), list(conditions)
        self.read: tuple[list[Any], tuple[Any, ...]] = [], ()
        self._spaces = list(spaces)
        comm = spaces[0].grid.comm
        changing = any(condition.changes for condition in conditions)
        self.changing: bool = comm.allreduce(changing, op=MPI.LOR)
        self.follows = any(condition.place is not None for condition in conditions)
        self._fixed: dict[tuple[Basis, ...], list[Flags]] = {}
        self._still: dict[tuple[Basis, ...], list[Array]] = {}
        # values of constants at the end of the last step; first ones are there from the start
        self._reached: list[Array] = []
        self.accept()
        # forces that hold the body in the last step; see `keep_forces`
        self._forces: _KeptForces | None = None
        self.at([space.basis for space in spaces], 1.0)

    def follow(self) -> None:
        """Move conditions to the present positions of their places. Collective."""
        now = [condition.now() for condition in self.conditions]
        # on leaves the places choose other nodes than on the grid
        leaves = any(space.refinement is not None for space in self._spaces)
        if leaves or any(a is not b for a, b in zip(now, self.conditions)):
            self.conditions[:] = now
            self._fixed.clear()
            self._still.clear()

    def state(self) -> dict[str, Any]:
        """Values of the constants that conditions prescribe, now and after the last step."""
        found = {f"{k}": np.array(value.value) for k, value in enumerate(self._constants)}
        return found | {f"reached {k}": value for k, value in enumerate(self._reached)}

    def set_state(self, values: Mapping[str, Any]) -> None:
        """Restore a state returned by `state`."""
        for k, value in enumerate(self._constants):
            value.value = values[f"{k}"]
            self._reached[k] = np.array(values.get(f"reached {k}", value.value), float)

    def accept(self) -> None:
        """Keep the values of constants at the end of a step."""
        self._reached = [np.array(value.value, float) for value in self._constants]

    @property
    def moved(self) -> bool:
        """Whether a constant differs from its value at the end of the last step."""
        both = zip(self._constants, self._reached)
        return any(np.any(now.value != old) for now, old in both)

    @property
    def _constants(self) -> list[fem.Constant]:
        return [c.value for c in self.conditions if isinstance(c.value, fem.Constant)]

    @property
    def driven(self) -> bool:
        """Whether increments other than zero are prescribed now. Collective."""
        moved = any(np.any(condition.values != 0.0) for condition in self.conditions)
        return self._spaces[0].grid.comm.allreduce(moved, op=MPI.LOR)

    def at(
        self, bases: Sequence[Basis], share: float, level: float = 1.0
    ) -> tuple[list[Flags], list[Array]]:
        """Masks of the prescribed components, and their values. Collective.

        Args:
            bases: Basis of each field, with the overlap of the step.
            share: Share of the step's increments.
            level: Share of the step at which a field has its value: the constants of values go
                there evenly over a step.

        Returns:
            Masks and values per field, each of shape (nodes, components). The masks are the same
            arrays as long as the bases are the same objects.
        """
        key = tuple(bases)
        if key in self._fixed and not self.changing:
            return self._fixed[key], self._still[key]
        fixed, values = [], []
        error: Exception | None = None
        for space, basis, rounding in zip(self._spaces, bases, self._roundings()):
            leaves = isinstance(basis, LeafBasis)
            base = basis if leaves else space.basis
            shape = (base.nodes.size, space.components)
            flags, numbers = np.zeros(shape, bool), np.zeros(shape)
            shares = share, level
            error = self._apply(space, base, shares, flags, numbers, rounding) or error
            fixed.append(flags if leaves else renumbered(flags, base, basis))
            values.append(numbers if leaves else renumbered(numbers, base, basis))
        raise_together(self._spaces[0].grid.comm, error)
        while len(self._fixed) > _KEPT:
            del self._fixed[next(iter(self._fixed))]
        # values may change from step to step, the masks do not
        fixed = self._fixed.setdefault(key, fixed)
        if not self.changing:
            self._still = {key: values for key, values in self._still.items() if key in self._fixed}
            self._still[key] = values
        return fixed, values

    def within_reach(
        self, fixed: Flags, space: Space, basis: Basis, seen: Stencils, of_points: Stencils
    ) -> Flags:
        """Leave out conditions where only markers reach constrained nodes. Collective.

        A condition constrains a node that points reach, and neighbours of this node. A body that
        does not reach a side of the grid is free there, whatever its markers reach.

        Args:
            fixed: Mask of the prescribed components, shape (nodes, components).
            space, basis: The field, and its basis with the overlap of the step.
            seen: Stencils of points and markers on all active nodes.
            of_points: The same of the points alone.

        Returns:
            A mask; the same array where nothing changes.
        """
        numbering, reached = basis.nodes, np.zeros(basis.nodes.size, bool)
        reached[active_nodes(of_points, basis)] = True
        lost = np.setdiff1d(active_nodes(seen, basis), np.flatnonzero(reached))
        if not numbering.comm.allreduce(bool(fixed[lost].any()), op=MPI.LOR):
            return fixed
        result = fixed.copy()
        result[lost] = False
        group = np.repeat(np.arange(seen.groups.size - 1), np.diff(seen.node_start))
        for condition in self.conditions:
            if condition.space is not space:
                continue
            own = self._nodes_of(condition, basis)
            touched = np.bincount(group, (own & reached)[seen.nodes], seen.groups.size) > 0
            near = np.zeros(reached.size, bool)
            near[seen.nodes[touched[group]]] = True
            result[:, condition.component] |= own & numbering.share_flags(near)
        return result

    @property
    def has_forces(self) -> bool:
        """Whether forces are known, see `keep_forces`."""
        return self._forces is not None

    def keep_forces(self, here: Activation, forces: Array) -> None:
        """Keep the forces of the conditions on the body in a step, for `force_at`.

        Args:
            here: The activation of the step.
            forces: Forces at prescribed components of owned nodes (N), one field after the other.
        """
        places = [field.places[1] for field in here.unknowns.fields]
        ends = np.cumsum([own.size for own in places])[:-1]
        bases = [field.basis for field in here.fields]
        self._forces = _KeptForces(bases, list(self.conditions), places, np.split(forces, ends))

    def forces(self) -> dict[str, npt.NDArray[Any]]:
        """The kept forces of this rank and their places, by name; empty if there are none."""
        found: dict[str, npt.NDArray[Any]] = {}
        if self._forces is not None:
            for k, both in enumerate(zip(self._forces.places, self._forces.values)):
                found[f"places {k}"], found[f"forces {k}"] = both
        return found

    def set_forces(self, found: Mapping[str, npt.NDArray[Any]]) -> None:
        """Restore forces returned by `forces`, if these are for the bases of the kept ones.

        Args:
            found: The forces of this rank, or an empty dictionary.
        """
        kept, self._forces = self._forces, None
        if kept is None:
            return
        # a rank without prescribed components must not take missing forces for none
        own = [(found.get(f"places {k}"), places) for k, places in enumerate(kept.places)]
        if all(saved is not None and np.array_equal(saved, now) for saved, now in own):
            values = [found[f"forces {k}"] for k in range(len(own))]
            self._forces = replace(kept, values=values)

    def force_at(self, k: int, chosen: Sequence[Condition]) -> Array:
        """Force of some conditions on a field in the last step, on this rank. Collective.

        A component of a node that several of the conditions prescribe counts once.

        Args:
            k: Number of the field.
            chosen: Conditions among those that were given.

        Returns:
            Shape (components,).
        """
        kept, components = self._forces, self._spaces[k].components
        assert kept is not None
        basis, places = kept.bases[k], kept.places[k]
        counts = np.zeros((basis.nodes.size, components), bool)
        for given, condition in zip(self.given, kept.conditions):
            if given.space is self._spaces[k] and any(given is one for one in chosen):
                counts[:, condition.component] |= self._nodes_of(condition, basis)
        values = np.where(counts.reshape(-1)[places], kept.values[k], 0.0)
        return np.asarray(np.bincount(places % components, values, components), np.float64)

    @staticmethod
    def _nodes_of(condition: Condition, basis: Basis) -> Flags:
        """Mask of the nodes that a condition constrains, in a basis of its space. Collective."""
        if isinstance(basis, LeafBasis):
            flags = np.zeros(basis.nodes.size, bool)
            flags[on_leaves(condition, basis).nodes] = True
            return flags
        base = condition.space.basis
        flags = np.zeros(base.nodes.size, bool)
        flags[condition.nodes] = True
        return renumbered(flags, base, basis)

    def _apply(
        self, space: Space, basis: Basis, shares: tuple[float, float], flags: Flags, values: Array,
        rounding: float,
    ) -> Exception | None:  # fmt: skip
        """Set masks and values at the own nodes of this rank; returns a contradiction or None.

        On leaves they are set at all nodes that this rank knows.

        Args:
            space, basis: The field, and its basis.
            shares: `share` and `level` of `at`.
            flags, values: Masks and values, shape (nodes, components); changed.
            rounding: Largest difference of values that agree.
        """
        owner = np.full(flags.shape, -1, np.int32)
        error = None
        limit = basis.nodes.size if isinstance(basis, LeafBasis) else basis.nodes.owned
        for number, condition in enumerate(self.conditions):
            if condition.space is not space:
                continue
            if isinstance(basis, LeafBasis):
                condition = on_leaves(condition, basis)
            column, own = condition.component, condition.nodes < limit
            nodes = condition.nodes[own]
            value = np.broadcast_to(self._value(condition, *shares), condition.nodes.shape)[own]
            apart = np.abs(values[nodes, column] - value) > rounding
            differs = flags[nodes, column] & apart
            clash = nodes[differs]
            if clash.size and error is None:
                x = basis.node_coordinates()[clash[0], : space.grid.geometry.dim]
                other = self.conditions[owner[clash[0], column]]
                error = ConflictingConditionsError(
                    f"component {column} of the node at {x} m is prescribed as "
                    f"{values[clash[0], column]} by '{other.where}' and as {value[differs][0]} by "
                    f"'{condition.where}'; keep one of them"
                )
            flags[nodes, column] = True
            values[nodes, column] = value
            owner[nodes, column] = number
        return error

    def _roundings(self) -> Array:
        """Largest difference of values that agree, per field. Collective."""
        sizes = np.zeros(len(self._spaces))
        for k, space in enumerate(self._spaces):
            own = (c.values for c in self.conditions if c.space is space)
            sizes[k] = max((float(np.abs(v).max(initial=0.0)) for v in own), default=0.0)
        self._spaces[0].grid.comm.Allreduce(MPI.IN_PLACE, sizes, op=MPI.MAX)
        return _AGREE * sizes

    def _value(self, condition: Condition, share: float, level: float) -> Array:
        """Value of a condition at a share of the step; see `at`."""
        now = condition.values
        if condition.kind != "value":
            return share * now
        if level == 1.0 or not isinstance(condition.value, fem.Constant):
            return now
        constants = enumerate(self._constants)
        old = self._reached[next(k for k, one in constants if one is condition.value)]
        return np.asarray(old + level * (now - old))
