"""The passes over the points that an explicit step is made of."""

from __future__ import annotations

from typing import NamedTuple

__all__ = [
    "COLUMNS",
    "FAST",
    "GROWTH",
    "JAUMANN",
    "LAW",
    "MEANS",
    "NEO",
    "PASSES",
    "SMALL",
    "Pass",
    "Switches",
]

# What compiled sums may do with floating-point numbers: reorder and contract them, nothing else.
FAST = {"contract", "reassoc", "nsz", "arcp"}

# How the strain of a point makes its stress
LAW, SMALL, NEO, JAUMANN = 0, 1, 2, 3

# How domains grow, see `dolfinmpm.body.gimpdomains`; 0 is no domain
GROWTH = {"stretch": 1, "volume": 2, "fixed": 3}

# What a pass does with the means of F-bar: a pass that strains takes them and does nothing else,
# so that they are known to all cells; the next uses them. By kind of F-bar: over cells by shares of
# domains, or over splines one degree lower; and over the cells of the points' centres
MEANS: dict[bool | str, tuple[int, int]] = {True: (1, 2), "centres": (3, 4)}


class Pass(NamedTuple):
    """Parts of a pass, each fixed when it is compiled.

    Attributes:
        velocity: Whether points take new velocities.
        strain: Whether they are strained, by the velocities in the nodes' last columns.
        move: Whether they move.
        same: What they scatter where they were: 0 nothing, 1 momenta, 2 forces.
        new: What they scatter where they are then: 0 nothing, 1 masses and momenta, 2 forces too.
    """

    velocity: bool = False
    strain: bool = False
    move: bool = False
    same: int = 0
    new: int = 0


class Switches(NamedTuple):
    """What is chosen when a pass runs, and compiles nothing anew.

    Attributes:
        record: Whether it writes what only others read: accelerations, volumes, stresses.
        advance: Whether points take part in all of it; if not, they only scatter as `Pass.new`.
        scatter: Whether they do that.
    """

    record: bool = False
    advance: bool = True
    scatter: bool = True


class Columns(NamedTuple):
    """Columns of a node's sums over points, and of its motion.

    Sums begin with the momentum, motion with the velocity at the end of the step. Loops take four
    neighbours at once: in two dimensions momentum with force, in three momentum with mass.

    Attributes:
        width: Columns per node.
        mass: The mass.
        force: The force; in the motion the change of velocity.
        second: Momentum of the new velocities; in the motion the velocity for the strain.
    """

    width: int
    mass: int
    force: int
    second: int


COLUMNS = {2: Columns(8, 6, 2, 4), 3: Columns(12, 3, 4, 8)}

# The passes of a step after the first scatter; the last one of each begins the next step.
PASSES = {
    "usl": (Pass(velocity=True, strain=True, move=True, new=2),),
    "musl": (Pass(velocity=True, same=1), Pass(strain=True, move=True, new=2)),
    "usf": (Pass(strain=True, same=2), Pass(velocity=True, move=True, new=1)),
}
