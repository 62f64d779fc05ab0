"""Points that split into 2^d children, and families of siblings that merge again."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from dolfinmpm._platform.argumentchecks import choice, number
from dolfinmpm._platform.collective import collective
from dolfinmpm._platform.errors import (
    ParameterError,
    PointsOutsideGridError,
    call_together,
    raise_together,
)
from dolfinmpm.body.bodysums import BodySums, sums_of
from dolfinmpm.body.childvalues import Children, child_values, children
from dolfinmpm.body.energychanges import counted
from dolfinmpm.body.exchange import exchange
from dolfinmpm.body.familyids import ancestors_of, deepest, levels_of, parents_of, places_of
from dolfinmpm.body.formarguments import check_points
from dolfinmpm.body.location import destinations
from dolfinmpm.body.siblingvalues import Siblings, adjacent, alike, parent_values
from dolfinmpm.grid.userfunctions import booleans

if TYPE_CHECKING:
    from dolfinmpm.body.points import MaterialPoints

__all__ = ["Families", "FamilyChange", "families", "merge", "split"]

Numbers = npt.NDArray[np.int64]
Chosen = npt.NDArray[np.bool_]
Fields = dict[str, npt.NDArray[Any]]


@dataclass(frozen=True)
class FamilyChange:
    """What a split or a merge did, on all ranks.

    Attributes:
        count: Number of points that split, or of families that merged.
        before, after: Sums over the body before and after.

    >>> import dolfinmpm as mpm
    >>> from mpi4py import MPI
    >>> grid = mpm.create_lattice(MPI.COMM_WORLD, [range(5), range(5)])
    >>> points = mpm.fill(grid, mpm.Box((0, 0), (4, 2)), per_cell=2, density=2000.0)
    >>> change = mpm.split(points, lambda x: x[0] < 1.0)
    >>> change.count, change.before.number, change.after.number
    (8, 32, 56)
    """

    count: int
    before: BodySums
    after: BodySums


@dataclass(frozen=True)
class Families:
    """The families of the points of this rank.

    Attributes:
        ancestor: Number of the first ancestor, shape (n,).
        parent: Number of the parent, shape (n,); −1 for points that no split has made.
        level: Number of splits that made the point, shape (n,).
        place: Place among the siblings, from 0, shape (n,); −1 without a parent.

    >>> import dolfinmpm as mpm
    >>> from mpi4py import MPI
    >>> grid = mpm.create_lattice(MPI.COMM_WORLD, [range(3), range(3)])
    >>> points = mpm.fill(grid, mpm.Box((0, 0), (1, 1)), per_cell=1, density=2000.0)
    >>> change = mpm.split(points, [True])
    >>> mpm.families(points).place.tolist()
    [0, 1, 2, 3]
    """

    ancestor: Numbers
    parent: Numbers
    level: Numbers
    place: Numbers


def families(points: MaterialPoints) -> Families:
    """The families of the points of this rank, as their numbers tell.

    Args:
        points: Material points.

    Raises:
        ParameterError: `points` are no material points.

    >>> import dolfinmpm as mpm
    >>> from mpi4py import MPI
    >>> grid = mpm.create_lattice(MPI.COMM_WORLD, [range(5), range(5)])
    >>> points = mpm.fill(grid, mpm.Box((0, 0), (4, 2)), per_cell=2, density=2000.0)
    >>> change = mpm.split(points, points["x"][:, 0] < 1.0)
    >>> int((mpm.families(points).level == 1).sum())
    32
    """
    check_points(points)
    ids, d = points["id"], points.gdim
    level = levels_of(ids, d)
    born = level > 0
    parent, place = parents_of(ids, d), places_of(ids, d)
    return Families(ancestors_of(ids), np.where(born, parent, -1), level, np.where(born, place, -1))


@collective(local=("which",))
def split(
    points: MaterialPoints,
    which: Callable[[npt.NDArray[np.float64]], npt.ArrayLike] | npt.ArrayLike,
    *,
    outside: str = "raise",
) -> FamilyChange:
    """Split points into 2^d children each, between steps. Collective.

    The children fill the domain of their parent, deformed by F: they lie at x + F (± l0/2), with
    half the half-lengths. Volume and mass are divided, in axisymmetric bodies as the first radii.
    All fields go along: deformation, strains, internal variables and tags as they are, faces of
    surfaces and forces of contact in parts. With a velocity gradient, the velocity of a child is
    that of its place. Momentum and angular momentum stay, to rounding. Problems with these points
    continue. Children may split again.

    Children get numbers by those of their parents, which do not depend on the ranks; see
    `families`.

    Args:
        points: Material points.
        which: Points to split: n booleans for the points of this rank; or a function of present
            positions (m), shape (gdim, n), that returns n booleans.
        outside: What to do with points whose children would lie outside the grid: "raise", or
            "keep" to leave them whole.

    Returns:
        Number of points that split, and sums over the body before and after.

    Raises:
        ParameterError: `which` gives no booleans; or a point has split too often, 12 times in 2D
            and 8 times in 3D.
        FieldShapeError: The number of booleans is not the number of points.
        PointsOutsideGridError: Children would lie outside the grid. No point splits then.

    Four points instead of one near the corner of a block:

    >>> import dolfinmpm as mpm
    >>> from mpi4py import MPI
    >>> grid = mpm.create_lattice(MPI.COMM_WORLD, [range(5), range(5)])
    >>> points = mpm.fill(grid, mpm.Box((0, 0), (4, 2)), per_cell=2, density=2000.0)
    >>> change = mpm.split(points, lambda x: (x[0] < 1.0) & (x[1] < 1.0))
    >>> change.count, points.total, change.after.volume
    (4, 44, 8.0)
    """
    check_points(points)
    comm = points.comm
    keep = choice("outside", outside, ("raise", "keep")) == "keep"
    chosen = call_together(comm, lambda: booleans("which", which, points["x"]))
    raise_together(comm, _too_deep(points, chosen))
    born = children(points, np.flatnonzero(chosen))
    lost = _lost(points, born.x0 if points.configuration == "total" else born.x)
    if not keep:
        raise_together(comm, _outside(points, born, lost))
    elif comm.allreduce(bool(lost.any())):
        chosen[born.of[lost]] = False
        born = children(points, np.flatnonzero(chosen))
    before = sums_of(points)
    count = comm.allreduce(int(chosen.sum()))
    if not count:
        return FamilyChange(0, before, before)
    new = child_values(points, born)
    # children stand where their parents stood: neighbours stay near each other in memory
    order = np.repeat(np.arange(len(points)), np.where(chosen, 2**points.gdim, 1))
    rows = {name: a[order] for name, a in points.fields.items()}
    for name, values in new.items():
        rows[name][chosen[order]] = values
    _replace(points, rows)
    return FamilyChange(count, before, sums_of(points))


@collective(local=("allowed",))
def merge(
    points: MaterialPoints,
    tolerance: float,
    *,
    allowed: Callable[[npt.NDArray[np.float64]], npt.ArrayLike] | npt.ArrayLike | None = None,
) -> FamilyChange:
    """Merge complete families of siblings that are alike and adjacent, between steps. Collective.

    Siblings are alike if their logarithmic strains (total and elastic) and internal variables
    differ by no more than a tolerance, and if their tags are the same. They are adjacent if each
    is within half of its half-length of the place where the mean deformation puts it. Families on
    several ranks merge too. Other families stay as they are.

    The parent gets its old number, the sums of volume, mass, momentum and forces, the centre of
    mass, and the union of the first domains. Logarithmic strains, Kirchhoff stress and internal
    variables are means by volume. Angular momentum stays if the points have affine velocities.
    Otherwise the sums in the result show its loss, as they show the loss of kinetic energy and
    the change of elastic energy.

    A call merges one level: children of children need two calls.

    Args:
        points: Material points.
        tolerance: Largest difference of logarithmic strains and of internal variables without a
            unit (-). Internal variables with a unit may differ by this share of their size.
        allowed: Points that may merge, as `which` of `split`; a family needs all its points. By
            default all points may.

    Returns:
        Number of families that merged, and sums over the body before and after.

    Raises:
        ParameterError: The tolerance is not positive, or `allowed` gives no booleans.
        FieldShapeError: The number of booleans is not the number of points.

    Points that have split, and have not moved since, merge to what they were:

    >>> import dolfinmpm as mpm
    >>> from mpi4py import MPI
    >>> grid = mpm.create_lattice(MPI.COMM_WORLD, [range(5), range(5)])
    >>> points = mpm.fill(grid, mpm.Box((0, 0), (4, 2)), per_cell=2, density=2000.0)
    >>> mpm.split(points, lambda x: x[0] < 2.0).after.number
    80
    >>> mpm.merge(points, 1e-3, allowed=lambda x: x[0] < 1.0).after.number
    56
    """
    check_points(points)
    comm, d = points.comm, points.gdim
    tolerance = number("tolerance", tolerance, 0.0)
    given = np.ones(len(points), bool) if allowed is None else allowed
    ready = call_together(comm, lambda: booleans("allowed", given, points["x"]))
    ready &= levels_of(points["id"], d) > 0
    rows, gathered = _complete(points, np.flatnonzero(ready))
    siblings = _in_order(points, gathered)
    siblings = siblings.taken(alike(siblings, tolerance))
    siblings = siblings.taken(adjacent(siblings))
    parents = parent_values(siblings)
    lost = _lost(points, parents["x0" if points.configuration == "total" else "x"])
    parents = {name: a[~lost] for name, a in parents.items()}
    count, before = comm.allreduce(len(parents["id"])), sums_of(points)
    if not count:
        return FamilyChange(0, before, before)
    merged = np.concatenate(comm.allgather(parents["id"]))
    of = parents_of(points["id"][rows], d)
    gone = np.isin(of, merged)
    rows, of = rows[gone], of[gone]
    stays = np.ones(len(points), bool)
    stays[rows] = False
    # parents stand where the first of their siblings on this rank stood
    at = {int(parent): int(row) for row, parent in zip(rows[::-1], of[::-1])}
    places = np.array([at[int(one)] for one in parents["id"]], np.int64)
    order = np.argsort(np.concatenate([np.flatnonzero(stays), places]), kind="stable")
    _replace(
        points,
        {name: np.concatenate([a[stays], parents[name].astype(a.dtype)])[order]
         for name, a in points.fields.items()},
    )  # fmt: skip
    return FamilyChange(count, before, sums_of(points))


def _complete(points: MaterialPoints, rows: npt.NDArray[np.intp]) -> tuple[Numbers, Fields]:
    """Rows of this rank that are in complete families, and the families that this rank merges.

    A family on several ranks goes to the lowest rank with most of its siblings. Collective.

    Args:
        points: Material points.
        rows: Points of this rank that may merge.
    """
    comm, number = points.comm, 2**points.gdim
    of = parents_of(points["id"][rows], points.gdim)
    parents, counts = np.unique(of, return_counts=True)
    whole = np.isin(of, parents[counts == number])
    split = counts < number
    pieces = comm.allgather((parents[split], counts[split]))
    there, have = (np.concatenate(part) for part in zip(*pieces))
    ranks = np.repeat(np.arange(comm.size), [len(piece[0]) for piece in pieces])
    found, first = np.unique(there, return_inverse=True)
    complete = found[np.bincount(first.ravel(), have, len(found)) == number]
    shared = np.isin(of, complete)
    # the last entry of a family is that of its home
    order = np.lexsort((-ranks, have, there))
    home = {int(parent): int(rank) for parent, rank in zip(there[order], ranks[order])}
    to = np.full(len(rows), comm.rank, np.int32)
    to[shared] = [home[int(parent)] for parent in of[shared]]
    mine = whole | shared
    gathered = {name: a[rows[mine]] for name, a in points.fields.items()}
    if len(complete):
        gathered = exchange(comm, gathered, to[mine])
    return rows[mine], gathered


def _in_order(points: MaterialPoints, gathered: Fields) -> Siblings:
    """Complete families in the order of their numbers, whichever ranks they come from."""
    d, ids = points.gdim, gathered["id"]
    order = np.lexsort((places_of(ids, d), parents_of(ids, d)))
    shape = (len(ids) // 2**d, 2**d)
    return Siblings(
        points, {name: a[order].reshape(shape + a.shape[1:]) for name, a in gathered.items()}
    )


def _too_deep(points: MaterialPoints, chosen: Chosen) -> ParameterError | None:
    """The error about points that have split too often, or None."""
    limit, level = deepest(points.gdim), levels_of(points["id"], points.gdim)
    bad = np.flatnonzero(chosen & (level >= limit))
    if not bad.size:
        return None
    p = bad[0]
    return ParameterError(
        f"which: the point at {points['x'][p]} m is of level {level[p]}, and its children would be "
        f"above the limit of {limit} splits in {points.gdim}D ({bad.size} such points here): leave "
        "it out, or fill the body with smaller points"
    )


def _lost(points: MaterialPoints, x: npt.NDArray[np.float64]) -> Chosen:
    """Which positions have no cell. Collective."""
    return destinations(points.grid, x, None, points.partition).rank < 0


def _outside(points: MaterialPoints, born: Children, lost: Chosen) -> PointsOutsideGridError | None:
    """The error about children outside the grid, or None."""
    if not lost.any():
        return None
    c = int(np.flatnonzero(lost)[0])
    p = born.of[c]
    return PointsOutsideGridError(
        f"{int(lost.sum())} children would lie outside the grid, one at {born.x[c]} m of point "
        f"{points['id'][p]} at {points['x'][p]} m, whose domain reaches out of the grid: enlarge "
        'the grid, or leave such points whole with outside="keep"'
    )


def _replace(points: MaterialPoints, rows: Fields) -> None:
    """Put other rows in place of all, and bring them to the ranks of their cells. Collective."""
    with counted(points, merging=True):
        points.fields.update(rows)
        points.recount()
        points.locate()
