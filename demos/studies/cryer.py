# %% [markdown]
# # Cryer's sphere: pressure that rises by a fifth before it falls
#
# A ball of saturated soil is under an even pressure $p_0$ and drains at its surface. The shell
# drains first and shrinks onto the core. So the pressure of the core first rises (Cryer 1963).
# The volume strain e obeys the heat equation. With $p = M\,(e - e(a))$ and
# $M e(a) - 4G\,u(a)/a = -p_0$, its modes are $\sin(\xi r/a)/r$.
#
# A quarter of the section is computed. Points are rings about the axis.

# %%
from __future__ import annotations

from dataclasses import dataclass

from options import other_default
from poroelastic import InTime, Round, run_round


@dataclass
class Input(Round):
    """Cryer's sphere."""

    poisson: float = 1 / 3
    times: list[float] = other_default(InTime, "times", [0.01, 0.02, 0.04, 0.06, 0.1, 0.2, 0.5])


run_round(Input.parse(), axisymmetric=True)
