"""Bodies that are joined, and points that come and go between steps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm._platform.argumentchecks import as_tags
from dolfinmpm._platform.errors import (
    FieldShapeError,
    IdleConditionWarning,
    ParameterError,
    call_together,
    raise_together,
    warn,
)
from dolfinmpm._platform.uncopied import FOUND, unchanged
from dolfinmpm.body.childvalues import surfaces
from dolfinmpm.body.energychanges import counted
from dolfinmpm.body.loadbalance import redistributed
from dolfinmpm.body.overlapchecks import check_room_of_both
from dolfinmpm.body.tags import check_in_use
from dolfinmpm.grid.userfunctions import booleans

if TYPE_CHECKING:
    from dolfinmpm.body.points import MaterialPoints

__all__ = ["PointChange", "add", "joined", "remove"]

Array = npt.NDArray[Any]

# Points closer than this share of their domains' half-lengths are in the same place.
_SAME = 1e-6


@unchanged(FOUND)
@dataclass(frozen=True)
class PointChange:
    """What came to a body or went.

    Attributes:
        count: Number of points, on all ranks.
        mass: Their mass (kg), on all ranks.

    What an excavation took away:

    >>> import dolfinmpm as mpm
    >>> from mpi4py import MPI
    >>> grid = mpm.create_lattice(MPI.COMM_WORLD, [range(5), range(5)])
    >>> points = mpm.fill(grid, mpm.Box((0, 0), (4, 2)), per_cell=2, density=2000.0)
    >>> points.remove(points["x"][:, 1] > 1.0)
    PointChange(count=16, mass=8000.0)
    """

    count: int
    mass: float


def _change(points: MaterialPoints, rows: Any) -> PointChange:
    mass = points["density"][rows] * points["V0"][rows]
    count, total = points.comm.allreduce(np.array([len(mass), mass.sum()]), op=MPI.SUM)
    return PointChange(int(count), float(total))


def joined(a: MaterialPoints, b: MaterialPoints) -> MaterialPoints:
    """A body of the points of both; see `MaterialPoints.__add__`. Collective."""
    if isinstance(b, type(a)):
        a, b = redistributed(a, None), redistributed(b, None)
    rows = _rows_of_both(a, b)
    values = (rows[name] for name in ("x", "cell", "V", "l", "density"))
    points = type(a)(a.grid, *values, tag=rows["tag"], id=rows["id"], axisymmetric=a.axisymmetric)
    for body in (a, b):
        for name, field in body.symbols.fields.items():
            if name not in points.symbols.fields:
                # values come below; a function would be asked again for those
                points.add_field(name, field.ufl_shape, field.unit).first = field.first
    points.fields.update(rows)
    points.recount()
    points.overlapping = a.overlapping or b.overlapping
    shapes = [(body.shape_volume, body.volume_error or 0.0) for body in (a, b)]
    known = [(volume, error) for volume, error in shapes if volume is not None]
    if len(known) == len(shapes):
        points.shape_volume = sum(volume for volume, _ in known)
        extra = sum(volume * error for volume, error in known)
        points.volume_error = extra / points.shape_volume
    return points


def add(points: MaterialPoints, other: MaterialPoints) -> PointChange:
    """Take the points of another body in; see `MaterialPoints.add`. Collective."""
    if isinstance(other, type(points)):
        other = redistributed(other, points.partition)
    rows = _rows_of_both(points, other)
    change = _change(other, slice(None))
    points.overlapping = points.overlapping or other.overlapping
    for name, field in other.symbols.fields.items():
        if name not in points.symbols.fields:
            points.add_field(name, field.ufl_shape, field.unit, field.first)
    with counted(points):
        points.fields.update(rows)
        _changed(points)
    return change


def remove(points: MaterialPoints, where: Any, tag: Any) -> PointChange:
    """Take points away; see `MaterialPoints.remove`. Collective."""
    going = call_together(points.comm, lambda: _chosen(points, where, tag))
    if tag is not None:
        check_in_use(points, as_tags(tag))
    change = _change(points, going)
    if change.count == points.total:
        raise ParameterError(
            f"all {points.total} points would be removed, and no body would be left; remove fewer"
        )
    if change.count:
        before = _faces(points)
        gone = np.stack([points["x"][going], points["x0"][going]], axis=1)
        for boundary in points.followers:
            boundary.removed.append(gone)
        with counted(points):
            points.fields.update({name: a[~going] for name, a in points.fields.items()})
            _changed(points)
        _warn_of_lost_faces(points, before)
    return change


def _faces(points: MaterialPoints) -> dict[str, float]:
    """Areas of the surfaces of the points by name (m^(d-1)). Collective."""
    names = sorted(surfaces(points.fields))
    here = [float(np.abs(points.fields.read(f"{name}_area")).sum()) for name in names]
    if not names:
        return {}
    return dict(zip(names, points.comm.allreduce(np.array(here), op=MPI.SUM)))


def _warn_of_lost_faces(points: MaterialPoints, before: dict[str, float]) -> None:
    """Warn of surfaces that had faces before, and have none now. Collective."""
    now = _faces(points)
    lost = [name for name, area in before.items() if area and not now[name]]
    if lost:
        warn(
            points.comm,
            f"all faces of the surface{'s' * (len(lost) > 1)} {', '.join(map(repr, lost))} went "
            "with the points that were removed: loads and conditions there act on nothing; make "
            "the surface on the points that are left, and a new problem",
            IdleConditionWarning,
        )


def _changed(points: MaterialPoints) -> None:
    points.shape_volume = points.volume_error = None
    points.recount()


def _chosen(points: MaterialPoints, where: Any, tag: Any) -> npt.NDArray[np.bool_]:
    if (where is None) == (tag is None):
        raise ParameterError("remove takes either `where` or `tag`, and one of them")
    if tag is not None:
        return np.isin(points["tag"], as_tags(tag) or ())
    return booleans("where", where, points["x"])


def _rows_of_both(a: MaterialPoints, b: MaterialPoints) -> dict[str, Array]:
    """Arrays of the points of a and, behind them, of b. Collective."""
    if not isinstance(b, type(a)):
        raise ParameterError(f"points are joined with points only, got a {type(b).__name__}")
    if a.grid is not b.grid:
        raise ParameterError("the bodies are on two grids; fill both on the same grid object")
    if a.axisymmetric != b.axisymmetric:
        raise ParameterError(
            f"axisymmetric = {a.axisymmetric} of one body and {b.axisymmetric} of the other: "
            "axisymmetric points and points of plane strain cannot be joined; fill both alike"
        )
    known = a.symbols.fields
    for name, field in b.symbols.fields.items():
        if name in known and known[name].ufl_shape != field.ufl_shape:
            raise FieldShapeError(
                f"field '{name}' has shape {known[name].ufl_shape} at the points of one body, "
                f"{field.ufl_shape} at those of the other; give one another name"
            )
    raise_together(a.comm, _overlap(a, b))
    check_room_of_both(a, b)

    def values(body: MaterialPoints, name: str) -> Array:
        if name in body.fields:
            return body[name]
        other = b if body is a else a
        if name not in other.symbols.fields:
            # a mark of laws, of what they have not done yet at these points
            return np.zeros((len(body), *other[name].shape[1:]), other[name].dtype)
        return other.symbols.fields[name].first_values(body["x0"])

    def concatenated() -> dict[str, Array]:
        names = dict.fromkeys([*a.fields, *b.fields])
        rows = {name: np.concatenate([values(a, name), values(b, name)]) for name in names}
        rows["id"][len(a) :] += a._next_id
        return rows

    return call_together(a.comm, concatenated)


def _overlap(a: MaterialPoints, b: MaterialPoints) -> ParameterError | None:
    if not len(a) or not len(b):
        return None
    # a point without a domain has no size but that of its volume
    size = 0.5 * min(c.placement().volume.min() for c in (a, b)) ** (1 / a.gdim)
    from scipy.spatial import cKDTree

    distance, _ = cKDTree(a["x"]).query(b["x"], distance_upper_bound=_SAME * size)
    same = np.flatnonzero(np.isfinite(distance))
    if same.size == 0:
        return None
    return ParameterError(
        f"the bodies overlap: {same.size} points of both are in the same place on this rank, the "
        f"first at {b['x'][same[0]]} m; take one shape out of the other, as in "
        "fill(grid, ground - lens, ...)"
    )
