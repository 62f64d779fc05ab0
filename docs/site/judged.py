"""What an example is judged by, read from its own assertion while it runs."""

from __future__ import annotations

import ast
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

FOLDER = Path(__file__).resolve().parents[1] / "_build" / "judged"


def _value(node: ast.expr, names: dict[str, Any]) -> float:
    return float(eval(compile(ast.Expression(node), "assertion", "eval"), names))


def _parts(node: ast.expr) -> tuple[ast.expr, ast.expr] | None:
    """Figure and reference of `abs(figure - reference)` or `abs(figure / reference - 1)`."""
    match node:
        case ast.Call(ast.Name("abs"), [ast.BinOp(figure, ast.Sub(), reference)]):
            match figure, reference:
                case ast.BinOp(found, ast.Div(), exact), ast.Constant(1):
                    return found, exact
            return figure, reference
    return None


def judge(code: str, names: dict[str, Any]) -> list[dict[str, Any]]:
    """The assertions of a block of a program that compare a number with a bound.

    Parameters
    ----------
    code
        The block.
    names
        The variables of the program after the block.

    Returns
    -------
    One dictionary per assertion: "assertion" as written; "deviation" and "allowed", numbers of
    the assertion; where a reference stands in it also "found" and "reference".
    """
    found = []
    for node in ast.parse(code).body:
        match node:
            case ast.Assert(ast.Compare(left, [ast.Lt() | ast.LtE()], [bound])):
                entry: dict[str, Any] = {
                    "assertion": ast.unparse(node.test),
                    "deviation": _value(left, names),
                    "allowed": _value(bound, names),
                }
                if parts := _parts(left):
                    entry |= zip(("found", "reference"), (_value(p, names) for p in parts))
                found.append(entry)
            case ast.Assert(ast.Compare(left, [ast.Eq()], [ast.Constant(float(exact))])):
                found.append(
                    {
                        "assertion": ast.unparse(node.test),
                        "deviation": abs(_value(left, names) - exact),
                        "allowed": 0.0,
                    }
                )
            case ast.Assert(ast.Compare(least, [ast.Lt(), ast.Lt()], [value, most])):
                found.append(
                    {
                        "assertion": ast.unparse(node.test),
                        "found": _value(value, names),
                        "between": [_value(least, names), _value(most, names)],
                    }
                )
    return found


def keep(name: str, entries: list[dict[str, Any]]) -> None:
    FOLDER.mkdir(parents=True, exist_ok=True)
    (FOLDER / f"{name}.json").write_text(json.dumps(entries))


def told(name: str, which: Sequence[int] = (0,)) -> str:
    """The judgements of an example in a sentence, empty where the example has not run.

    Parameters
    ----------
    name
        The example.
    which
        Numbers of its assertions.
    """
    file = FOLDER / f"{name}.json"
    entries = json.loads(file.read_text()) if file.exists() else []
    return "; and ".join(_told(entries[k]) for k in which) if entries else ""


def _told(entry: dict[str, Any]) -> str:
    if "between" in entry:
        return "found {:.4g}, between {:g} and {:g}".format(entry["found"], *entry["between"])
    allowed = f"allowed {entry['allowed']:.2g}"
    if "reference" not in entry:
        return f"off by {entry['deviation']:.2g}; {allowed}"
    found, reference = entry["found"], entry["reference"]
    if not reference or found == entry["deviation"]:
        return f"off by {entry['deviation']:.2g}; {allowed}"
    if reference == 1:
        return f"off by {100 * (found - 1):+.2g} %"
    return f"found {found:.5g}, reference {reference:.5g}: {100 * (found / reference - 1):+.2g} %"
