"""The passes over the points in a fused explicit step."""

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

# Compiled sums may reorder and contract floating-point operations, nothing else.
FAST = {"contract", "reassoc", "nsz", "arcp"}

# Strain formulations
LAW, SMALL, NEO, JAUMANN = 0, 1, 2, 3

# Update rules of the points' domains, see `dolfinmpm.basis.gimp`; 0 means no domains
GROWTH = {"stretch": 1, "volume": 2, "fixed": 3}

# Use of the means of F-bar in a pass: a first pass only sums them up over the cells, the next pass
# uses them. Per kind of F-bar: means over cells by shares of domains, or over splines one degree
# lower; and means over the cells of the points' centres
MEANS: dict[bool | str, tuple[int, int]] = {True: (1, 2), "centres": (3, 4)}


class Pass(NamedTuple):
    """Parts of a pass. They are fixed when the loop is compiled.

    Attributes:
        velocity: Whether points get new velocities.
        strain: Whether points are strained, by the velocities in the nodes' last columns.
        move: Whether points move.
        same: Sums at the nodes from the old positions: 0 none, 1 momenta, 2 forces.
        new: Sums at the nodes from the new positions: 0 none, 1 masses and momenta, 2 also forces.
        moved: Whether points have moved by the velocities that strain them.
    """

    velocity: bool = False
    strain: bool = False
    move: bool = False
    same: int = 0
    new: int = 0
    moved: bool = False


class Switches(NamedTuple):
    """Options of a pass. They are chosen when the loop runs.

    Attributes:
        record: Whether to write accelerations, volumes and stresses, which the loops do not read.
        advance: Whether points do all parts of the pass; else they only do `Pass.new`.
        scatter: Whether points do `Pass.new`.
    """

    record: bool = False
    advance: bool = True
    scatter: bool = True


class Columns(NamedTuple):
    """Columns of the sums over points at a node, and of the motion of a node.

    The first columns are the momentum, and in the motion the velocity at the end of the step. Loops
    process four adjacent columns at once: momentum and force in 2D, momentum and mass in 3D.

    Attributes:
        width: Number of columns.
        mass: Column of the mass.
        force: First column of the force, and in the motion of the change of velocity.
        second: First column of the momentum of the new velocities, and in the motion of the
            velocity for the strain.
    """

    width: int
    mass: int
    force: int
    second: int


COLUMNS = {2: Columns(8, 6, 2, 4), 3: Columns(12, 3, 4, 8)}

# The passes of a step, after the sums at its start. The last pass also makes the next step's sums.
PASSES = {
    "usl": (Pass(velocity=True, strain=True, move=True, new=2),),
    "musl": (Pass(velocity=True, same=1), Pass(strain=True, move=True, new=2)),
    "usf": (Pass(strain=True, same=2, moved=True), Pass(velocity=True, move=True, new=1)),
}
