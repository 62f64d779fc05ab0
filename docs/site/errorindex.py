"""The page of errors: every named error and warning, what to do, and what makes it."""

from __future__ import annotations

import importlib.util
import inspect
import os
import re
import subprocess
import sys
import tempfile
import textwrap
import tomllib
import warnings
from pathlib import Path
from typing import Any

import assemble

DOCS = Path(__file__).resolve().parents[1]
BASES = {"DolfinMPMError", "DolfinMPMWarning"}


def classes() -> dict[str, type[Exception]]:
    """The named errors, then the named warnings."""
    from dolfinmpm import errors

    found = {name: getattr(errors, name) for name in errors.__all__}
    kinds = {n: c for n, c in found.items() if inspect.isclass(c) and n not in BASES}
    return dict(sorted(kinds.items(), key=lambda item: (issubclass(item[1], Warning), item[0])))


def examples() -> Any:
    """The module of docs/reference/error_examples.py."""
    file = DOCS / "reference" / "error_examples.py"
    spec = importlib.util.spec_from_file_location("error_examples", file)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def message_of(name: str, example: Any, kind: type[Exception]) -> str:
    """The message of the error that an example makes.

    Raises
    ------
    AssertionError
        It makes none of this kind.
    """
    before = dict(os.environ)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            example()
        except kind as error:
            return str(error)
        finally:
            os.environ.clear()
            os.environ.update(before)
    told = [str(one.message) for one in caught if one.category is kind]
    assert told, f"docs/reference/error_examples.py: {name} is not made"
    return told[0]


def message_on_ranks(name: str, number: int) -> str:
    """The message of the error that an example makes on several ranks.

    Raises
    ------
    AssertionError
        It makes none of this kind.
    """
    folder = str(DOCS / "reference")
    code = f"import sys; sys.path.insert(0, {folder!r}); import error_examples as e; e.{name}()"
    command = ["mpirun", "-n", str(number), sys.executable, "-c", code]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=300)
    found = re.search(rf"{name}: (.*)", done.stderr)
    assert found, f"docs/reference/error_examples.py: {name} is not made: {done.stderr[-2000:]}"
    return found[1]


def write_page(write: Any, source: Path) -> None:
    """Runs all examples, and writes reference/errors.md.

    Raises
    ------
    SystemExit
        An error of the package is missing in errors.toml, or one there is none of the package.
    """
    page, here = source / "reference" / "errors.md", Path(__file__)
    sources = here, DOCS / "reference" / "errors.toml", DOCS / "reference" / "error_examples.py"
    if assemble.is_made(page, *sources):
        return
    advice, module, found = (
        tomllib.loads((DOCS / "reference" / "errors.toml").read_text()),
        examples(),
        classes(),
    )
    if set(advice) != set(found):
        raise SystemExit(f"docs/reference/errors.toml: {sorted(set(advice) ^ set(found))}")
    lines = [
        "# Errors and warnings",
        "",
        "All errors derive from `dolfinmpm.errors.DolfinMPMError`, all warnings from",
        "`dolfinmpm.errors.DolfinMPMWarning`. They are raised on all ranks together.",
        "The state is that of the last converged step: a program can catch an error and save.",
        "",
        "The examples use two helpers:",
        "",
        "```python",
        inspect.getsource(module.block).rstrip(),
        "",
        "",
        inspect.getsource(module.problem).rstrip(),
        "```",
        "",
    ]
    before = os.getcwd()
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        try:
            for name, kind in found.items():
                lines += _entry(name, kind, advice[name], module, folder)
        finally:
            os.chdir(before)
    write(page, "\n".join(lines))
    assemble.mark_made(page, *sources)


def _entry(
    name: str, kind: type[Exception], advice: dict[str, str], module: Any, folder: str
) -> list[str]:
    example, ranks = getattr(module, name, None), module.RANKS.get(name, 1)
    meaning = inspect.getdoc(kind) or ""
    lines = [f"## {name}", "", meaning, "", f"**What to do.** {advice['do']}", ""]
    if example is None:
        return [*lines, f"**When.** {advice['when']}", ""]
    code = textwrap.dedent(inspect.getsource(example).partition("\n")[2]).rstrip()
    made = message_on_ranks(name, ranks) if ranks > 1 else message_of(name, example, kind)
    message = made.replace(f"{folder}/", "")
    message = re.sub(r"/\S*/(?=\w+\.npz)", "", message)
    lines += [f"On {ranks} ranks:", ""] if ranks > 1 else []
    return [*lines, "```python", code, "```", "", "```text", f"{name}: {message}", "```", ""]
