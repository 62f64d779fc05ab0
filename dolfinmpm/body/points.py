"""Material points: their arrays, and the fields that a weak form may contain."""

from __future__ import annotations

import itertools
from typing import Any

import basix.ufl
import numpy as np
import numpy.typing as npt
import ufl
from dolfinx.mesh import Mesh
from mpi4py import MPI

from dolfinmpm._platform.errors import (
    FieldShapeError,
    ParameterError,
    call_together,
    raise_together,
)
from dolfinmpm.body.location import Destinations
from dolfinmpm.body.migration import migrate

__all__ = ["MaterialPoints", "PointField"]

_numbers = itertools.count(1)

# Subdomain ids of the facets that ghost penalty acts on, and of the active cells.
GHOST_FACETS = 990_001
ACTIVE_CELLS = 990_002


class PointField(ufl.Coefficient):
    """A field of the material points, usable in UFL under the points' own measures.

    Attributes:
        name: Its name among the points' fields.
        unit: Its unit.
        points: The material points that carry it.
    """

    def __init__(self, points: MaterialPoints, name: str, shape: tuple[int, ...], unit: str):
        cell = points.grid.topology.cell_name()
        # of degree 1, for UFL would drop the gradient of a constant before it can be refused
        element = basix.ufl.element("DG", cell, 1, shape=shape)
        super().__init__(ufl.FunctionSpace(points.grid.ufl_domain(), element))
        self.points = points
        self.name = name
        self.unit = unit

    @property
    def array(self) -> npt.NDArray:
        """The values on this rank, shape (points, *shape of the field)."""
        return self.points.fields[self.name]

    def __str__(self) -> str:
        return f"points.{self.name}"


class MaterialPoints:
    """The material points of a body, each on the rank that owns the cell it is in.

    `points["name"]` is a field's array on this rank, `points.name` the same field
    for UFL. Every field moves with its point when the point changes rank.

    Measures for UFL: `points.dX` and `points.dx` sum over the points, with their
    first volume or that at the start of the step; `points.dS` integrates over the
    ghost facets and `points.dC` over the whole of the active cells.

    Fields from the start (n points on this rank, d dimensions):

    ===========  ==========  =======  =====================================
    name         shape       unit     meaning
    ===========  ==========  =======  =====================================
    id           (n,)        -        number of the point, unique, constant
    cell         (n,)        -        local index of its cell
    tag          (n,)        -        which part of the body it belongs to, a whole number
    moved_under  (n,)        -        measure of strain that it has moved under, a number; 0: none
    x, x0        (n, d)      m        position, now and at first
    V, V0        (n,)        m^d      volume, now and at first
    density      (n,)        kg/m^d   mass per initial volume
    F            (n, d, d)   -        deformation gradient
    l, l0        (n, d)      m        half-lengths of the GIMP domain
    stress       (n, 3, 3)   Pa       Cauchy stress
    ===========  ==========  =======  =====================================

    Args:
        grid: Background grid.
        x: Positions (m), shape (n, d), each in a cell that this rank owns.
        cell: Local indices of those cells, shape (n,).
        volume: Volumes (m^d), shape (n,).
        half_length: Half-lengths of the points' domains (m), shape (n, d).
        density: Mass per volume (kg/m^d), a number or an array of shape (n,).
        tag: Which part of the body the points belong to: a whole number from 0, or an array of
            shape (n,).

    Raises:
        ParameterError: A density or a volume is not positive and finite.
    """

    def __init__(
        self,
        grid: Mesh,
        x: npt.NDArray[np.float64],
        cell: npt.NDArray[np.int32],
        volume: npt.NDArray[np.float64],
        half_length: npt.NDArray[np.float64],
        density: float | npt.NDArray[np.float64],
        tag: int | npt.NDArray[np.int32] = 0,
    ):
        self.grid = grid
        self.comm: MPI.Intracomm = grid.comm
        self.number = next(_numbers)
        n, d = x.shape
        self.gdim = d
        self.fields: dict[str, npt.NDArray[Any]] = {}
        self._ufl: dict[str, PointField] = {}
        # what laws in forms need of the points, by the number in the metadata of their measures
        self.declarations: dict[int, Any] = {}
        # laws whose parameters vary from point to point, each with a field of its own
        self.laws: list[Any] = []
        rho = call_together(
            self.comm, lambda: np.broadcast_to(np.asarray(density, float), (n,)).copy()
        )
        raise_together(self.comm, _not_positive("density", "kg/m^d", rho, x))
        raise_together(self.comm, _not_positive("volume", "m^d", volume, x))
        first = self.comm.exscan(n) or 0
        self.fields["id"] = first + np.arange(n, dtype=np.int64)
        self.fields["cell"] = np.asarray(cell, np.int32)
        self.fields["tag"] = np.broadcast_to(np.asarray(tag, np.int32), (n,)).copy()
        # measure of strain of the last step, see kinematics.history
        self.fields["moved_under"] = np.zeros(n, np.int8)
        for name, values, unit in (
            ("x", x, "m"),
            ("x0", x, "m"),
            ("V", volume, "m^d"),
            ("V0", volume, "m^d"),
            ("density", rho, "kg/m^d"),
            ("F", np.broadcast_to(np.eye(d), (n, d, d)), ""),
            ("l", half_length, "m"),
            ("l0", half_length, "m"),
            ("stress", np.zeros((n, 3, 3)), "Pa"),
        ):
            self.add_field(name, values.shape[1:], unit)
            self.fields[name][:] = values
        domain = grid.ufl_domain()
        self.dX = ufl.Measure("dc", domain=domain, metadata=self._mark("V0"))
        self.dx = ufl.Measure("dc", domain=domain, metadata=self._mark("V"))
        # facets and cells themselves are found by the solver, which knows the active cells
        self.dS = ufl.Measure("dS", domain=domain, subdomain_id=GHOST_FACETS)
        self.dC = ufl.Measure("dx", domain=domain, subdomain_id=ACTIVE_CELLS)

    def _mark(self, volume: str) -> dict[str, Any]:
        return {"points": self.number, "volume": volume}

    def __len__(self) -> int:
        return len(self.fields["id"])

    @property
    def total(self) -> int:
        """Number of points on all ranks. Collective."""
        return self.comm.allreduce(len(self), op=MPI.SUM)

    def add_field(
        self, name: str, shape: tuple[int, ...] = (), unit: str = "", value: Any = 0.0
    ) -> PointField:
        """Add a field, or return the one of that name and shape.

        Args:
            name: Its name.
            shape: Shape of its value at one point.
            unit: Its unit.
            value: First value, one for all points.

        Raises:
            FieldShapeError: A field of that name has another shape.
        """
        shape = tuple(shape)
        if name in self._ufl:
            if self._ufl[name].ufl_shape != shape:
                raise FieldShapeError(
                    f"field '{name}' has shape {self._ufl[name].ufl_shape} at a point, "
                    f"asked for {shape}; choose another name"
                )
            return self._ufl[name]
        if not name.isidentifier() or name in self.__dict__ or hasattr(MaterialPoints, name):
            raise ParameterError(f"'{name}' cannot name a field; use a new identifier")
        if np.shape(value) not in ((), shape):
            raise FieldShapeError(
                f"field '{name}' has shape {shape} at a point, its first value {np.shape(value)}"
            )
        values = np.empty((len(self), *shape))
        values[:] = value
        self.fields[name] = values
        self._ufl[name] = PointField(self, name, shape, unit)
        return self._ufl[name]

    def __getattr__(self, name: str) -> PointField:
        try:
            return self.__dict__["_ufl"][name]
        except KeyError:
            known = ", ".join(self.__dict__.get("_ufl", {}))
            raise AttributeError(
                f"material points have no field '{name}'; they have {known}"
            ) from None

    def __getitem__(self, name: str) -> npt.NDArray[Any]:
        try:
            return self.fields[name]
        except KeyError:
            raise KeyError(
                f"material points have no field '{name}'; they have {', '.join(self.fields)}"
            ) from None

    def __setitem__(self, name: str, values: npt.ArrayLike) -> None:
        """Set a field's values on this rank; a single value is given to all points.

        Raises:
            FieldShapeError: The array has the wrong shape.
        """
        target = self[name]
        given = np.asarray(values)
        if given.shape not in (target.shape, target.shape[1:]):
            raise FieldShapeError(
                f"field '{name}' should have shape {target.shape} (this rank's points first) or "
                f"{target.shape[1:]} (one value for all), got {given.shape}"
            )
        target[:] = given

    def fault(self) -> ParameterError | None:
        """What is impossible in the fields of this rank's points, or None."""
        x, F = self["x"], self["F"]
        error = _not_positive("density", "kg/m^d", self["density"], x)
        error = error or _not_positive("volume", "m^d", self["V"], x)
        if error is None and not (np.isfinite(x).all() and np.isfinite(F).all()):
            bad = ~(np.isfinite(x).all(axis=1) & np.isfinite(F).all(axis=(1, 2)))
            p = int(np.flatnonzero(bad)[0])
            error = ParameterError(
                f"point {self['id'][p]} has the position {x[p]} m and F = {F[p].tolist()}; both "
                "must be finite: was a field set wrongly?"
            )
        return error

    def migrate(self, to: Destinations) -> int:
        """Hand points to the ranks that own their cells; returns how many moved. Collective."""
        return migrate(self, to)

    def gather(self, *names: str) -> tuple[npt.NDArray[Any], ...] | None:
        """Fields of all ranks, sorted by the points' id, on rank 0; None elsewhere. Collective."""
        pieces = self.comm.gather([self["id"], *(self[name] for name in names)], root=0)
        if pieces is None:
            return None
        order = np.argsort(np.concatenate([piece[0] for piece in pieces]))
        return tuple(
            np.concatenate([piece[k + 1] for piece in pieces])[order] for k in range(len(names))
        )


def _not_positive(what, unit, values, x) -> ParameterError | None:
    bad = np.flatnonzero(~(np.isfinite(values) & (values > 0)))
    if bad.size == 0:
        return None
    p = bad[0]
    return ParameterError(
        f"{what} = {values[p]} {unit} of the point at {x[p]} m must be positive and finite "
        f"({bad.size} such points on this rank)"
    )
