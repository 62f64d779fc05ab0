"""An array type for compiled functions that discards all values.

A law's kernel compiled with this type for its tangent computes no tangent: the compiler removes
computations without effect.
"""

from __future__ import annotations

import operator

from llvmlite import ir
from numba import types
from numba.extending import models, overload, register_model

__all__ = ["DISCARDED"]


class _Discarded(types.Type):
    def __init__(self):
        super().__init__(name="Discarded")


DISCARDED = _Discarded()


@register_model(_Discarded)
class _DiscardedModel(models.PrimitiveModel):
    def __init__(self, manager, kind):
        # an address, as the caller gives one
        super().__init__(manager, kind, ir.IntType(8).as_pointer())


@overload(operator.setitem)
def _set(array, index, value):
    if isinstance(array, _Discarded):
        return lambda array, index, value: None
    return None


@overload(operator.getitem)
def _get(array, index):
    if isinstance(array, _Discarded):
        return lambda array, index: 0.0
    return None
