"""Objects that hold a grid, ranks and compiled code, and that cannot be copied."""

from __future__ import annotations

import copyreg
from typing import Any, NoReturn

from dolfinx import cpp

from dolfinmpm._platform.errors import ParameterError

__all__ = ["Uncopied", "explain_grids"]

# Beginnings of the names of DOLFINx's classes in C++ that belong to a mesh
_ON_MESHES = ("Mesh_", "Geometry_", "Topology", "FunctionSpace_", "Function_", "Constant_", "Form_")


class Uncopied:
    """Base of classes whose objects cannot be copied or pickled.

    Plain Python would end `copy.deepcopy` in a TypeError about the mesh. `copy.copy` would make an
    object that shares its arrays: steps of the copy would move the original.

    Raises:
        ParameterError: Such an object is copied or pickled.
    """

    def __reduce_ex__(self, protocol: Any) -> NoReturn:
        """Refuse copies: `copy.copy`, `copy.deepcopy` and `pickle` call it."""
        raise ParameterError(
            f"a {type(self).__name__} cannot be copied or pickled, because it holds the grid and "
            "its ranks: make another one with the same arguments. To come back to a state, keep it "
            "by problem.save(path), and call problem.load(path)"
        )


def explain_grids() -> None:
    """Let `pickle` and `copy.deepcopy` of what is on a grid end in an error that says what to do.

    Forms, functions and fields of points hold objects of C++, which Python cannot pickle.
    """
    for name, kind in {**vars(cpp.mesh), **vars(cpp.fem)}.items():
        if name.startswith(_ON_MESHES):
            copyreg.pickle(kind, _refuse)


def _refuse(what: Any) -> NoReturn:
    raise ParameterError(
        f"a {type(what).__name__.partition('_')[0]} of DOLFINx cannot be copied or pickled, and so "
        "neither can what is on it, such as forms, functions and fields of points: make them anew, "
        'or keep arrays, such as points["density"].copy()'
    )
