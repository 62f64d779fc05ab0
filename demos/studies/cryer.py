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

from poroelastic import run_round

run_round("Cryer's sphere.", axisymmetric=True)
