"""F-bar: the points in a cell share one volume change, so that incompressible bodies do not lock.

De Souza Neto, Perić, Dutko & Owen (1996, doi 10.1016/0020-7683(95)00259-6) replace the volume
change at every integration point by one value per element. Coombs, Charlton, Cortis & Augarde
(2018, doi 10.1016/j.cma.2018.01.010) take the volume-weighted mean over the material points in a
cell; for GIMP, over the shares of the points' domains in the cell. For splines, the mean is taken
over splines of one degree less, see `dolfinmpm.cut.cellaverages`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

import numba
import numpy as np
import numpy.typing as npt

from dolfinmpm.basis.cells import invert
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.forms.operators import KeepingLaw, KeptTangents, if_kept
from dolfinmpm.kinematics.meanvolumechecks import (
    refuse_dilation,
    refuse_simplices,
    warn_of_compaction,
)

__all__ = ["OWN_SHARE", "VOLUMES", "FBar", "GradientLaw", "share_volumes"]

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


class GradientLaw(Protocol):
    """A `PointwiseLaw` of the increment's gradient H that F-bar can wrap.

    It can be a `KeepingLaw` too.

    Attributes:
        law: The constitutive law.
        multiplicative: True if the strain comes from ΔF = I + H and the flux is τ ΔF⁻ᵀ.
            False if the strain is additive in sym H.
    """

    law: Any
    multiplicative: bool

    def evaluate(self, operand: Array, value: Array, tangent: Array | None, rows) -> int:
        """See `PointwiseLaw`."""

    def commit(self, operand: Array, rows) -> dict[str, Array]:
        """See `PointwiseLaw`."""

    def describe(self, operand: Array, row: int) -> str:
        """Description of a point at which the law found no stress, for messages."""


@numba.njit(cache=True, error_model="numpy")
def _measure(H, d, multiplicative, out):
    """Volume change at the points: ΔJ = det(I + H) if multiplicative, else tr H."""
    dF, inverse = np.empty((d, d)), np.empty((d, d))
    for p in range(H.shape[0]):
        if multiplicative:
            for i in range(d):
                for j in range(d):
                    dF[i, j] = H[p, i * d + j] + (1.0 if i == j else 0.0)
            out[p] = invert(dF, inverse)
        else:
            out[p] = 0.0
            for i in range(d):
                out[p] += H[p, i * d + i]


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
    plane strain, else 3), and returns the flux S̄ = τ ΔF̄⁻ᵀ. F-bar returns the flux
    S = (J/J̄) r S̄ = (J/J̄) τ ΔF⁻ᵀ, which is integrated over the true volume with true spatial
    gradients. The Cauchy stress belongs to F̄, σ = τ/J̄. The factor J/J̄ follows de Souza Neto et
    al., who integrate σ(F̄) over the true volume.

    If strain is additive, the strain formulation gets H + (mean(tr H) − tr H)/d I, and F-bar
    returns the flux unchanged.

    Binding adds the field `J_bar` to the points if strain is multiplicative. It is the product J̄
    of the means ΔJ̄ of all steps. The fields F, V and x of the points stay the true ones.

    With fbar="volumes", they stay the true ones in a step only: after it, F is scaled to det F = J̄,
    and V = J̄ V₀. The mean alone controls no single point, so J can drift in long flow: beside a
    cone that penetrates incompressible clay by eight radii, it ends between 0.13 and 2.3, and J̄
    within 1 ± 0.04. Points that shrink so much leave material without stiffness. Points with
    volumes of the mean can still deform in waves of one point (hourglass modes), which a yielding
    material hardly resists. Hence ΔJ̄ gets a share α = 0.03 of the point's own change (see
    Moutsanidis and others 2020, Comput. Part. Mech. 7:309, on such mixtures in particle methods).
    It locks where α K is large beside G, with ν > 0.49. At a cone in clay with ν = 0.49, in cells
    of a quarter of its radius, α = 0.005 finds 2 % less resistance. But a smaller share fails in
    finer cells: steps are halved, and the resistance falls again.

    A law with a dilation angle is refused when a problem is made. Let x and t be the rates of
    shear and of volume at a yielding point, t̄ the shared rate of volume, and η and η̄ the slopes
    of the yield surface and of the flow. The rate of stress is proportional to η̄ x − t̄. Its power
    with the true gradients is proportional to (η x − t)(η̄ x − t̄). Hence the shear of each point
    must fit the shared rate of volume. These are as many constraints as without F-bar (de Borst &
    Groen 1995, Int. J. Numer. Methods Eng. 38:2887, on elements in dilatant flow). If x or t vary
    within a cell, the power can be negative even for associated flow, η = η̄. Without F-bar the
    power of associated flow is a square. Under a footing with φ = ψ = 20°, an eigenvalue of the
    tangent goes through zero at 80 % of the limit load, and no step is small enough. With ψ = 5°
    the load falls to 60 % of its peak. Laws that dilate without a parameter of this name are not
    recognised.

    Cubic splines with a law that has a normal compression line give a warning. Cubic splines can
    change the volume almost without shear, in waves of two cells, like the gradient of a harmonic
    function. The mean keeps 2/15 of such a wave; for quadratic splines it keeps 1/3. Ground on the
    normal compression line resists the mean only with about p/λ, with the pressure p. This
    resistance is smaller than terms of order p: the rotation of the stress, and the shear of the
    plastic flow. A block of Cam-Clay (λ = 0.05 ... 0.25) under uniform dead pressure fails soon
    after it yields, first at a free corner, with 2² and 4² points and with smaller steps. It does
    not fail without F-bar or with λ = 0.03. A mean with half of a point's own change would not
    fail, but would lock.

    Args:
        formulation: The strain formulation with its law, which gives the stress.
        points: Material points.
        degree: Degree of the basis of the increment.
        by_centres: Whether a point counts only in the cell of its centre, and gets the mean of
            this cell, even if its domain overlaps other cells. Fewer points then share a mean, and
            the means jump when points cross into the next cell.
        own: Share of a point's own volume change, α: ΔJ̄ is replaced by ΔJ̄^(1−α) ΔJ^α.
    """

    def __init__(
        self,
        formulation: GradientLaw,
        points: MaterialPoints,
        degree: int = 1,
        by_centres: bool = False,
        own: float = 0.0,
    ):
        self.by_centres = by_centres
        self.formulation = formulation
        self.points = points
        self._degree = degree
        self._bound = False
        self._multiplicative = formulation.multiplicative
        self.own = own
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
        rows = getattr(self.formulation, "rows", np.empty(0, np.int32))
        refuse_simplices(self.points)
        refuse_dilation(self.formulation, rows, self.points.comm)
        if not self._bound:
            warn_of_compaction(self.formulation, self.points, self._degree)
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
        changed = np.empty((1, operand.size))
        one, d = slice(row, row + 1), self.points.strain_dim
        flat = np.ascontiguousarray(operand, float).reshape(1, -1)
        bad = _replace_volume(
            flat, self._measure[one], self._mean[one], d, self._multiplicative, changed
        )
        return self.formulation.describe((flat if bad >= 0 else changed).reshape(d, d), row)

    def _measured(self, operand: Array) -> Array:
        out = np.empty(len(operand))
        _measure(operand, self.points.strain_dim, self._multiplicative, out)
        return out

    def prepare(self, operand: Array, mean: Callable[[Array], Array]) -> None:
        """Compute the means of ΔJ, or of tr H, for new increments. Collective.

        See `AveragingLaw.prepare`.
        """
        self._measure = self._measured(operand)
        self._mean = mean(self._measure)
        if self.own:
            self._mix()

    def _mix(self) -> None:
        """Let the points' own changes count with their share in the means; keep the slopes."""
        share, mean, measure = self.own, self._mean, self._measure
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
        J = np.empty(len(F))
        _measure(F - np.eye(d).ravel(), d, True, J)
        return J / points["J_bar"][rows]

    def evaluate(
        self, operand: Array, value: Array, tangent: Array | None, rows,
        by_mean: Array | None = None, kept: KeptTangents | None = None,
    ) -> int:  # fmt: skip
        """Flux S and its derivatives by ∇ũ and by the mean; see `AveragingLaw`, `KeepingLaw`."""
        d, kind = self.points.strain_dim, self._multiplicative
        measure, mean = self._measure[rows], self._mean[rows]
        changed = np.empty_like(operand)
        bad = _replace_volume(operand, measure, mean, d, kind, changed)
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
        if self.own and by_mean is not None:
            of_mean, of_measure = (slope[rows, None] for slope in self._slopes)
            own = of_measure * self.measure_slope(operand)
            tangent += by_mean[:, :, None] * own[:, None]
            by_mean *= of_mean
        return -1

    def commit(self, operand: Array, rows, kept: KeptTangents | None = None) -> dict[str, Array]:
        """Fields of the strain formulation at the end of the step, with σ = τ/J̄; and J̄."""
        points = self.points
        changed = np.empty_like(operand)
        _replace_volume(
            operand, self._measure[rows], self._mean[rows], points.strain_dim, self._multiplicative,
            changed,
        )  # fmt: skip
        new = self.formulation.commit(changed, rows, **if_kept(kept))
        if self._multiplicative:
            # the strain formulation divided τ by det ΔF̄ times the true det F before the step
            new["stress"] *= self._history(rows)[:, None, None]
            new["J_bar"] = points["J_bar"][rows] * self._mean[rows]
        return new
