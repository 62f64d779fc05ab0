"""What children get of a point that splits: places, volumes, and every field that it carries."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from dolfinmpm.body.axisymmetry import in_section, section
from dolfinmpm.body.familyids import children_of, side_signs

if TYPE_CHECKING:
    from dolfinmpm.body.points import MaterialPoints

__all__ = [
    "AMOUNTS", "Children", "at_corners", "child_values", "children", "face_motions",
    "first_halves", "surfaces",
]  # fmt: skip

Array = npt.NDArray[np.float64]
Rows = npt.NDArray[np.intp]

# Units of amounts: those of children add up to that of their parent
AMOUNTS = frozenset(("N", "N/m", "J", "kg", "m^d", "m^(d-1)"))


@dataclass(frozen=True)
class Children:
    """Children of some points, in the order of the points and of `side_signs`.

    Attributes:
        of: Rows of their parents, shape (c,).
        place: Places among their siblings, shape (c,).
        reach: First offsets from the parents' centres (m), shape (c, d).
        x, x0: Present and first positions (m), shape (c, d).
        share: Shares of the parents' volumes and masses (-), shape (c,).
    """

    of: Rows
    place: npt.NDArray[np.int64]
    reach: Array
    x: Array
    x0: Array
    share: Array


def first_halves(points: MaterialPoints) -> Array:
    """First half-lengths of the domains (m), shape (n, d); of mere points those of a cube."""
    l0 = points.fields.read("l0")
    cube = 0.5 * section(points, "V0", "x0") ** (1 / points.gdim)
    return np.where(l0 > 0, l0, cube[:, None])


def surfaces(names: Mapping[str, Any]) -> list[str]:
    """Names of the surfaces among the names of fields."""
    ends = (name.removesuffix("_area") for name in names if name.endswith("_area"))
    return [name for name in ends if f"{name}_offset" in names]


def face_motions(names: Mapping[str, Any], surface: str) -> list[str]:
    """Names of the fields with the motions of a surface's faces under footings."""
    return [name for name in names if re.fullmatch(rf"{re.escape(surface)}_motion\d*", name)]


def at_corners(points: MaterialPoints, name: str) -> bool:
    """Whether a field has one value per corner of a point's domain, such as forces of contact."""
    field = points.symbols.fields.get(name)
    if field is None or field.ufl_shape[:1] != (2**points.gdim,):
        return False
    return field.unit in ("N", "N/m", "m", "m^(d-1)")


def children(points: MaterialPoints, rows: Rows) -> Children:
    """Places and shares of the children of some points.

    A domain is the parallelogram of its first half-lengths, deformed by F. The centres of its 2^d
    equal parts are x + F (± l0/2). For axisymmetric points, shares are as the first radii.

    Args:
        points: Material points.
        rows: Points of this rank that split.
    """
    d = points.gdim
    number = 2**d
    of = np.repeat(rows, number)
    place = np.tile(np.arange(number), len(rows))
    reach = 0.5 * side_signs(d)[place] * first_halves(points)[of]
    x0 = points["x0"][of] + reach
    x = points["x"][of] + np.einsum("pij,pj->pi", in_section(points, points["F"])[of], reach)
    share = np.full(len(of), 1.0 / number)
    if points.axisymmetric:
        share *= x0[:, 0] / points["x0"][of][:, 0]
    return Children(of, place, reach, x, x0, share)


def child_values(points: MaterialPoints, born: Children) -> dict[str, npt.NDArray[Any]]:
    """All fields of children, by name, shape (c, ...).

    Amounts are divided by the shares; other fields are those of the parents.

    Args:
        points: Material points.
        born: The children.
    """
    of, symbols = born.of, points.symbols.fields
    new = {name: a[of] for name, a in points.fields.items()}
    new["id"] = children_of(new["id"], born.place, points.gdim)
    new["x"], new["x0"] = born.x, born.x0
    new["l"], new["l0"] = 0.5 * new["l"], 0.5 * new["l0"]
    of_surfaces = surfaces(points.fields)
    for name, field in symbols.items():
        if at_corners(points, name):
            new[name] = _of_corners(new[name], born.place, field.unit)
        elif field.unit in AMOUNTS and name not in {f"{s}_area" for s in of_surfaces}:
            new[name] = (new[name].T * born.share).T
    for surface in of_surfaces:
        _face(points, surface, born, new)
    if "velocity_gradient" in new and "velocity" in new:
        # about the centre of mass, which is not the parent's place in axisymmetric bodies
        r = born.x - np.repeat(_means(points, born), 2**points.gdim, axis=0)
        new["velocity"] = new["velocity"] + np.einsum("pij,pj->pi", new["velocity_gradient"], r)
    return new


def _means(points: MaterialPoints, born: Children) -> Array:
    """Centres of mass of the families (m), shape (families, d)."""
    shape = (-1, 2**points.gdim, points.gdim)
    return np.asarray((born.share[:, None] * born.x).reshape(shape).sum(axis=1), np.float64)


def _of_corners(values: Array, place: npt.NDArray[np.int64], unit: str) -> Array:
    """Values at the corners of children: a corner of the parent is a corner of one child.

    Stiffnesses of touching corners are made anew, because the parent's are of longer sides. Corners
    of the parent that touch beside each other share a face. So children beside each other have
    equal parts of this face, and of its forces. With a force that stays on one corner, the
    friction there would be bounded by a part of the normal force.
    """
    corner = np.arange(values.shape[1])
    share = (corner == place[:, None]).astype(float)
    if unit == "N/m":
        share[:] = 0.0
    if unit == "N":
        touches = np.asarray(np.any(values != 0.0, axis=tuple(range(2, values.ndim))), bool)
        share = np.ones(touches.shape)
        for axis in 1 << np.arange(corner.size.bit_length() - 1):
            other = ((corner ^ place[:, None]) & axis) != 0
            share *= np.where(touches[:, corner ^ axis], 0.5, ~other)
    return np.asarray(values * share.reshape(share.shape + (1,) * (values.ndim - 2)))


def _face(points: MaterialPoints, surface: str, born: Children, new: dict[str, Any]) -> None:
    """Divide a face of the parents among the children at it; its plane, force and moment stay."""
    offset, area = f"{surface}_offset", f"{surface}_area"
    d, R, A = points.gdim, new[offset], new[area]
    rows, axis = np.arange(len(R)), np.argmax(np.abs(A), axis=1)
    towards, across = R[rows, axis], A[rows, axis]
    along = np.zeros_like(R)
    # an oblique face goes on in its plane
    rise = np.sum(A * born.reach, axis=1)
    along[rows, axis] = np.divide(rise, across, out=np.zeros_like(rise), where=across != 0.0)
    # a face at the centre is shared by all children
    there = (towards == 0.0) | (towards * side_signs(d)[born.place][rows, axis] > 0.0)
    along[towards == 0.0] = 0.0
    moved = np.where(there[:, None] & np.any(A, axis=1)[:, None], R - along, 0.0)
    weight = there.astype(float)
    if points.axisymmetric:
        weight *= (born.x0 + moved)[:, 0]
    families = weight.reshape(-1, 2**d)
    new[offset] = moved
    new[area] = A * (families / families.sum(axis=1, keepdims=True)).reshape(-1, 1)
