"""Functions without the branches that closed-over constants rule out, before Numba sees them.

Numba drops such branches itself, but only after half of its passes have worked on them: a loop
of many variants, each with a part of the whole, compiles in two thirds of the time without them.
"""

from __future__ import annotations

import ast
import builtins
import copy
import functools
import inspect
import textwrap
import types
from collections.abc import Callable
from typing import Any

__all__ = ["fold_constants"]

_UNKNOWN = object()
_CONSTANTS = (bool, int, float, type(None))


class _Pruner(ast.NodeTransformer):
    """Replaces tests whose values are known by what they choose.

    Args:
        known: Names of constants, and their values.
    """

    def __init__(self, known: dict[str, Any]):
        self.known = known

    def value(self, node: ast.expr) -> Any:
        """The value of an expression of constants, or `_UNKNOWN`."""
        names = [n for n in ast.walk(node) if isinstance(n, ast.Name)]
        plain = (
            ast.Name, ast.Constant, ast.BoolOp, ast.UnaryOp, ast.BinOp, ast.Compare, ast.operator,
            ast.unaryop, ast.boolop, ast.cmpop, ast.expr_context,
        )  # fmt: skip
        if not all(isinstance(n, plain) for n in ast.walk(node)):
            return _UNKNOWN
        if not all(n.id in self.known for n in names):
            return _UNKNOWN
        code = compile(ast.Expression(node), "<constant>", "eval")
        return eval(code, {"__builtins__": {}}, self.known)

    def visit_If(self, node: ast.If) -> Any:
        self.generic_visit(node)
        chosen = self.value(node.test)
        if chosen is _UNKNOWN:
            return node
        return (node.body if chosen else node.orelse) or ast.copy_location(ast.Pass(), node)

    def visit_IfExp(self, node: ast.IfExp) -> Any:
        self.generic_visit(node)
        chosen = self.value(node.test)
        if chosen is _UNKNOWN:
            return node
        return node.body if chosen else node.orelse

    def visit_BoolOp(self, node: ast.BoolOp) -> Any:
        """Of tests, whose values count as true or false: parts that decide nothing go."""
        self.generic_visit(node)
        decides, values = isinstance(node.op, ast.Or), []
        for part in node.values:
            value = self.value(part)
            if value is _UNKNOWN:
                values.append(part)
            elif bool(value) == decides:
                # what comes behind is not asked
                values.append(ast.copy_location(ast.Constant(decides), part))
                break
        if not values:
            return ast.copy_location(ast.Constant(not decides), node)
        if len(values) == 1:
            return values[0]
        node.values = values
        return node


def fold_constants(function: Callable) -> Callable:
    """The function without branches that its closed-over and global constants rule out.

    Numbers, truth values and None are constants, in tests by `and`, `or`, `not`, comparisons and
    arithmetic. It closes over the same cells as before, used or not, so that by these Numba's
    cache tells one variant from another.

    Args:
        function: A function from a file, in whose tests `and` and `or` stand for true or false.
    """
    code = function.__code__
    cells = dict(zip(code.co_freevars, function.__closure__ or ()))
    known = {name: cell.cell_contents for name, cell in cells.items()}
    # a global is one that no argument or variable hides
    own = {*code.co_varnames, *code.co_cellvars, *code.co_freevars}
    for name in set(code.co_names) - own:
        known[name] = function.__globals__.get(name, getattr(builtins, name, _UNKNOWN))
    known = {name: value for name, value in known.items() if isinstance(value, _CONSTANTS)}

    lines, first = inspect.getsourcelines(function)
    definition = ast.parse(textwrap.dedent("".join(lines))).body[0]
    assert isinstance(definition, ast.FunctionDef)
    definition.decorator_list = []
    again = _compiled(definition, code, first)
    if any(
        getattr(again, of) != getattr(code, of) for of in ("co_names", "co_consts", "co_varnames")
    ):
        # the file has changed since it was imported
        return function
    _Pruner(known).visit(definition)
    # a test that is never true keeps all names closed over
    names: list[ast.stmt] = [ast.Expr(ast.Name(name, ast.Load())) for name in code.co_freevars]
    if names:
        definition.body.insert(0, ast.If(ast.Constant(False), names, []))
    less = types.FunctionType(
        _compiled(definition, code, first), function.__globals__, function.__name__,
        function.__defaults__, function.__closure__,
    )  # fmt: skip
    return functools.wraps(function)(less)


def _compiled(definition: ast.FunctionDef, code: types.CodeType, first: int) -> types.CodeType:
    """A function's code from its definition, at the lines and with the free names of its old one.

    Args:
        definition: The definition.
        code: The old one.
        first: The line from which the definition's are counted.
    """
    arguments = [ast.arg(name) for name in code.co_freevars]
    outer = ast.FunctionDef(
        "closed_over", ast.arguments([], arguments, None, [], [], None, []),
        [copy.deepcopy(definition), ast.Return(ast.Name(code.co_name, ast.Load()))], [],
    )  # fmt: skip
    tree = ast.fix_missing_locations(ast.Module([outer], []))
    ast.increment_lineno(tree, first - 1)
    space: dict[str, Any] = {}
    exec(compile(tree, code.co_filename, "exec", dont_inherit=True), space)
    return space["closed_over"](*[None] * len(arguments)).__code__
