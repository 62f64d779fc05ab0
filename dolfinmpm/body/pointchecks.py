"""Checks of material points: their grid, their values, and results that a script has changed.

Steps compute some fields from others. A change of these fields by hand would be overwritten
without a message. So the end of a step seals them, see `FieldArrays`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from dolfinx.mesh import Mesh
from mpi4py import MPI

from dolfinmpm._platform.argumentchecks import array_of, floats, shown
from dolfinmpm._platform.compat import geometry_degree
from dolfinmpm._platform.errors import (
    DolfinMPMError,
    FieldShapeError,
    ParameterError,
    PointsOutsideGridError,
    UnsupportedGridError,
)
from dolfinmpm.body.axisymmetry import checked_radii
from dolfinmpm.body.location import bounds, destinations, outside_cells
from dolfinmpm.grid.cellkinds import check_cells
from dolfinmpm.grid.tensors import determinants

if TYPE_CHECKING:
    from dolfinmpm.body.points import MaterialPoints
    from dolfinmpm.body.pointtable import PointTable

__all__ = [
    "OF_STRAIN",
    "astray",
    "check_grid",
    "check_numbers",
    "checked",
    "checked_rows",
    "checked_tag",
    "error_in_fields",
    "overwritten",
    "require_grid",
    "seal_results",
    "seal_stress",
    "unseal_results",
]

# what it is called, its unit, and whether it may be zero: a point without a domain is a mere point
_SIZES = {
    "density": ("density", "kg/m^d", False),
    "V": ("volume", "m^d", False),
    "V0": ("first volume", "m^d", False),
    "l": ("half-lengths", "m", True),
    "l0": ("first half-lengths", "m", True),
}
# Fields of points in time that must be finite
_MOTION = ("velocity", "acceleration")
# Values of `moved_under` of points whose stress follows from a strain, see
# `dolfinmpm.kinematics.strainhistory.MARKS`; with those after `dolfinmpm.set_stress`
OF_STRAIN = (1, 2, 3, 4)
_GIVEN = tuple(16 + mark for mark in OF_STRAIN)
_RESULTS = ("V", "stress")
# Relative difference of volumes by rounding
_ROUNDING = 1e-9


def require_grid(grid: Any) -> None:
    """Raise unless material points can lie in a grid.

    Raises:
        ParameterError: It is no DOLFINx mesh.
        UnsupportedGridError: Its cells are prisms, pyramids, of several kinds, curved or of fewer
            dimensions than space, or its coordinates are of single precision.
    """
    if not isinstance(grid, Mesh):
        raise ParameterError(f"grid should be a dolfinx.mesh.Mesh, got a {type(grid).__name__}")
    check_cells(grid)
    if geometry_degree(grid) != 1 or grid.topology.dim != grid.geometry.dim:
        raise UnsupportedGridError(
            "the background grid must have straight-sided cells of the dimension of space, got "
            f"degree {geometry_degree(grid)}, cells of dimension {grid.topology.dim} in "
            f"{grid.geometry.dim}D"
        )
    if grid.geometry.x.dtype != np.float64:
        raise UnsupportedGridError(
            f"the background grid has coordinates of kind {grid.geometry.x.dtype}; make it in "
            "double precision, with dtype=np.float64"
        )


def check_grid(points: MaterialPoints) -> None:
    """Raise ParameterError if the grid has been moved or scaled since the points were put on it.

    Sizes of cells and positions of grid lines are read only once. Collective.
    """
    d = points.gdim
    x = np.asarray(points.grid.geometry.x[:, :d], float)
    low, high = bounds(points.grid)
    now = np.concatenate([x.min(axis=0, initial=np.inf), -x.max(axis=0, initial=-np.inf)])
    points.comm.Allreduce(MPI.IN_PLACE, now, op=MPI.MIN)
    if np.abs(now - np.concatenate([low, -high])).max() > 1e-6 * float(np.max(high - low)):
        raise ParameterError(
            f"the grid reaches from {now[:d]} to {-now[d:]} m, and did from {low} to {high} m when "
            "it was first used: its coordinates have been changed since, which points and spaces "
            "on it do not follow. Change them before, or move grid lines by mpm.regrid"
        )


def checked(what: str, values: Any, shape: tuple[int, ...]) -> npt.NDArray[np.float64]:
    """Values as floats of a shape; a single number, or one value for all points, is repeated.

    Masked values become nan.

    Raises:
        FieldShapeError: They are no numbers, or of another shape.
    """
    given = floats(values)
    if given is None:
        raise FieldShapeError(f"{what} should be numbers of shape {shape}, got {shown(values)}")
    if given.shape not in ((), shape) and (len(shape) == 1 or given.shape != shape[1:]):
        raise FieldShapeError(
            f"{what} should have shape {shape} (this rank's points first), got {given.shape}"
        )
    return np.broadcast_to(given, shape).copy()


def checked_tag(tag: Any, n: int) -> npt.NDArray[np.int32]:
    """Tags of n points.

    Raises:
        FieldShapeError: Their number is not that of the points.
        ParameterError: A tag is not a whole number of at least 0.
    """
    given = array_of("tag", tag)
    if given.size == 0 and n == 0:
        return np.empty(0, np.int32)
    whole = np.issubdtype(given.dtype, np.integer)
    if not whole or given.min() < 0 or given.max() > np.iinfo(np.int32).max:
        raise ParameterError(f"tag = {shown(tag)} must be a whole number of at least 0")
    if given.shape not in ((), (n,)):
        raise FieldShapeError(f"tag should have shape {(n,)} or be one number, got {given.shape}")
    return np.broadcast_to(given.astype(np.int32), (n,)).copy()


def checked_rows(
    grid: Mesh, x, cell, volume, half_length, density, tag, id, axisymmetric: bool
) -> dict[str, npt.NDArray[Any]]:
    """Arguments of `MaterialPoints` as arrays of this rank's points, by the names of the fields.

    Raises:
        FieldShapeError: An array has the wrong shape.
        ParameterError: A number is not whole that must be, or a cell not one of this rank.
    """
    n, d = len(x), grid.geometry.dim
    if np.shape(x) != (n, d):
        raise FieldShapeError(
            f"positions should have shape (n, {d}) on this grid of {d}D, got {np.shape(x)}"
        )
    values = {
        "id": _whole("id", np.arange(n) if id is None else id, n, np.int64),
        "cell": _whole("cell", cell, n, np.int32),
        "tag": checked_tag(tag, n),
        "x": checked("x", x, (n, d)),
        "V": checked("volume", volume, (n,)),
        "density": checked("density", density, (n,)),
        "l": checked("half_length", half_length, (n, d)),
    }
    owned = grid.topology.index_map(d).size_local
    strange = np.flatnonzero((values["cell"] < 0) | (values["cell"] >= owned))
    if strange.size:
        p = strange[0]
        raise ParameterError(
            f"cell = {values['cell'][p]} of the point at {values['x'][p]} m is not one of the "
            f"{owned} cells that this rank owns; MaterialPoints.from_arrays finds the cells"
        )
    if axisymmetric:
        checked_radii(values["x"])
    return values


def _whole(what: str, values: Any, n: int, kind: type[np.signedinteger]) -> npt.NDArray[Any]:
    given = array_of(what, values)
    if given.shape != (n,):
        raise FieldShapeError(f"{what} should have shape {(n,)}, got {given.shape}")
    if n and not np.issubdtype(given.dtype, np.integer):
        raise ParameterError(f"{what} should be whole numbers, got {given.dtype}")
    return given.astype(kind)


def error_in_fields(points) -> DolfinMPMError | None:
    """What is impossible in the fields of this rank's points, or None.

    All ranks must have asked for the `bounds` of the grid before.
    """
    grid, fields = points.grid, points.fields
    if not len(fields["x"]):
        return None
    # sums and extremes take no memory; which point is wrong is looked for only if one is
    finite = all(np.isfinite(fields[k].sum()) for k in ("x", "x0", "F", *_MOTION) if k in fields)
    possible = all(
        (fields[k].min() >= 0 if zero else fields[k].min() > 0) and fields[k].max() < np.inf
        for k, (_, _, zero) in _SIZES.items()
    )
    if not (finite and possible):
        error = _not_finite(fields) or _impossible_size(fields)
        if error is not None:
            return error
    inverted = np.flatnonzero(~(determinants(fields["F"]) > 0))
    if inverted.size:
        p = inverted[0]
        return ParameterError(
            f"{_place(fields, p)} has F = {fields['F'][p].tolist()}, whose determinant must be "
            "positive: was a field set wrongly?"
        )
    extent = bounds(grid)[1] - bounds(grid)[0]
    for name in ("l", "l0"):
        # extremes along an axis of two or three take ten times as long
        small = 2 * fields[name].max() <= extent.min() * (1 + 1e-9)
        if not small and np.any(2 * fields[name] > extent * (1 + 1e-9)):
            p = np.flatnonzero(np.any(2 * fields[name] > extent * (1 + 1e-9), axis=1))[0]
            return ParameterError(
                f"{name} = {fields[name][p]} m of {_place(fields, p)}: a domain twice as long and "
                f"wide does not fit into the grid of {extent} m; half-lengths are about half the "
                "distance of the points"
            )
    return None


def astray(points) -> PointsOutsideGridError | None:
    """An error if points of this rank are not in the cells that they are said to be in."""
    fields, partition = points.fields, points.partition
    if partition is None:
        astray = outside_cells(points.grid, fields["x"], fields["cell"])
    else:
        to = destinations(points.grid, fields["x"], None, partition)
        astray = np.flatnonzero(to.rank != points.comm.rank)
    if astray.size:
        p = astray[0]
        return PointsOutsideGridError(
            f"{_place(fields, p)} is not in the cell {fields['cell'][p]} of this rank that it is "
            f"said to be in ({astray.size} such points here); after changing x by hand call "
            "points.locate()"
        )
    return None


def _place(fields: Mapping, p: int) -> str:
    return f"point {fields['id'][p]} at {fields['x'][p]} m"


def _not_finite(fields: Mapping) -> ParameterError | None:
    for name in _MOTION:
        rows = fields[name] if name in fields else np.empty((0, 1))
        bad = np.flatnonzero(~np.isfinite(rows).all(axis=1))
        if bad.size:
            return ParameterError(
                f"{_place(fields, bad[0])} has the {name} {rows[bad[0]]}, which must be "
                "finite: was a field set wrongly?"
            )
    x, F = fields["x"], fields["F"]
    good = np.isfinite(x).all(axis=1) & np.isfinite(fields["x0"]).all(axis=1)
    bad = np.flatnonzero(~(good & np.isfinite(F).all(axis=(1, 2))))
    if bad.size == 0:
        return None
    p = bad[0]
    return ParameterError(
        f"point {fields['id'][p]} has the position {x[p]} m, at first {fields['x0'][p]} m, and "
        f"F = {F[p].tolist()}; all must be finite: was a field set wrongly?"
    )


def _impossible_size(fields: Mapping) -> ParameterError | None:
    for name, (what, unit, zero) in _SIZES.items():
        values = fields[name].reshape(len(fields["x"]), -1)
        good = (values >= 0 if zero else values > 0) & np.isfinite(values)
        bad = np.flatnonzero(~good.all(axis=1))
        if bad.size:
            p = bad[0]
            rule = "finite and not negative" if zero else "positive and finite"
            return ParameterError(
                f"{what} = {fields[name][p]} {unit} of the point at {fields['x'][p]} m must be "
                f"{rule} ({bad.size} such points on this rank)"
            )
    return None


def seal_results(points: MaterialPoints) -> None:
    """Note the volumes and stresses that a step has written."""
    points.fields.seal("V")
    seal_stress(points)


def seal_stress(points: MaterialPoints) -> None:
    """Note the stresses that a step or `dolfinmpm.set_stress` has written."""
    points.fields.seal("stress", _strained(points))


def unseal_results(points: MaterialPoints) -> None:
    """Allow changes of volumes and stresses, until they are noted again."""
    points.fields.unseal(*_RESULTS)


def overwritten(points: MaterialPoints) -> ParameterError | None:
    """Error for volumes, stresses or numbers of this rank's points that were changed, or None.

    The next step computes volumes from F and V0, and stresses from strains. Stresses of UMATs and
    of forms that contain the field `stress` are a state. They may be changed.
    """
    fields = points.fields
    if fields.broken("id"):
        return ParameterError(
            "points['id'] was changed within its array, where nobody sees whether two points have "
            "one number. Set all of it: ids = points['id'].copy(), change ids, points['id'] = ids"
        )
    if fields.broken("V"):
        V, wanted = fields.read("V"), determinants(fields.read("F")) * fields.read("V0")
        bad = np.flatnonzero(~(np.abs(V - wanted) <= _ROUNDING * np.abs(wanted)))
        if bad.size:
            p = bad[0]
            return ParameterError(
                f"points['V'] of point {fields.read('id')[p]} at {fields.read('x')[p]} m was set "
                f"to {V[p]:.6g} m^{points.strain_dim}. It must be det(F) V0 = {wanted[p]:.6g}, as "
                f"the next step computes it ({bad.size} such points on this rank). For another "
                "first volume set points['V0'] too, before the first step"
            )
    if fields.broken("stress", _strained(points)):
        largest = np.abs(fields.read("stress")).max()
        return ParameterError(
            f"points['stress'] was changed by hand (largest component now {largest:.6g} Pa), "
            "and the next step computes it from the strain of the points. Call "
            "mpm.set_stress(law, points, stress)"
        )
    return None


def _strained(points: MaterialPoints) -> slice | npt.NDArray[np.bool_]:
    """Points of this rank whose stress follows from a strain."""
    marks = points.fields.read("moved_under")
    if marks.size and marks.min() >= 1 and marks.max() <= OF_STRAIN[-1]:
        return slice(None)
    return np.isin(marks, OF_STRAIN + _GIVEN)


def check_numbers(points: PointTable, old: npt.NDArray[Any]) -> None:
    """Refuse new numbers that do not tell points apart. Collective.

    Args:
        points: The points, with new numbers "id".
        old: The numbers before, shape (n,), which come back where the new ones are refused.

    Raises:
        ParameterError: Numbers are negative, or two points have the same.
    """
    every = np.concatenate(points.comm.allgather(points["id"]))
    if every.min(initial=0) < 0 or np.unique(every).size < every.size:
        points.fields["id"] = old
        raise ParameterError(
            f"'id' identifies the points, and must be {points.total} different numbers from 0 on "
            "all ranks together; for other numbers add a field, points.add_field"
        )
    points.fields.seal("id")
