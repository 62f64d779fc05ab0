# %% [markdown]
# # Cryer's sphere: pressure that rises by a fifth before it falls
#
# A ball of saturated soil is put under an even pressure $p_0$ all around, and drains at its
# surface. The shell that has drained shrinks upon the core, whose pressure rises first (Cryer
# 1963). Volume strain e obeys the heat equation; with $p = M\,(e - e(a))$ and
# $M e(a) - 4G\,u(a)/a = -p_0$ its modes are $\sin(\xi r/a)/r$.
#
# A quarter of the meridian's section is computed, whose points are rings about the axis.

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
