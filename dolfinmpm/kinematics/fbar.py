"""F-bar: the points in a cell share one volume change, so that incompressible bodies do not lock.

De Souza Neto, Perić, Dutko & Owen (1996, doi 10.1016/0020-7683(95)00259-6) replace the volume
change at every integration point by one value per element. Coombs, Charlton, Cortis & Augarde
(2018, doi 10.1016/j.cma.2018.01.010) take the volume-weighted mean over the material points in a
cell; for GIMP, over the shares of the points' domains in the cell. For splines, the mean is taken
over splines of one degree less, see `dolfinmpm.cut.cellaverages`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba
import numpy as np
import numpy.typing as npt
from dolfinx.mesh import CellType

from dolfinmpm._platform.errors import ParameterError, SoftVolumeWarning, raise_together, warn
from dolfinmpm.basis.cells import invert
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.forms.operators import KeepingLaw, KeptTangents, if_kept
from dolfinmpm.grid.tensors import determinants
from dolfinmpm.kinematics.strainformulation import StrainFormulation

__all__ = ["OWN_SHARE", "VOLUMES", "FBar", "share_volumes"]

Array = npt.NDArray[np.float64]

# Kind of F-bar whose points keep the mean volume change, and its share of a point's own change
VOLUMES, OWN_SHARE = "volumes", 0.03


def share_volumes(F: Array, J: Array, J_bar: Array, rows) -> None:
    """Scale deformation gradients to the determinants J̄, in place.

    Args:
        F: Deformation gradients, shape (points, d, d).
        J: Their determinants, shape (points,); become J̄.
        J_bar: J̄, shape (points,).
        rows: The points to scale.
    """
    ratio = J_bar[rows] / J[rows]
    F[rows] *= (ratio ** (1.0 / F.shape[1]))[:, None, None]
    J[rows] = J_bar[rows]


@numba.njit(cache=True, error_model="numpy")
def _slope(H, d, multiplicative, out):
    """Derivative of the volume change by H: ΔJ ΔF⁻ᵀ if multiplicative, else I."""
    dF, inverse = np.empty((d, d)), np.empty((d, d))
    for p in range(H.shape[0]):
        det = 1.0
        if multiplicative:
            for i in range(d):
                for j in range(d):
                    dF[i, j] = H[p, i * d + j] + (1.0 if i == j else 0.0)
            det = invert(dF, inverse)
        for i in range(d):
            for j in range(d):
                if multiplicative:
                    out[p, i * d + j] = det * inverse[j, i]
                else:
                    out[p, i * d + j] = 1.0 if i == j else 0.0


@numba.njit(cache=True, error_model="numpy")
def _replace_volume(H, measure, mean, d, multiplicative, out):
    """Write H̄, which is H with the mean volume change.

    Returns the first point where the mean or its own volume change is not positive, or -1.
    """
    for p in range(H.shape[0]):
        if multiplicative:
            if not (measure[p] > 0.0 and mean[p] > 0.0):
                return p
            r = (mean[p] / measure[p]) ** (1.0 / d)
            for i in range(d):
                for j in range(d):
                    out[p, i * d + j] = r * H[p, i * d + j] + (r - 1.0 if i == j else 0.0)
        else:
            change = (mean[p] - measure[p]) / d
            for i in range(d):
                for j in range(d):
                    out[p, i * d + j] = H[p, i * d + j] + (change if i == j else 0.0)
    return -1


@numba.njit(cache=True, error_model="numpy")
def _true_gradient(H, measure, mean, history, d, multiplicative, S, A, by_mean):
    """Turn S̄(H̄) and its derivative into S and its derivatives by H and by the mean.

    Args:
        H, measure, mean: Gradients, volume changes and mean volume changes of the points.
        history: J/J̄ at the start of the step.
        d, multiplicative: Dimension of space, and kind of the strain formulation.
        S: S̄ before, S after.
        A: Derivative of S̄ by H̄ before, derivative of S by H at constant mean after.
        by_mean: Written: derivative of S by the mean; empty without derivatives.
    """
    n = d * d
    dF, inverse = np.empty((d, d)), np.empty((d, d))
    B = np.empty(n)
    for p in range(H.shape[0]):
        r, factor = 1.0, 1.0
        if multiplicative:
            r = (mean[p] / measure[p]) ** (1.0 / d)
            factor = history[p] * r ** (1 - d)
        if by_mean.size:
            for i in range(d):
                for j in range(d):
                    dF[i, j] = 1.0 if i == j else 0.0
                    if multiplicative:
                        dF[i, j] += H[p, i * d + j]
            invert(dF, inverse)
            for a in range(n):
                B[a] = 0.0
                for i in range(d):
                    for j in range(d):
                        B[a] += r * A[p, a, i * d + j] * dF[i, j]
                if multiplicative:
                    B[a] += (1 - d) * S[p, a]
                by_mean[p, a] = factor * B[a] / d
                if multiplicative:
                    by_mean[p, a] /= mean[p]
                for i in range(d):
                    for j in range(d):
                        A[p, a, i * d + j] = factor * (
                            r * A[p, a, i * d + j] - B[a] / d * inverse[j, i]
                        )
        for a in range(n):
            S[p, a] *= factor


class FBar:
    """F-bar around a strain formulation, as an operator of the increment's gradient H.

    Let ΔF = I + H and ΔJ = det ΔF. ΔJ̄ is the mean of ΔJ over the cells of the point, or over
    splines of one degree less (see `CellAverages`), with the volumes at the start of the step as
    weights. The strain formulation gets ΔF̄ = r ΔF, r = (ΔJ̄/ΔJ)^(1/d), with the dimension d (2 in
    plane strain, else 3), and returns the flux S̄ = τ ΔF̄⁻ᵀ. F-bar returns S = (J/J̄) r S̄. The
    Cauchy stress is σ = τ/J̄, with the product J̄ of the means of all steps, the field `J_bar`.
    If strain is additive, the strain formulation gets H + (mean(tr H) − tr H)/d I, and the flux is
    unchanged.

    With fbar="volumes", points keep the mean: after a step F is scaled to det F = J̄, and V = J̄ V₀.
    The mean alone controls no single point, so that J drifts in long flow. Hourglass modes need a
    share α of the point's own change (see Moutsanidis and others 2020, Comput. Part. Mech. 7:309).
    It locks where α K is large beside the shear modulus, with ν > 0.49.

    A law with a dilation angle is refused: the power of the stress on the true strain could be
    negative, also for associated flow (de Borst & Groen 1995, Int. J. Numer. Methods Eng.
    38:2887). Laws that dilate without a parameter of this name are not recognised. Cubic splines
    with a law that has a normal compression line give a warning: the mean hides changes of volume
    that alternate from cell to cell.

    Args:
        formulation: The strain formulation with its law, which gives the stress.
        points: Material points.
        degree: Degree of the basis of the increment.
        by_centres: Whether a point counts only in the cell of its centre, and gets the mean of
            this cell, even if its domain overlaps other cells. Fewer points then share a mean, and
            the means jump when points cross into the next cell.
        own_share: Share of a point's own volume change, α: ΔJ̄ is replaced by ΔJ̄^(1−α) ΔJ^α.
    """

    def __init__(
        self,
        formulation: StrainFormulation,
        points: MaterialPoints,
        degree: int = 1,
        by_centres: bool = False,
        own_share: float = 0.0,
    ):
        self.by_centres = by_centres
        self.formulation = formulation
        self.points = points
        self._degree = degree
        self._bound = False
        self._multiplicative = formulation.multiplicative
        self.own_share = own_share
        self._slopes: tuple[Array, Array] = (np.empty(0), np.empty(0))
        self._measure: Array = np.empty(0)
        self._mean: Array = np.empty(0)

    def bind(self) -> None:
        """Add the field `J_bar`. Collective.

        For a body that has moved without F-bar, it begins as det F.

        Raises:
            ParameterError: The law has a dilation angle that is not 0, or the cells are triangles
                or tetrahedra.

        Warns:
            SoftVolumeWarning: Cubic splines meet a law of plastic compaction.
        """
        _refuse_simplices(self.points)
        _refuse_dilation(self.formulation, self.points.comm)
        if not self._bound:
            _warn_of_compaction(self.formulation, self.points, self._degree)
        self._bound = True
        if self._multiplicative and "J_bar" not in self.points.fields:
            self.points.add_field("J_bar", (), "", 1.0)
            self.points["J_bar"] = np.linalg.det(self.points["F"])

    @property
    def law(self) -> Any:
        """The constitutive law."""
        return self.formulation.law

    @property
    def keeps(self) -> int:
        """How many numbers the strain formulation keeps per point; see `KeepingLaw`."""
        return self.formulation.keeps if isinstance(self.formulation, KeepingLaw) else 0

    def describe(self, operand: Array, row: int) -> str:
        """Text for a point without a stress; see `StrainFormulation.describe`."""
        d, flat = self.points.strain_dim, np.ascontiguousarray(operand, float).reshape(1, -1)
        changed, bad = self._replaced(flat, slice(row, row + 1))
        return self.formulation.describe((flat if bad >= 0 else changed).reshape(d, d), row)

    def _measured(self, operand: Array) -> Array:
        """Volume change of increments: ΔJ = det(I + H) if multiplicative, else tr H."""
        d = self.points.strain_dim
        H = operand.reshape(len(operand), d, d)
        if self._multiplicative:
            return determinants(H + np.eye(d))
        return np.asarray(np.trace(H, axis1=1, axis2=2), np.float64)

    def _replaced(self, operand: Array, rows) -> tuple[Array, int]:
        """H̄ of some points, and the first of them that has none, or -1."""
        changed = np.empty_like(operand)
        bad = _replace_volume(
            operand, self._measure[rows], self._mean[rows], self.points.strain_dim,
            self._multiplicative, changed,
        )  # fmt: skip
        return changed, bad

    def prepare(self, operand: Array, mean: Callable[[Array], Array]) -> None:
        """Compute the means of ΔJ, or of tr H, for new increments. Collective.

        See `AveragingLaw.prepare`.
        """
        self._measure = self._measured(operand)
        self._mean = mean(self._measure)
        if self.own_share:
            self._mix()

    def _mix(self) -> None:
        """Let the points' own changes count with their share in the means; keep the slopes."""
        share, mean, measure = self.own_share, self._mean, self._measure
        by_mean, by_measure = np.full_like(mean, 1.0 - share), np.full_like(mean, share)
        if self._multiplicative:
            with np.errstate(invalid="ignore", divide="ignore"):
                self._mean = mean ** (1.0 - share) * measure**share
                by_mean *= self._mean / mean
                by_measure *= self._mean / measure
        else:
            self._mean = (1.0 - share) * mean + share * measure
        self._slopes = by_mean, by_measure

    def measure_slope(self, operand: Array) -> Array:
        """Derivative of ΔJ, or of tr H, by H; see `AveragingLaw.measure_slope`."""
        out = np.empty_like(operand)
        _slope(operand, self.points.strain_dim, self._multiplicative, out)
        return out

    def _history(self, rows) -> Array:
        """J/J̄ at the start of the step."""
        points, d = self.points, self.points.strain_dim
        F = points["F"][rows].reshape(-1, d * d)
        return self._measured(F - np.eye(d).ravel()) / points["J_bar"][rows]

    def evaluate(
        self, operand: Array, value: Array, tangent: Array | None, rows,
        by_mean: Array | None = None, kept: KeptTangents | None = None,
    ) -> int:  # fmt: skip
        """Flux S and its derivatives by ∇ũ and by the mean; see `AveragingLaw`, `KeepingLaw`."""
        d, kind = self.points.strain_dim, self._multiplicative
        measure, mean = self._measure[rows], self._mean[rows]
        changed, bad = self._replaced(operand, rows)
        if bad < 0:
            bad = self.formulation.evaluate(changed, value, tangent, rows, **if_kept(kept))
        if bad >= 0:
            return bad
        history = self._history(rows) if kind else np.empty(0)
        if tangent is None:
            tangent, by_mean = np.empty((0, 1, 1)), None
        elif by_mean is None:
            by_mean = np.empty_like(value)
        slope = np.empty((0, 1)) if by_mean is None else by_mean
        _true_gradient(operand, measure, mean, history, d, kind, value, tangent, slope)
        if self.own_share and by_mean is not None:
            of_mean, of_measure = (slope[rows, None] for slope in self._slopes)
            by_own = of_measure * self.measure_slope(operand)
            tangent += by_mean[:, :, None] * by_own[:, None]
            by_mean *= of_mean
        return -1

    def commit(self, operand: Array, rows, kept: KeptTangents | None = None) -> dict[str, Array]:
        """Fields of the strain formulation at the end of the step, with σ = τ/J̄; and J̄."""
        points = self.points
        changed, _ = self._replaced(operand, rows)
        new = self.formulation.commit(changed, rows, **if_kept(kept))
        if self._multiplicative:
            # the strain formulation divided τ by det ΔF̄ times the true det F before the step
            new["stress"] *= self._history(rows)[:, None, None]
            new["J_bar"] = points["J_bar"][rows] * self._mean[rows]
        return new


def _refuse_simplices(points: MaterialPoints) -> None:
    """Raise ParameterError where the volume change is constant in each cell already."""
    kind = points.grid.topology.cell_type
    if kind in (CellType.triangle, CellType.tetrahedron) and not points.axisymmetric:
        raise ParameterError(
            f"fbar = True would do nothing on a grid of cells of the kind {kind.name}: linear "
            "functions have one volume change in each of them, and lock for all that. Take "
            "quadrilaterals or hexahedra"
        )


def _refuse_dilation(formulation: Any, comm) -> None:
    """Raise ParameterError if the law has a dilation angle that is not 0. Collective."""
    names = list(getattr(formulation.law, "parameters", ()))
    name = next((name for name in names if name.startswith("dilation")), None)
    if name is None:
        return
    angle = formulation.parameters(formulation.rows)[:, names.index(name)]
    error = None
    if angle.max(initial=0.0) > 0.0:
        error = ParameterError(
            f"fbar = True: {type(formulation.law).__name__} has {name} = {angle.max():g} degrees, "
            "only 0 is possible. F-bar shares the volume change of a cell, but not the shear that "
            "dilates: pressures in the cell drift apart, and the load falls or no equilibrium "
            f'is left. Take basis="bspline2" and finer cells without fbar, or {name} = 0'
        )
    raise_together(comm, error)


def _warn_of_compaction(formulation: Any, points: MaterialPoints, degree: int) -> None:
    """Warn of cubic splines with a law of plastic compaction. Collective."""
    if degree > 2 and "compression" in getattr(formulation.law, "parameters", ()):
        warn(
            points.comm,
            f"fbar = True with splines of degree {degree}: the mean hides volume changes that "
            "alternate from cell to cell. Ground that compacts plastically, as with "
            f"{type(formulation.law).__name__}, then has no stiffness against these changes, and "
            'steps fail soon after it yields. Take basis="bspline2", or fbar=False',
            SoftVolumeWarning,
        )
