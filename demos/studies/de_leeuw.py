# %% [markdown]
# # De Leeuw's cylinder: a round edge that drains, anywhere in the grid
#
# A long cylinder of saturated soil is under an even pressure $p_0$ and drains at its rim. As in
# Mandel's problem, the pressure in the middle first rises. The volume strain e obeys the heat
# equation. With $p = M\,(e - e(a))$ and $M e(a) - 2G\,u(a)/a = -p_0$, its modes are
# $J_0(\xi r/a)$ with $M J_0(\xi) = 2 G J_1(\xi)/\xi$ (de Leeuw 1965).
#
# A quarter of the circle is computed on a square grid that does not fit it. Load and drainage act
# on the edge of the body.

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
