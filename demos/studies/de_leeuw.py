# %% [markdown]
# # De Leeuw's cylinder: a round edge that drains, anywhere in the grid
#
# A long cylinder of saturated soil is put under an even pressure $p_0$ all around, and
# drains at its rim. As in Mandel's problem the pressure in the middle rises first. Volume strain e
# obeys the heat equation; with $p = M\,(e - e(a))$ and $M e(a) - 2G\,u(a)/a = -p_0$ its modes are
# $J_0(\xi r/a)$ with $M J_0(\xi) = 2 G J_1(\xi)/\xi$ (de Leeuw 1965).
#
# A quarter of the circle is computed on a square grid that knows nothing of circles: load and
# drainage act on the body's own edge.

# %%
from __future__ import annotations

from dataclasses import dataclass

from options import other_default
from poroelastic import InTime, Round, run_round


@dataclass
class Input(Round):
    """De Leeuw's cylinder."""

    times: list[float] = other_default(InTime, "times", [0.01, 0.05, 0.1, 0.2, 0.5])


run_round(Input.parse(), axisymmetric=False)
