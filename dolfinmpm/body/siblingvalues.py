"""Siblings that merge: whether they are alike and adjacent, and what their parent gets of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from dolfinmpm.body.childvalues import AMOUNTS, at_corners, face_motions, surfaces
from dolfinmpm.body.familyids import parents_of, side_signs

if TYPE_CHECKING:
    from dolfinmpm.body.points import MaterialPoints

__all__ = ["Siblings", "adjacent", "alike", "logarithms", "parent_values", "second_moments"]

Array = npt.NDArray[np.float64]
Fields = dict[str, npt.NDArray[Any]]

# Siblings lie where the mean deformation puts them, within this share of their half-lengths
_TOGETHER = 0.5
# First positions and sizes of siblings are those of a family within this share of half-lengths
_REGULAR = 1e-6
# xx, yy, zz, xy, yz, zx in a tensor
_SIX = np.array([[0, 3, 5], [3, 1, 4], [5, 4, 2]])
_ROWS, _COLUMNS = np.array([0, 1, 2, 0, 1, 2]), np.array([0, 1, 2, 1, 2, 0])


@dataclass(frozen=True)
class Siblings:
    """Complete families, each with its siblings in the order of `side_signs`.

    Attributes:
        points: The points that they are of.
        fields: All fields, shape (families, 2^d, ...).
    """

    points: MaterialPoints
    fields: Fields

    def __getitem__(self, name: str) -> npt.NDArray[Any]:
        return self.fields[name]

    def __len__(self) -> int:
        return len(self.fields["id"])

    def taken(self, which: npt.NDArray[np.bool_]) -> Siblings:
        """Some of the families."""
        return Siblings(self.points, {name: a[which] for name, a in self.fields.items()})

    @property
    def gdim(self) -> int:
        """Dimension of space."""
        return self.points.gdim

    @property
    def sections(self) -> Array:
        """First volumes, or areas of axisymmetric sections; the weights of first positions."""
        V0 = self["V0"]
        return V0 / self["x0"][:, :, 0] if self.points.axisymmetric else V0

    @property
    def masses(self) -> Array:
        """Masses (kg), shape (families, 2^d)."""
        return np.asarray(self["density"] * self["V0"], np.float64)

    @property
    def gradient(self) -> Array:
        """Mean deformation gradient with the mean volume change, shape (families, e, e)."""
        F, V0 = self["F"], self["V0"]
        mean = _mean(F, V0)
        if not len(self):
            return mean
        J = _mean(np.linalg.det(F), V0)
        found = mean * ((J / np.linalg.det(mean)) ** (1 / F.shape[-1]))[:, None, None]
        same = _same(F)
        found[same] = F[same, 0]
        return found

    @property
    def halves(self) -> Array:
        """First half-lengths of the parents' domains (m); of mere points those of a cube."""
        d, l0 = self.gdim, self["l0"]
        size = self["V0"]
        if self.points.axisymmetric:
            size = size / (2 * np.pi * self["x0"][:, :, 0])
        cube = size.sum(axis=1) ** (1 / d)
        return np.where(l0.min(axis=1) > 0, 2.0 * l0[:, 0], 0.5 * cube[:, None])


def _mean(values: Array, weights: Array) -> Array:
    """Weighted means over siblings; siblings with one value have just this mean."""
    share = weights / weights.sum(axis=1, keepdims=True)
    share = share.reshape(share.shape + (1,) * (values.ndim - 2))
    first = values[:, :1]
    return np.asarray(first[:, 0] + (share * (values - first)).sum(axis=1), np.float64)


def _same(values: npt.NDArray[Any]) -> npt.NDArray[np.bool_]:
    """Families whose siblings have the same values, shape (families,)."""
    equal = (values == values[:, :1]) | ((values != values) & (values[:, :1] != values[:, :1]))
    return np.asarray(equal.all(axis=tuple(range(1, values.ndim))), bool)


def _logarithm(tensors: Array) -> Array:
    """½ log of symmetric positive tensors, shape (..., e, e)."""
    values, Q = np.linalg.eigh(tensors)
    return np.asarray((Q * (0.5 * np.log(values))[..., None, :]) @ np.swapaxes(Q, -1, -2))


def logarithms(components: Array, name: str) -> Array:
    """Elastic strains, shape (..., 3, 3), from six components of "be" or "elastic_strain"."""
    tensors = components[..., _SIX]
    return _logarithm(tensors) if name == "be" else np.asarray(tensors, np.float64)


def _mean_be(be: Array, weights: Array) -> Array:
    """Six components of b_e with the mean of the logarithmic strains ½ log b_e."""
    strain = _mean(_logarithm(be[..., _SIX]), weights)
    values, Q = np.linalg.eigh(strain)
    mean = (Q * np.exp(2.0 * values)[..., None, :]) @ np.swapaxes(Q, -1, -2)
    found = mean[..., _ROWS, _COLUMNS]
    same = _same(be)
    found[same] = be[same, 0]
    return np.asarray(found, np.float64)


def second_moments(F: Array, half: Array) -> Array:
    """Second moments of domains per mass (m²), F diag(l0²/3) Fᵀ, shape (..., d, d)."""
    edges = F * (half / np.sqrt(3.0))[..., None, :]
    return np.asarray(edges @ np.swapaxes(edges, -1, -2), np.float64)


def adjacent(of: Siblings) -> npt.NDArray[np.bool_]:
    """Whether siblings lie side by side, at first and now, shape (families,)."""
    d = of.gdim
    half = of.halves[:, None]
    place = 0.5 * side_signs(d) * half
    x0, x = (of[name] - _mean(of[name], of.sections)[:, None] for name in ("x0", "x"))
    regular = np.abs(x0 - place) <= _REGULAR * half
    l0 = of["l0"]
    regular &= np.abs(l0 - l0[:, :1]) <= _REGULAR * half
    if not len(of):
        return np.zeros(0, bool)
    back = np.linalg.solve(of.gradient[:, None, :d, :d], x[..., None])[..., 0]
    near = np.abs(back - place) <= _TOGETHER * 0.5 * half
    return np.asarray((regular & near).all(axis=(1, 2)), bool)


def alike(of: Siblings, tolerance: float) -> npt.NDArray[np.bool_]:
    """Whether strains and internal variables of siblings differ little, shape (families,).

    Logarithmic strains, and internal variables without a unit, may differ by the tolerance.
    Internal variables with a unit, and parameters of laws, may differ by the tolerance times the
    largest magnitude in the family. Whole numbers, such as tags, must be the same.

    Args:
        of: Complete families.
        tolerance: Largest difference (-).
    """
    fields, symbols = of.fields, of.points.symbols.fields
    found = np.ones(len(of), bool)
    if not len(of):
        return found
    F = fields["F"]
    strains = [_logarithm(F @ np.swapaxes(F, -1, -2))]
    if "be" in fields:
        strains.append(_logarithm(fields["be"][..., _SIX]))
    if "elastic_strain" in fields:
        strains.append(fields["elastic_strain"])
    absolute = strains + [fields[name] for name in ("J_bar",) if name in fields]
    relative = [a for name, a in fields.items() if "_parameters" in name]
    for name in (name.removeprefix("has_") for name in fields if name.startswith("has_")):
        if name in symbols:
            kind = absolute if symbols[name].unit in ("", "-") else relative
            kind.append(fields[name])
    for name, values in fields.items():
        if values.dtype.kind != "f" and name not in ("id", "cell"):
            found &= _same(values)
    for values in absolute:
        found &= _range(values).max(axis=1) <= tolerance
    for values in relative:
        size = np.abs(values.reshape(len(of), values.shape[1], -1)).max(axis=1)
        known = ~np.isnan(size)
        close = np.where(known, _range(values) <= tolerance * size, False)
        found &= close.all(axis=1) | _same(values)
    return found


def _range(values: Array) -> Array:
    """Differences between the largest and the least values of siblings, shape (families, k)."""
    flat = values.reshape(len(values), values.shape[1], -1)
    return np.asarray(flat.max(axis=1) - flat.min(axis=1), np.float64)


def parent_values(of: Siblings) -> Fields:
    """All fields of the parents, by name, shape (families, ...).

    Amounts are sums. Positions are centres of mass, velocities keep the momentum. Logarithmic
    elastic strains and internal variables are means by the first volume; Kirchhoff stresses too:
    Cauchy stresses are means by the present volume.

    Args:
        of: Complete families.
    """
    symbols, V0, m = of.points.symbols.fields, of["V0"], of.masses
    new: Fields = {}
    for name, a in of.fields.items():
        unit = symbols[name].unit if name in symbols else ""
        if a.dtype.kind != "f":
            new[name] = a[:, 0]
        elif at_corners(of.points, name):
            new[name] = a.sum(axis=1) * (unit != "N/m")
        elif unit in AMOUNTS or name in ("V", "V0"):
            new[name] = a.sum(axis=1)
        elif name == "be":
            new[name] = _mean_be(a, V0)
        elif unit.startswith("m/s"):
            new[name] = _mean(a, m)
        else:
            new[name] = _mean(a, of["V"] if name == "stress" else V0)
    new["id"] = parents_of(of["id"][:, 0], of.gdim)
    new["F"] = of.gradient
    new["x0"] = _mean(of["x0"], of.sections)
    new["x"] = _mean(of["x"], of.sections * of["density"])
    new["l0"] = 2.0 * of["l0"][:, 0]
    new["l"] = 2.0 * _mean(of["l"], V0)
    _affine(of, new)
    for surface in surfaces(of.fields):
        _face(of, surface, new)
    return new


def _affine(of: Siblings, new: Fields) -> None:
    """Affine parts of the velocity that keep the angular momentum."""
    if "velocity" not in new:
        return
    m, d = of.masses, of.gdim
    centre = _mean(of["x"], m)
    r, dv = of["x"] - centre[:, None], of["velocity"] - new["velocity"][:, None]
    share = m / m.sum(axis=1, keepdims=True)
    K = np.einsum("fc,fci,fcj->fij", share, dv, r)
    if "velocity_moment" in new:
        new["velocity_moment"] = _mean(of["velocity_moment"], m) + K
    if "velocity_gradient" not in new or not len(of):
        return
    L = of["velocity_gradient"]
    half = 0.5 * of.halves
    own = second_moments(of["F"][..., :d, :d], half[:, None])
    K = K + np.einsum("fc,fcij,fcjk->fik", share, L, own)
    whole = second_moments(new["F"][:, :d, :d], 2.0 * half)
    if of.points.axisymmetric:
        whole = np.einsum("fc,fcij->fij", share, own) + np.einsum("fc,fci,fcj->fij", share, r, r)
    new["velocity_gradient"] = np.swapaxes(
        np.linalg.solve(np.swapaxes(whole, 1, 2), np.swapaxes(K, 1, 2)), 1, 2
    )


def _face(of: Siblings, surface: str, new: Fields) -> None:
    """Join the faces of siblings; force and moment stay."""
    offset = f"{surface}_offset"
    size = np.linalg.norm(of[f"{surface}_area"], axis=-1)
    at = of["x0"] + of[offset]
    if of.points.axisymmetric:
        size = size / np.where(size > 0, at[..., 0], 1.0)
    have = size.sum(axis=1) > 0
    weight = np.where(have[:, None], size, 1.0)
    new[offset] = np.where(have[:, None], _mean(at, weight) - new["x0"], 0.0)
    for motion in face_motions(of.fields, surface):
        new[motion] = _mean(of[motion], weight)
