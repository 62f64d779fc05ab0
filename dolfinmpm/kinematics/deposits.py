"""Layered ground at rest: effective stress by depth, with a water table, and stiffness by stress.

The effective vertical stress at a height z is the effective weight of the ground above z,

    σ'_v = −Σ_layers (γ t_dry + (γ_sat − γ_w) t_wet),

with the thicknesses t of the layers above and below the water table. The horizontal stresses are
K0 σ'_v; signs are those of `MaterialPoints`. Laws of drained ground contain only effective stress.
The body force below the water table is then γ_sat − γ_w, because the water carries the rest of the
weight. Below a sloping water table the water flows, and drags the ground. The pressure p grows with
the depth below the table, as Dupuit assumed. So the drag is a horizontal force per volume, −∂p/∂x.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import KW_ONLY, dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from ufl.core.expr import Expr

from dolfinmpm._platform.argumentchecks import (
    check_kind,
    coordinates,
    is_endless,
    number,
    refuse_idle,
    shown,
)
from dolfinmpm._platform.collective import collective
from dolfinmpm._platform.errors import ParameterError
from dolfinmpm._platform.uncopied import Unchanged, unchanged
from dolfinmpm._platform.units import refuse_number_of
from dolfinmpm.body.formarguments import check_points
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.body.terrain import Terrain
from dolfinmpm.grid.userfunctions import call_function
from dolfinmpm.kinematics.depositforce import effective_force
from dolfinmpm.materials.sands import Sand

__all__ = ["Deposit", "Layer", "check_dimension"]

Array = npt.NDArray[np.float64]
Height = float | Callable[[Array], npt.ArrayLike]

# Lower bound of the stress in the stiffness, as a share of the reference stress: without a bound
# the stiffness would vanish at the surface
_LEAST = 1e-2
# Bound of K0: the coefficient of passive earth pressure for 50 degrees on a rough wall
_LARGEST_K0 = 20.0
# Wet soil of more times the weight of water is given in another unit
_HEAVIEST = 20.0
# Unit weight of wet soil that is one in N/m³, and not in kgf/m³
_NEWTONS = 8e3


@unchanged()
@dataclass(frozen=True)
class Layer:
    """A layer of ground.

    Args:
        bottom: Height of the layer's bottom (m): a number, or a function of positions (m), shape
            (gdim, n), that returns n heights; −inf for a layer without a bottom. The last layer of
            a deposit also goes on below its bottom.
        unit_weight: Unit weight γ above the water table (N/m³).
        K0: Ratio of horizontal to vertical effective stress, at most 20. Coefficients of passive
            earth pressure are smaller.
        saturated_unit_weight: Unit weight γ_sat below the water table (N/m³), at least γ. By
            default it is γ.

    Raises:
        ParameterError: A number is out of range.

    Loose sand above dense sand:

    >>> import dolfinmpm as mpm
    >>> loose, dense = mpm.materials.sand(0.3), mpm.materials.sand(0.8)
    >>> layers = [mpm.Layer.of(loose, bottom=6.0), mpm.Layer.of(dense)]
    >>> [layer.unit_weight for layer in layers]
    [16200.0, 18200.0]
    """

    bottom: Height
    unit_weight: float
    K0: float
    _: KW_ONLY
    saturated_unit_weight: float | None = None

    def __post_init__(self):
        if not callable(self.bottom) and not is_endless(self.bottom, -1.0):
            number("bottom", self.bottom, unit="m")
        number("unit_weight", self.unit_weight, 0.0, closed=True, unit="N/m³")
        if number("K0", self.K0, 0.0, closed=True) > _LARGEST_K0:
            raise ParameterError(
                f"K0 = {self.K0:g} must be at most {_LARGEST_K0:g}; the arguments of mpm.Layer are "
                f"bottom = {shown(self.bottom)} (m), unit_weight = {self.unit_weight:g} (N/m³) and "
                "K0, in this order"
            )
        if self.saturated_unit_weight is not None:
            full = number("saturated_unit_weight", self.saturated_unit_weight, unit="N/m³")
            if full < self.unit_weight:
                raise ParameterError(
                    f"saturated_unit_weight = {full:g} N/m³ must be at least unit_weight = "
                    f"{self.unit_weight:g} N/m³: it contains the weight of the water too"
                )

    @classmethod
    def of(cls, sand: Sand, bottom: Height = -math.inf) -> Layer:
        """A layer of a sand; see `dolfinmpm.materials.sand`.

        Args:
            sand: The sand, with its unit weights and its K0.
            bottom: Height of the layer's bottom (m), see `Layer`.

        Raises:
            ParameterError: The argument is no sand, or a number is out of range.
        """
        check_kind("sand", sand, Sand, "make it with mpm.materials.sand(relative_density)")
        return cls(
            bottom,
            sand.unit_weight,
            sand.K0,
            saturated_unit_weight=sand.saturated_unit_weight,
        )


class Deposit(Unchanged):
    """Layers of ground under a surface. The last axis points up.

    The last layer goes on below its bottom. Heights may depend on the position. Below a sloping
    surface, each position has the stress of a level surface at the same height. These stresses are
    not in balance; see `equilibrate`.

    Args:
        surface: Height of the ground surface (m), a number or a function as in `Layer`.
        layers: The layers from top to bottom.
        water_table: Height of the water table (m), a number or a function as in `Layer`; None for
            dry ground.
        water_weight: Unit weight γ_w of water (N/m³).

    Raises:
        ParameterError: An entry of `layers` is no `Layer`; a layer has its bottom above the bottom
            of the layer before; a layer is lighter than water; or a height is no number.

    Total and effective stress 6 m below the surface, 4 m below the water table:

    >>> import dolfinmpm as mpm
    >>> import numpy as np
    >>> sand = mpm.Layer(bottom=0.0, unit_weight=17e3, K0=0.5, saturated_unit_weight=20e3)
    >>> ground = mpm.Deposit(surface=10.0, layers=[sand], water_table=8.0)
    >>> x = np.array([[0.0], [4.0]])
    >>> ground.vertical_stress(x).tolist(), ground.pore_pressure(x).tolist()
    ([-74760.0], [39240.0])
    """

    def __init__(
        self,
        surface: Height,
        layers: Sequence[Layer],
        *,
        water_table: Height | None = None,
        water_weight: float = 9810.0,
    ):
        if isinstance(layers, Layer):
            layers = [layers]
        if not isinstance(layers, (list, tuple)) or not layers:
            raise ParameterError(f"layers = {shown(layers)} must be a list of mpm.Layer")
        for layer in layers:
            check_kind("a layer", layer, Layer, "make it with mpm.Layer(bottom, unit_weight, K0)")
        for what, height in (("surface", surface), ("water_table", water_table)):
            dry = height is None and what == "water_table"
            if not dry and not callable(height):
                number(what, height, unit="m" if isinstance(height, float) else "m, or a function")
        number("water_weight", water_weight, 0.0, closed=True, unit="N/m³")
        told = "N/m³ is the number of water's density (kg/m³): give its unit weight, 9810.0 N/m³"
        if max(_wet(layer) for layer in layers) > _NEWTONS:
            refuse_number_of("water_weight", water_weight, 990.0, 1040.0, told)
        if water_table is None:
            refuse_idle("water_weight", water_weight, 9810.0, "there is no water_table")
        heights: list[Any] = [surface, *(layer.bottom for layer in layers)]
        for upper, lower in itertools.pairwise(heights):
            if not callable(upper) and not callable(lower) and not lower < upper:
                raise ParameterError(
                    f"the layer with its bottom at {lower:g} m must end below {upper:g} m, the "
                    "bottom of the layer above or the surface; give layers from top to bottom"
                )
        self.surface, self.layers, self.water_table = surface, tuple(layers), water_table
        self.water_weight = float(water_weight) if water_table is not None else 0.0
        for layer in self.layers:
            if _wet(layer) > _HEAVIEST * self.water_weight > 0.0:
                raise ParameterError(
                    f"water_weight = {water_weight:g} N/m³ is less than a {_HEAVIEST:g}th of that "
                    f"of wet soil, {_wet(layer):g} N/m³: give both in one unit"
                )
            if water_table is not None and _wet(layer) < self.water_weight:
                raise ParameterError(
                    f"a layer's saturated_unit_weight = {_wet(layer):g} N/m³ is less than the "
                    f"unit weight of water, {self.water_weight:g} N/m³; give saturated_unit_weight "
                    "to mpm.Layer"
                )

    # -- functions of positions x (m), shape (gdim, n), that return n values -----

    def vertical_stress(self, x: npt.ArrayLike) -> Array:
        """Effective vertical stress at positions x (Pa), shape (n,).

        The stress is positive in tension, and 0 above the surface.
        """
        at = _places(x)
        z, total = at[-1], np.zeros(at.shape[1])
        table, above = self._table(at), self._height("surface", self.surface, at)
        for layer in self.layers:
            # the last layer has no bottom
            last = layer is self.layers[-1]
            bottom = -np.inf if last else self._height("bottom", layer.bottom, at)
            below = np.minimum(bottom, above)
            low = np.maximum(below, z)
            thick = np.maximum(above - low, 0.0)
            wet = np.maximum(np.minimum(above, table) - low, 0.0)
            total += layer.unit_weight * (thick - wet) + (_wet(layer) - self.water_weight) * wet
            above = below
        return -total

    def horizontal_stress(self, x: npt.ArrayLike) -> Array:
        """Effective horizontal stress at positions x (Pa), positive in tension, shape (n,)."""
        return self._by_layer(x, [layer.K0 for layer in self.layers]) * self.vertical_stress(x)

    def pore_pressure(self, x: npt.ArrayLike) -> Array:
        """Pressure of water at rest at positions x (Pa), shape (n,)."""
        at = _places(x)
        depth = np.where(np.isfinite(table := self._table(at)), table - at[-1], 0.0)
        return self.water_weight * np.maximum(depth, 0.0)

    def effective_weight(self, x: npt.ArrayLike) -> Array:
        """Weight in the effective stress at positions x (N/m³), shape (n,).

        It is γ above the water table and γ_sat − γ_w below it.
        """
        return self._unit_weight(x, self.water_weight)

    def density(self, x: npt.ArrayLike, *, gravity: float = 9.81) -> Array:
        """Mass per volume at positions x (kg/m³), with the water in saturated ground, shape (n,).

        Args:
            x: Positions (m), shape (gdim, n).
            gravity: Acceleration g (m/s²), positive.

        Raises:
            ParameterError: g is not positive.
        """
        number("gravity", gravity, 0.0, unit="m/s²")
        return np.asarray(self._unit_weight(x, 0.0) / gravity, np.float64)

    def _unit_weight(self, x: npt.ArrayLike, buoyancy: float) -> Array:
        """γ above the water table, γ_sat − buoyancy below it (N/m³), shape (n,)."""
        at = _places(x)
        wet = at[-1] < self._table(at)
        dry = self._by_layer(at, [layer.unit_weight for layer in self.layers])
        full = self._by_layer(at, [_wet(layer) for layer in self.layers])
        return np.where(wet, full - buoyancy, dry)

    def stress(self, x: npt.ArrayLike) -> Array:
        """Effective Cauchy stress at positions x (Pa), shape (n, 3, 3), for `set_stress`.

        The stress is positive in tension.
        """
        at = _places(x)
        vertical, horizontal = self.vertical_stress(at), self.horizontal_stress(at)
        result = np.zeros((at.shape[1], 3, 3))
        for i in range(3):
            result[:, i, i] = vertical if i == len(at) - 1 else horizontal
        return result

    def modulus(
        self, E_ref: float, exponent: float, *, p_ref: float = 100e3, least: float = _LEAST
    ) -> Callable[[npt.ArrayLike], Array]:
        """Young's modulus by initial stress, E = E_ref (−σ'_h/p_ref)^m, as a function of positions.

        Give the function to a law as its parameter E. Each point then keeps its first value.

        Args:
            E_ref: Young's modulus at the reference stress (Pa).
            exponent: Exponent m (-), from 0 to 1.
            p_ref: Reference stress (Pa).
            least: Lower bound of σ'_h/p_ref (-), which acts near the surface.

        Raises:
            ParameterError: A number is out of range.
        """
        number("E_ref", E_ref, 0.0, unit="Pa"), number("exponent", exponent, 0.0, 1.0, closed=True)
        number("p_ref", p_ref, 0.0, unit="Pa"), number("least", least, 0.0, 1.0, closed=True)

        def E(x: npt.ArrayLike) -> Array:
            share = np.maximum(-self.horizontal_stress(x) / p_ref, least)
            return E_ref * share**exponent

        return E

    # -- terms at the points ------------------------------------------------------

    @collective
    def body_force(self, points: MaterialPoints) -> Expr:
        """Body force per initial volume in balance with the effective stress (N/m³). Collective.

        The force is a vector for UFL:
        F -= ufl.inner(deposit.body_force(points), v) * points.dX.
        It points downward, and below a sloping water table also along the fall of the water. The
        method adds it to the points, as the fields `effective_weight` and `seepage_force` (N/m³).
        Points that come later get the weight of the ground at their place. Give fill above the
        surface its weight: fill.add_field("effective_weight", (), "N/m^d", 19e3).

        Args:
            points: Material points.
        """
        check_points(points)
        return effective_force(self, points)

    def _height(self, what: str, height: Height, x: Array) -> Array:
        if callable(height):
            check_dimension(what, height, len(x))
            values = call_function(what, height, x.T)
            bad = np.flatnonzero(~np.isfinite(values))
            if bad.size:
                raise ParameterError(
                    f"{what} is {values[bad[0]]} at {x[:, bad[0]]} m and must be finite"
                )
            return values
        return np.full(x.shape[1], float(height))

    def _table(self, x: Array) -> Array:
        if self.water_table is None:
            return np.full(x.shape[1], -np.inf)
        return self._height("water_table", self.water_table, x)

    def _by_layer(self, x: npt.ArrayLike, values: Sequence[float]) -> Array:
        """Values of the layers at positions; the last layer has no bottom."""
        at = _places(x)
        found = np.full(at.shape[1], values[-1])
        for layer, value in zip(self.layers[-2::-1], values[-2::-1]):
            found[at[-1] >= self._height("bottom", layer.bottom, at)] = value
        return found


def check_dimension(what: str, height: Any, gdim: int) -> None:
    """Raise an error where a terrain of another dimension would take heights for positions.

    Args:
        what: Name of the height, for messages.
        height: A number, a function or a terrain.
        gdim: Dimension of the positions.

    Raises:
        ParameterError: The height is a terrain of another dimension.
    """
    if isinstance(height, Terrain) and height.gdim != gdim:
        raise ParameterError(
            f"{what} is a terrain in {height.gdim}D, and positions have {gdim} coordinates: take "
            "terrain.section(start, end) for a section in 2D"
        )


def _wet(layer: Layer) -> float:
    """γ_sat of a layer (N/m³)."""
    given = layer.saturated_unit_weight
    return layer.unit_weight if given is None else given


def _places(x: npt.ArrayLike) -> Array:
    """Positions (m) as an array of shape (gdim, n).

    Raises:
        ParameterError: x is no array of positions.
    """
    at = coordinates("x", x)
    if at.ndim != 2 or not 1 <= len(at) <= 3:
        raise ParameterError(
            f"x has the shape {at.shape} and must be positions (m), one row per coordinate, shape "
            "(gdim, n): points['x'].T"
        )
    return at
