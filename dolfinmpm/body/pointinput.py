"""Points from given positions: their cells, ranks and numbers, each point on one rank."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
from dolfinx.mesh import Mesh
from mpi4py import MPI

from dolfinmpm._platform.argumentchecks import array_of, check_dictionary, floats, shown, truth
from dolfinmpm._platform.errors import (
    EmptyShapeError,
    FieldShapeError,
    ParameterError,
    PointsOutsideGridError,
    call_together,
    raise_together,
)
from dolfinmpm.body.axisymmetry import checked_radii, require_axis, ring
from dolfinmpm.body.exchange import Rows, exchange, numbers_in_order
from dolfinmpm.body.location import Destinations, destinations
from dolfinmpm.body.pointchecks import checked, checked_tag, require_grid
from dolfinmpm.body.pointtable import BUILT_IN
from dolfinmpm.grid.userfunctions import call_function

if TYPE_CHECKING:
    from dolfinmpm.body.points import MaterialPoints

__all__ = ["destinations_of", "located"]

Array = npt.NDArray[np.float64]

# Ratio of domain to volume from which on half-lengths are whole lengths, which make 2 in 1D
_LARGER = 1.9

# Names that further fields cannot have; an initial stress is such a field
_RESERVED = {"id", "cell", "tag", "moved_under", *BUILT_IN} - {"stress"}


def located(
    grid: Mesh,
    x,
    volume,
    density,
    tag,
    half_length,
    fields,
    id,
    axisymmetric: bool,
) -> tuple[Rows, Rows]:
    """Arguments of `MaterialPoints` and further fields, of points given anyhow. Collective.

    The arguments are those of `MaterialPoints.from_arrays`.
    """
    require_grid(grid)
    if truth("axisymmetric", axisymmetric):
        require_axis(grid)
    comm, gdim = grid.comm, grid.geometry.dim
    given = call_together(
        comm,
        lambda: _rows(gdim, x, volume, density, tag, half_length, fields, id, axisymmetric),
    )
    rows = _once(comm, _alike(comm, given))
    numbers = numbers_in_order(comm, rows["x"])
    if "id" not in rows:
        rows["id"] = numbers
    raise_together(comm, _twice_numbered(comm, rows["id"]))
    if comm.allreduce(len(numbers), op=MPI.SUM) == 0:
        raise EmptyShapeError("no rank gave a point; give x, volume and density of some")
    to = destinations(grid, rows["x"])
    lost = comm.gather((rows["id"][to.rank < 0], rows["x"][to.rank < 0]), root=0)
    raise_together(comm, None if lost is None else _outside(*map(np.concatenate, zip(*lost))))
    rows["cell"] = to.cell
    rows = exchange(comm, rows, to.rank)
    rows["cell"] = rows["cell"] - grid.topology.index_map(gdim).local_range[0]
    others = {name[6:]: rows.pop(name) for name in list(rows) if name.startswith("field:")}
    return rows, others


def destinations_of(points: MaterialPoints) -> Destinations:
    """Cells and ranks of points, wherever they have come. Collective.

    Raises:
        PointsOutsideGridError: Points are outside the grid.
    """
    x = points.placement(points.configuration).x
    to = destinations(points.grid, x, points["cell"], points.partition)
    lost = to.rank < 0
    raise_together(points.comm, _outside(points["id"][lost], x[lost]))
    return to


def _outside(id, x) -> PointsOutsideGridError | None:
    if not len(id):
        return None
    first = int(np.argmin(id))
    return PointsOutsideGridError(
        f"{len(id)} points are outside the grid, the first of them point {id[first]} at {x[first]} "
        "m; enlarge the grid, or check the unit of the positions: it should be that of the grid"
    )


def _rows(gdim, x, volume, density, tag, half_length, fields, id, axisymmetric: bool) -> Rows:
    """The arrays that this rank gives, checked."""
    at = floats(x)
    if at is None:
        raise FieldShapeError(f"x should be numbers of shape (n, {gdim}), got {shown(x)}")
    at = np.empty((0, gdim)) if at.size == 0 else at
    if at.ndim == 1 and gdim == 1:
        at = at[:, None]
    if at.ndim != 2 or at.shape[1] != gdim:
        raise FieldShapeError(
            f"positions should have shape (n, {gdim}) on this grid of {gdim}D, got {at.shape}"
        )
    n = len(at)
    # zeros of both signs are one place
    rows: Rows = {"x": at + 0.0, "volume": checked("volume", volume, (n,))}
    if callable(density):
        density = call_function("density", density, at)
    rows["density"] = checked("density", density, (n,))
    rows["tag"] = checked_tag(tag, n)
    for name in ("x", "volume", "density"):
        good = np.isfinite(rows[name]) & ((rows[name] > 0) | (name == "x"))
        bad = np.flatnonzero(~good.all(axis=1) if good.ndim > 1 else ~good)
        if bad.size:
            rule = "finite" if name == "x" else "positive and finite"
            raise ParameterError(
                f"{name} = {rows[name][bad[0]]} of row {bad[0]}, at {at[bad[0]]} m, must be {rule} "
                f"({len(bad)} such points on this rank)"
            )
    if axisymmetric:
        checked_radii(at)
    if half_length is None:
        size = rows["volume"] / ring(at[:, 0], 1.0) if axisymmetric else rows["volume"]
        half_length = 0.5 * size[:, None] ** (1 / gdim)
        half_length = np.repeat(half_length, gdim, axis=1)
    rows["half_length"] = checked("half_length", half_length, (n, gdim))
    size = rows["volume"] / ring(at[:, 0], 1.0) if axisymmetric else rows["volume"]
    larger = np.prod(2.0 * rows["half_length"], axis=1) / size
    # negative ones are refused below
    if n and rows["half_length"].min() > 0.0 and larger.min() > _LARGER:
        raise ParameterError(
            f"half_length = {rows['half_length'][0]} m of row 0 makes a domain of {larger[0]:.3g} "
            f"times the point's volume, and all domains are more than {_LARGER:g} times as large: "
            "give half of the lengths of the domains"
        )
    if id is not None:
        numbers = array_of("id", id)
        if numbers.shape != (n,):
            raise FieldShapeError(f"id should have shape {(n,)}, got {numbers.shape}")
        if n and (not np.issubdtype(numbers.dtype, np.integer) or numbers.min() < 0):
            raise ParameterError("id should be whole numbers of at least 0")
        rows["id"] = numbers.astype(np.int64)
    rows |= {} if fields is None else _further(fields, at)
    _, first = np.unique(rows["x"], axis=0, return_index=True)
    if len(first) < n:
        again = np.setdiff1d(np.arange(n), first)
        raise ParameterError(
            f"{len(again)} points of this rank are in the place of another, such as row {again[0]} "
            f"at {at[again[0]]} m; give each point once"
        )
    return rows


def _further(fields, at: Array) -> Rows:
    """Further fields of points at positions (m), shape (n, gdim), checked."""
    n, rows = len(at), {}
    check_dictionary("fields", fields, ", such as {'velocity': v}")
    for name, values in fields.items():
        if name in _RESERVED:
            raise ParameterError(
                f"field '{name}' is one that all points have; give it by its argument, or set "
                f"points['{name}'] afterwards"
            )
        shape = array_of(f"fields['{name}']", values).shape
        if shape[:1] != (n,):
            raise FieldShapeError(f"field '{name}' should have {n} rows, got {shape}")
        rows[f"field:{name}"] = given = checked(f"field '{name}'", values, shape)
        finite = np.isfinite(given)
        good = np.asarray(finite.all(axis=tuple(range(1, finite.ndim))))
        if not good.all():
            k = int(np.argmin(good))
            raise ParameterError(
                f"field '{name}' is {given[k]} in row {k}, at {at[k]} m, and must be finite "
                f"({int((~good).sum())} such points on this rank)"
            )
    return rows


def _alike(comm, rows: Rows) -> Rows:
    """Rows with the same names and shapes on all ranks, also where there are none. Collective."""
    mine = {name: (a.dtype, a.shape[1:]) for name, a in rows.items()} if len(rows["x"]) else None
    kinds = [kind for kind in comm.allgather(mine) if kind is not None]
    if not kinds:
        return rows
    for kind in kinds:
        if kind != kinds[0]:
            names = [k.removeprefix("field:") for k in {**kinds[0], **kind}
                     if kind.get(k) != kinds[0].get(k)]  # fmt: skip
            raise FieldShapeError(
                f"ranks give different fields or shapes: {', '.join(names)}; give the same ones on "
                "every rank that gives points"
            )
    if mine is None:
        return {name: np.empty((0, *shape), dtype) for name, (dtype, shape) in kinds[0].items()}
    return {name: rows[name] for name in kinds[0]}


def _once(comm, rows: Rows) -> Rows:
    """Rows without those that another rank gives too. Collective.

    Every place has a rank that hears of all points there.
    """
    if comm.size == 1:
        return rows
    words = np.ascontiguousarray(rows["x"]).view(np.uint64)
    factors = np.array([0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9], np.uint64)
    mixed = (words * factors[: words.shape[1]]).sum(axis=1, dtype=np.uint64)
    rank = ((mixed >> np.uint64(33)) % np.uint64(comm.size)).astype(np.int32)
    rows = exchange(comm, rows, rank)
    order = np.lexsort(rows["x"].T[::-1])
    rows = {name: a[order] for name, a in rows.items()}
    same = np.zeros(len(order), bool)
    same[1:] = np.all(rows["x"][1:] == rows["x"][:-1], axis=1)
    error = None
    for name, a in rows.items():
        other = np.any(a[1:] != a[:-1], axis=tuple(range(1, a.ndim)))
        differ = np.flatnonzero(same[1:] & other)
        if differ.size:
            k = differ[0]
            error = ParameterError(
                f"two ranks give the point at {rows['x'][k]} m with different values of "
                f"{name.removeprefix('field:')}: {a[k]} and {a[k + 1]}"
            )
            break
    raise_together(comm, error)
    return {name: a[~same] for name, a in rows.items()}


def _twice_numbered(comm, id) -> ParameterError | None:
    pieces = comm.gather(id, root=0)
    if pieces is None:
        return None
    numbers, counts = np.unique(np.concatenate(pieces), return_counts=True)
    if np.all(counts == 1):
        return None
    return ParameterError(
        f"id = {numbers[np.argmax(counts > 1)]} is given to {counts.max()} points; give each a "
        "number of its own, or leave id out"
    )
