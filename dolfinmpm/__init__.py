"""dolfinmpm: an unfitted material point method on FEniCSx."""

import importlib as _importlib
import sys as _sys
from typing import TYPE_CHECKING as _TYPE_CHECKING
from typing import Any as _Any

from dolfinmpm._platform.garbagecollector import idle_collector as _idle_collector

with _idle_collector():
    from dolfinmpm._platform import startup as _startup  # noqa: F401 # isort: skip
    from dolfinmpm import materials
    from dolfinmpm._platform import errors
    from dolfinmpm._platform.installation import info
    from dolfinmpm._platform.stages import measure_stages
    from dolfinmpm.basis.conditions import fixed, moving, prescribed, rollers
    from dolfinmpm.basis.space import Space
    from dolfinmpm.body.axisymmetry import gradient
    from dolfinmpm.body.bodysums import BodySums
    from dolfinmpm.body.boundary import Boundary
    from dolfinmpm.body.filling import fill
    from dolfinmpm.body.meshpartition import partitioner
    from dolfinmpm.body.pointfamilies import Families, FamilyChange, families, merge, split
    from dolfinmpm.body.points import MaterialPoints, PointChange
    from dolfinmpm.body.probes import probe
    from dolfinmpm.body.sectionforces import SectionForces, section_forces
    from dolfinmpm.body.shapes import Ball, Box, Disc, Polygon, Shape, TurnedBox, Where
    from dolfinmpm.body.surface import Surface
    from dolfinmpm.body.terrain import Terrain
    from dolfinmpm.contact import Cone, Plane, RigidBody, Wedge, contact, contact_between, springs
    from dolfinmpm.contact.wantedsizes import near, where_it_yields
    from dolfinmpm.cut.penalties import ghost, soft
    from dolfinmpm.cut.stabilisations import Stabilisation
    from dolfinmpm.cut.tiedsides import tied
    from dolfinmpm.dynamics import (
        Collision,
        Explicit,
        GeneralisedAlpha,
        GroundColumn,
        InputMotion,
        Mapping,
        Newmark,
        Transient,
        absorbing,
        free_field,
        frictional,
        times,
    )
    from dolfinmpm.forms.carriedfields import acceleration, carried
    from dolfinmpm.forms.termqueries import stiffness_per_area
    from dolfinmpm.grid.graded import create_lattice, zoned_line
    from dolfinmpm.grid.lattice import cell_size
    from dolfinmpm.io import Film, ParaView, animate, figure, plot
    from dolfinmpm.io.history import History
    from dolfinmpm.io.progress import steps
    from dolfinmpm.kinematics import (
        Deposit,
        Layer,
        dirichlet,
        geostatic_stress,
        momentum,
        set_stress,
        signorini,
        stress,
    )
    from dolfinmpm.kinematics.footing import RigidFooting
    from dolfinmpm.porous import Fluid, kozeny_carman, poromechanics
    from dolfinmpm.solve import (
        ArcLength,
        QuasiStatic,
        equilibrate,
        reaction,
        regrid,
        start_at_rest,
    )

# so that `from dolfinmpm.errors import ConvergenceError` finds the module too
_sys.modules[f"{__name__}.errors"] = errors

if _TYPE_CHECKING:
    from dolfinmpm import study

__version__ = "0.1.0"

__all__ = [
    "ArcLength",
    "Ball",
    "BodySums",
    "Boundary",
    "Box",
    "Collision",
    "Cone",
    "Deposit",
    "Disc",
    "Explicit",
    "Families",
    "FamilyChange",
    "Film",
    "Fluid",
    "GeneralisedAlpha",
    "GroundColumn",
    "History",
    "InputMotion",
    "Layer",
    "Mapping",
    "MaterialPoints",
    "Newmark",
    "ParaView",
    "Plane",
    "PointChange",
    "Polygon",
    "QuasiStatic",
    "RigidBody",
    "RigidFooting",
    "SectionForces",
    "Shape",
    "Space",
    "Stabilisation",
    "Surface",
    "Terrain",
    "Transient",
    "TurnedBox",
    "Wedge",
    "Where",
    "absorbing",
    "acceleration",
    "animate",
    "carried",
    "cell_size",
    "contact",
    "contact_between",
    "create_lattice",
    "dirichlet",
    "equilibrate",
    "errors",
    "families",
    "figure",
    "fill",
    "fixed",
    "free_field",
    "frictional",
    "geostatic_stress",
    "ghost",
    "gradient",
    "info",
    "kozeny_carman",
    "materials",
    "measure_stages",
    "merge",
    "momentum",
    "moving",
    "near",
    "partitioner",
    "plot",
    "poromechanics",
    "prescribed",
    "probe",
    "reaction",
    "regrid",
    "rollers",
    "section_forces",
    "set_stress",
    "signorini",
    "soft",
    "split",
    "springs",
    "start_at_rest",
    "steps",
    "stiffness_per_area",
    "stress",
    "study",
    "tied",
    "times",
    "where_it_yields",
    "zoned_line",
]


def __getattr__(name: str) -> _Any:
    """Import `study` where it is first used, because most runs do without its modules."""
    if name == "study":
        return _importlib.import_module("dolfinmpm.study")
    text = f"module 'dolfinmpm' has no attribute {name!r}"
    if not name.startswith("_"):
        rooms = {"materials": materials, "study": _importlib.import_module("dolfinmpm.study")}
        text += "".join(
            f": it is mpm.{at}.{name}" for at, room in rooms.items() if name in dir(room)
        )
    raise AttributeError(text)


def __dir__() -> list[str]:
    """Names for completion, with those that are not imported yet."""
    return sorted({*globals(), "study"})
