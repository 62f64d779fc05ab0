"""F-bar: a cell's points share one change of volume, so that incompressible bodies do not lock.

De Souza Neto, Perić, Dutko & Owen (1996, doi 10.1016/0020-7683(95)00259-6) replace the
volume change of every integration point by one of its element; Coombs, Charlton,
Cortis & Augarde (2018, doi 10.1016/j.cma.2018.01.010) take the volume-weighted mean over
the material points in a cell, or under the overlapping domains of GIMP. Splines take the
mean over splines one degree lower, see `dolfinmpm.cut.cellmeans`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

import numba
import numpy as np
import numpy.typing as npt

from dolfinmpm._platform.errors import ParameterError, SoftVolumeWarning, raise_together, warn
from dolfinmpm.basis.cells import invert
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.forms.operators import KeepingLaw, KeptTangents, if_kept

__all__ = ["FBar", "StrainFramework"]

Array = npt.NDArray[np.float64]


class StrainFramework(Protocol):
    """A `PointwiseLaw` of the increment's gradient H that F-bar may be put around.

    It may be a `KeepingLaw` too.

    Attributes:
        law: The constitutive law in it.
        multiplicative: Whether strain comes from ΔF = I + H and the flux is τ ΔF⁻ᵀ;
            False for frameworks in which strain is additive in sym H.
    """

    law: Any
    multiplicative: bool

    def evaluate(self, operand: Array, value: Array, tangent: Array | None, rows) -> int:
        """See `PointwiseLaw`."""

    def commit(self, operand: Array, rows) -> dict[str, Array]:
        """See `PointwiseLaw`."""

    def describe(self, operand: Array, row: int) -> str:
        """What is known of a point at which there is no stress."""


@numba.njit(cache=True, error_model="numpy")
def _measure(H, d, multiplicative, out):
    """ΔJ = det(I + H), or tr H."""
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
    """ΔJ ΔF⁻ᵀ, or I."""
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
    """H̄ with the mean's change of volume; returns the first point that has none, or -1."""
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
    """From S̄(H̄) and its slope Ā to S, its slope at constant mean, and that by the mean."""
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


def _refuse_dilation(framework: StrainFramework, rows: npt.NDArray[np.int32], comm) -> None:
    """Raise ParameterError where shear makes volume. Collective."""
    names = list(getattr(framework.law, "parameters", ()))
    name = next((name for name in names if name.startswith("dilation")), None)
    if name is None:
        return
    angle = framework.parameters(rows)[:, names.index(name)]  # type: ignore[attr-defined]
    error = None
    if angle.max(initial=0.0) > 0.0:
        error = ParameterError(
            f"fbar = True: {type(framework.law).__name__} has {name} = {angle.max():g} degrees, "
            "only 0 is possible. F-bar shares the change of volume but not the shear that "
            "dilates: in a cell pressures drift apart, and the load falls or no equilibrium "
            f'is left. Take basis="bspline2" and finer cells without fbar, or {name} = 0'
        )
    raise_together(comm, error)


def _warn_of_compaction(framework: StrainFramework, points: MaterialPoints, degree: int) -> None:
    """Warn where cubic splines meet a law that compacts. Collective."""
    if degree > 2 and "compression" in getattr(framework.law, "parameters", ()):
        warn(
            points.comm,
            f"fbar = True with splines of degree {degree}: changes of volume that alternate from "
            "cell to cell are averaged out, and ground that compacts plastically, as "
            f"{type(framework.law).__name__} does, has no stiffness left against them: steps fail "
            'soon after it yields. Take basis="bspline2", or fbar=False',
            SoftVolumeWarning,
        )


class FBar:
    """F-bar around a strain framework, as an operator of the increment's gradient H.

    With ΔF = I + H, ΔJ = det ΔF and ΔJ̄ its mean over the cells of the point, or over
    splines one degree lower (see `CellMeans`), weighted with the volumes at the start of the
    step, the framework is given ΔF̄ = r ΔF, r = (ΔJ̄/ΔJ)^(1/d), d the dimension of space (2
    in plane strain, else 3). From its flux S̄ = τ ΔF̄⁻ᵀ follows what is integrated over the true
    volume with true spatial gradients, S = (J/J̄) r S̄ = (J/J̄) τ ΔF⁻ᵀ: Cauchy stress belongs to
    the F̄ that made it, σ = τ/J̄, and the factor J/J̄ is left in as de Souza Neto et al. have
    it, who integrate σ(F̄) over the true volume.

    Where strain is additive the framework is given H + (mean(tr H) − tr H)/d I, and
    its flux is taken as it is.

    Adds to the points, once bound, the field `J_bar`, the product J̄ of the means ΔJ̄ of all
    steps, if strain is multiplicative. F, V and x of the points are the true ones.

    A law with a dilation angle is refused when a problem is made. Let x and t be the rates of
    shear and of volume at a yielding point, t̄ the shared one, η and η̄ the slopes of the yield
    surface and of the flow: the rate of stress is proportional to η̄ x − t̄, its power with the
    true gradients to (η x − t)(η̄ x − t̄). So each point demands that its own shear fit the
    shared volume, as many constraints as without F-bar (de Borst & Groen 1995, Int. J. Numer.
    Methods Eng. 38:2887, on elements in dilatant flow); and where x or t varies within a cell
    the power becomes negative even if flow is associated, η = η̄, where without F-bar it is a
    square.
    Under a footing with φ = ψ = 20° an eigenvalue of the tangent goes through zero at 80 % of
    the limit load, and no step is small enough; with ψ = 5° the load falls to 60 % of its
    peak. Laws that dilate without a parameter of this name are not recognised.

    Cubic splines warn under a law with a normal compression line. They can change the volume
    with hardly any shear, as the gradient of a harmonic function does, in waves of two cells,
    and the mean leaves 2/15 of such a wave, where it leaves 1/3 for quadratic splines. The force
    is that of the mean and the pressure p of ground on that line resists with about p/λ only:
    the terms of order p by which a stress turns, and the shear that shares its plastic flow,
    outweigh what is left. A block of Cam-Clay (λ = 0.05 ... 0.25) under even dead pressures fails
    soon after it yields, at a free corner first, with 2² and 4² points and with smaller steps;
    without F-bar it does not, nor with λ = 0.03. A mean that keeps half of a point's own change
    would mend it, and would lock.

    Args:
        framework: What gives the stress.
        points: Material points.
        degree: Degree of the basis of the increment.
        by_centres: Whether a point counts in the cell of its centre alone, and has that cell's
            mean, though its domain overlaps others. There are fewer means to share then than
            shares of domains leave, and they jump as points cross into the next cell.
    """

    def __init__(
        self,
        framework: StrainFramework,
        points: MaterialPoints,
        degree: int = 1,
        by_centres: bool = False,
    ):
        self.by_centres = by_centres
        self.framework = framework
        self.points = points
        self._degree = degree
        self._bound = False
        self._multiplicative = framework.multiplicative
        self._measure: Array = np.empty(0)
        self._mean: Array = np.empty(0)

    def bind(self) -> None:
        """Add the field `J_bar`: of a body that moved without F-bar it is det F. Collective.

        Warns of splines that its means are too wide for.

        Raises:
            ParameterError: The law has a dilation angle that is not 0.
        """
        rows = getattr(self.framework, "rows", np.empty(0, np.int32))
        _refuse_dilation(self.framework, rows, self.points.comm)
        if not self._bound:
            _warn_of_compaction(self.framework, self.points, self._degree)
        self._bound = True
        if self._multiplicative and "J_bar" not in self.points.fields:
            self.points.add_field("J_bar", (), "", 1.0)
            self.points["J_bar"] = np.linalg.det(self.points["F"])

    @property
    def law(self) -> Any:
        """The constitutive law."""
        return self.framework.law

    @property
    def keeps(self) -> int:
        """Numbers of a point that are kept, those of the framework; see `KeepingLaw`."""
        return self.framework.keeps if isinstance(self.framework, KeepingLaw) else 0

    def describe(self, operand: Array, row: int) -> str:
        """What is known of a point at which there is no stress; see `Framework`."""
        changed = np.empty((1, operand.size))
        here, d = slice(row, row + 1), self.points.strain_dim
        flat = np.ascontiguousarray(operand, float).reshape(1, -1)
        bad = _replace_volume(
            flat, self._measure[here], self._mean[here], d, self._multiplicative, changed
        )
        return self.framework.describe((flat if bad >= 0 else changed).reshape(d, d), row)

    def _measured(self, operand: Array) -> Array:
        out = np.empty(len(operand))
        _measure(operand, self.points.strain_dim, self._multiplicative, out)
        return out

    def prepare(self, operand: Array, mean: Callable[[Array], Array]) -> None:
        """Take the mean of ΔJ, or of tr H, for new increments; see `AveragingLaw`. Collective."""
        self._measure = self._measured(operand)
        self._mean = mean(self._measure)

    def measure_slope(self, operand: Array) -> Array:
        """ΔJ ΔF⁻ᵀ, or I; see `AveragingLaw`."""
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
        """S and its derivatives by ∇ũ and by the mean; see `AveragingLaw`, `KeepingLaw`."""
        d, kind = self.points.strain_dim, self._multiplicative
        measure, mean = self._measure[rows], self._mean[rows]
        changed = np.empty_like(operand)
        bad = _replace_volume(operand, measure, mean, d, kind, changed)
        if bad < 0:
            bad = self.framework.evaluate(changed, value, tangent, rows, **if_kept(kept))
        if bad >= 0:
            return bad
        history = self._history(rows) if kind else np.empty(0)
        if tangent is None:
            tangent, by_mean = np.empty((0, 1, 1)), None
        elif by_mean is None:
            by_mean = np.empty_like(value)
        slope = np.empty((0, 1)) if by_mean is None else by_mean
        _true_gradient(operand, measure, mean, history, d, kind, value, tangent, slope)
        return -1

    def commit(self, operand: Array, rows, kept: KeptTangents | None = None) -> dict[str, Array]:
        """The framework's fields at the end of the step, with σ = τ/J̄, and J̄."""
        points = self.points
        changed = np.empty_like(operand)
        _replace_volume(
            operand, self._measure[rows], self._mean[rows], points.strain_dim, self._multiplicative,
            changed,
        )  # fmt: skip
        new = self.framework.commit(changed, rows, **if_kept(kept))
        if self._multiplicative:
            # the framework took det ΔF̄ times the true det F before the step for its volume
            new["stress"] *= self._history(rows)[:, None, None]
            new["J_bar"] = points["J_bar"][rows] * self._mean[rows]
        return new
