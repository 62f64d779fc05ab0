"""Ground in layers at rest: effective stress by depth, with a water table, and stiffness by stress.

The effective vertical stress at a height z is the weight of what lies above,

    σ'_v = −Σ_layers (γ t_dry + (γ_sat − γ_w) t_wet),

and the horizontal ones are K0 σ'_v; signs are those of `MaterialPoints`. The laws of drained ground
see effective stress alone; the water then carries its share of the weight, so that the body force
is γ_sat − γ_w below the table.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import KW_ONLY, dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import ufl
from ufl.core.expr import Expr

from dolfinmpm._platform.checks import check_kind, coordinates, number, shown
from dolfinmpm._platform.errors import ParameterError, call_together
from dolfinmpm._platform.together import together
from dolfinmpm.body.formarguments import check_points
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.grid.positions import ask
from dolfinmpm.materials.sands import Sand

__all__ = ["Deposit", "Layer"]

Array = npt.NDArray[np.float64]
Height = float | Callable[[Array], npt.ArrayLike]

# Share of the reference stress below which stiffness does not fall: at the surface it would vanish
_LEAST = 1e-2
# Of passive earth pressure: that of 50 degrees on a rough wall
_LARGEST_K0 = 20.0


@dataclass(frozen=True)
class Layer:
    """A layer of ground.

    Args:
        bottom: Height of its lower end (m): a number, or a function of positions, shape
            (gdim, n), to n values; −inf for what goes on. The last layer of a deposit goes on
            below its bottom.
        unit_weight: γ above the water table (N/m³).
        K0: Horizontal by vertical effective stress, at most 20: that of passive earth pressure is
            less.
        saturated_unit_weight: γ_sat below it (N/m³), no less than γ, which it is by default.

    Raises:
        ParameterError: A number is not what it may be.
    """

    bottom: Height
    unit_weight: float
    K0: float
    _: KW_ONLY
    saturated_unit_weight: float | None = None

    def __post_init__(self):
        if not callable(self.bottom) and self.bottom != -math.inf:
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
                    f"saturated_unit_weight = {full:g} N/m³ must be at least that of the ground "
                    f"without water, unit_weight = {self.unit_weight:g} N/m³: it has the weight of "
                    "the water too"
                )

    @classmethod
    def of(cls, sand: Sand, bottom: Height = -math.inf) -> Layer:
        """A layer of a sand; see `dolfinmpm.materials.sand`."""
        check_kind("sand", sand, Sand, "make it with mpm.materials.sand(relative_density)")
        return cls(
            bottom,
            sand.unit_weight,
            sand.K0,
            saturated_unit_weight=sand.saturated_unit_weight,
        )


class Deposit:
    """Layers of ground under a surface, in the last axis' direction.

    The last layer goes on below its bottom. Heights may depend on the place: a surface that is not
    level has the stress of a level one at each place, which is not in balance; see `equilibrate`.

    Args:
        surface: Height of the ground surface (m), a number or a function as in `Layer`.
        layers: The layers from top to bottom.
        water_table: Height of the water table (m), likewise; None for dry ground.
        water_weight: γ_w (N/m³).

    Raises:
        ParameterError: A layer is none, has its bottom above that of the one before, or floats
            under water; or a height is no number.
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
            if height is not None and not callable(height):
                number(what, height, unit="m")
        number("water_weight", water_weight, 0.0, closed=True, unit="N/m³")
        heights: list[Any] = [surface, *(layer.bottom for layer in layers)]
        for upper, lower in itertools.pairwise(heights):
            if not callable(upper) and not callable(lower) and not lower < upper:
                raise ParameterError(
                    f"the layer with its bottom at {lower:g} m must end below {upper:g} m, where "
                    "what is above it ends; give layers from top to bottom"
                )
        self.surface, self.layers, self.water_table = surface, tuple(layers), water_table
        self.water_weight = float(water_weight) if water_table is not None else 0.0
        for layer in self.layers:
            if water_table is not None and _wet(layer) < self.water_weight:
                raise ParameterError(
                    f"a layer's saturated_unit_weight = {_wet(layer):g} N/m³ is less than that of "
                    f"water, {self.water_weight:g}; give saturated_unit_weight to mpm.Layer"
                )

    # -- functions of positions, shape (gdim, n), to n values -------------------

    def vertical_stress(self, x: npt.ArrayLike) -> Array:
        """Effective vertical stress (Pa), tension positive; 0 above the surface."""
        at = _places(x)
        z, total = at[-1], np.zeros(at.shape[1])
        table, above = self._table(at), self._height("surface", self.surface, at)
        for layer in self.layers:
            # the last one goes on, as its weight does
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
        """Effective horizontal stress (Pa), tension positive."""
        return self._by_layer(x, [layer.K0 for layer in self.layers]) * self.vertical_stress(x)

    def pore_pressure(self, x: npt.ArrayLike) -> Array:
        """Pressure of water at rest (Pa)."""
        at = _places(x)
        depth = np.where(np.isfinite(table := self._table(at)), table - at[-1], 0.0)
        return self.water_weight * np.maximum(depth, 0.0)

    def effective_weight(self, x: npt.ArrayLike) -> Array:
        """Weight that the effective stress carries (N/m³): γ, or γ_sat − γ_w under water."""
        at = _places(x)
        wet = at[-1] < self._table(at)
        dry = self._by_layer(at, [layer.unit_weight for layer in self.layers])
        full = self._by_layer(at, [_wet(layer) for layer in self.layers])
        return np.where(wet, full - self.water_weight, dry)

    def density(self, x: npt.ArrayLike, *, gravity: float = 9.81) -> Array:
        """Mass per volume (kg/m³), that of the water in saturated ground included.

        Args:
            x: Positions (m), shape (gdim, n).
            gravity: g (m/s²), positive.

        Raises:
            ParameterError: g is not positive.
        """
        number("gravity", gravity, 0.0, unit="m/s²")
        at = _places(x)
        wet = at[-1] < self._table(at)
        dry = self._by_layer(at, [layer.unit_weight for layer in self.layers])
        return np.where(wet, self._by_layer(at, [_wet(s) for s in self.layers]), dry) / gravity

    def stress(self, x: npt.ArrayLike) -> Array:
        """Effective Cauchy stress (Pa), shape (n, 3, 3), tension positive; for `set_stress`."""
        at = _places(x)
        vertical, horizontal = self.vertical_stress(at), self.horizontal_stress(at)
        result = np.zeros((at.shape[1], 3, 3))
        for i in range(3):
            result[:, i, i] = vertical if i == len(at) - 1 else horizontal
        return result

    def modulus(
        self, E_ref: float, exponent: float, *, p_ref: float = 100e3, least: float = _LEAST
    ) -> Callable[[npt.ArrayLike], Array]:
        """E = E_ref (−σ'_h/p_ref)^m by the horizontal effective stress at first.

        A law that is given this function as E has a value per point, which stays.

        Args:
            E_ref: Young's modulus at the reference stress (Pa).
            exponent: m.
            p_ref: Reference stress (Pa).
            least: Share of it that counts where stress is less, as at the surface.

        Raises:
            ParameterError: A number is not what it may be.
        """
        number("E_ref", E_ref, 0.0, unit="Pa"), number("exponent", exponent, 0.0, 1.0, closed=True)
        number("p_ref", p_ref, 0.0, unit="Pa"), number("least", least, 0.0)

        def E(x: npt.ArrayLike) -> Array:
            share = np.maximum(-self.horizontal_stress(x) / p_ref, least)
            return E_ref * share**exponent

        return E

    # -- of the points ----------------------------------------------------------

    @together
    def body_force(self, points: MaterialPoints) -> Expr:
        """Body force per initial volume that goes with the effective stress (N/m³). Collective.

        A vector for UFL, downwards: F -= ufl.inner(deposit.body_force(points), v) * points.dX.
        Adds the field `effective_weight` (N/m³) to the points, by where they are now.
        """
        check_points(points)
        values = call_together(points.comm, lambda: self.effective_weight(points["x"].T))
        weight = points.add_field("effective_weight", (), "N/m^d")
        points["effective_weight"] = values
        zeros = [ufl.as_ufl(0.0)] * (points.gdim - 1)
        return ufl.as_vector([*zeros, -weight])

    def _height(self, what: str, height: Height, x: Array) -> Array:
        if callable(height):
            values = ask(what, height, x.T)
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
        """Values of the layers that positions are in; the last goes on below its bottom."""
        at = _places(x)
        found = np.full(at.shape[1], values[-1])
        for layer, value in zip(self.layers[-2::-1], values[-2::-1]):
            found[at[-1] >= self._height("bottom", layer.bottom, at)] = value
        return found


def _wet(layer: Layer) -> float:
    """γ_sat of a layer (N/m³)."""
    given = layer.saturated_unit_weight
    return layer.unit_weight if given is None else given


def _places(x: npt.ArrayLike) -> Array:
    """Positions (m) as an array of shape (gdim, n).

    Raises:
        ParameterError: They are none.
    """
    at = coordinates("x", x)
    if at.ndim != 2 or not 1 <= len(at) <= 3:
        raise ParameterError(
            f"x has the shape {at.shape} and must be positions (m), a row each coordinate, shape "
            "(gdim, n): points['x'].T"
        )
    return at
