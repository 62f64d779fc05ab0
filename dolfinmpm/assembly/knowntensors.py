"""Tensors of facets that earlier problems of this process have computed.

Studies run an example many times, with the same grid and the same penalty, but with a new form each
time. UFL takes longer for a form of facets than a small problem takes for a step.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Hashable

import numpy as np
import numpy.typing as npt
import ufl

from dolfinmpm.assembly.latticefacets import LatticeFacet
from dolfinmpm.basis.space import Space

__all__ = ["KNOWN", "KnownTensors", "key_of_facet", "key_of_form"]

Array = npt.NDArray[np.float64]


class KnownTensors:
    """Tensors by what they follow from.

    Args:
        most: Number of bytes that they may take. When they would take more, all are forgotten.
    """

    def __init__(self, most: int):
        self._most, self._bytes = most, 0
        self._found: dict[Hashable, Array] = {}

    def get(self, key: Hashable, compute: Callable[[], Array]) -> Array:
        """The tensors of a key, which nobody may change; computed where they are not known."""
        found = self._found.get(key)
        if found is None:
            found = compute()
            found.setflags(write=False)
            if self._bytes + found.nbytes > self._most:
                self._found.clear()
                self._bytes = 0
            self._found[key] = found
            self._bytes += found.nbytes
        return found


KNOWN = KnownTensors(64 * 2**20)


def key_of_form(form: ufl.Form, space: Space) -> Hashable:
    """What the tensors of a form follow from, but for values of constants and the facet.

    UFL's signature numbers coefficients, and does not tell moduli from sizes of cells.

    Args:
        form: The form.
        space: Space of the arguments.
    """
    sizes = {id(space.cell_size): "size", id(space.cell_edges): "edges"}
    kinds = tuple(sizes.get(id(c), type(c).__name__) for c in form.coefficients())
    return form.signature(), kinds, space.basis.degree, space.components


def key_of_facet(place: LatticeFacet) -> Hashable:
    """The place of a facet, to the bit, so that tensors have the same rounding."""
    lines = (hashlib.blake2b(np.asarray(x).tobytes()).digest() for x in place.lines)
    return tuple(lines), place.low, place.direction, place.swapped
