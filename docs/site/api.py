"""Pages of the API from docs/site/api.toml, and what the names in them link to."""

from __future__ import annotations

import importlib
import inspect
import tomllib
import zlib
from pathlib import Path
from typing import Any

from docutils import nodes

SITE = Path(__file__).resolve().parent
PARTS = ("", "materials", "study")
# what types of other packages link to
PYTHON = "https://docs.python.org/3/library/"
DOLFINX = "https://docs.fenicsproject.org/dolfinx/main/python/generated/"
OTHERS = {
    "int": f"{PYTHON}functions.html#int",
    "float": f"{PYTHON}functions.html#float",
    "bool": f"{PYTHON}functions.html#bool",
    "str": f"{PYTHON}stdtypes.html#str",
    "dict": f"{PYTHON}stdtypes.html#dict",
    "list": f"{PYTHON}stdtypes.html#list",
    "tuple": f"{PYTHON}stdtypes.html#tuple",
    "None": f"{PYTHON}constants.html#None",
    "Path": f"{PYTHON}pathlib.html#pathlib.Path",
    "ValueError": f"{PYTHON}exceptions.html#ValueError",
    "RuntimeError": f"{PYTHON}exceptions.html#RuntimeError",
    "Mesh": f"{DOLFINX}dolfinx.mesh.html#dolfinx.mesh.Mesh",
    "MeshTags": f"{DOLFINX}dolfinx.mesh.html#dolfinx.mesh.MeshTags",
    "Function": f"{DOLFINX}dolfinx.fem.html#dolfinx.fem.Function",
    "Constant": f"{DOLFINX}dolfinx.fem.html#dolfinx.fem.Constant",
    "ndarray": "https://numpy.org/doc/stable/reference/generated/numpy.ndarray.html",
    "NDArray": "https://numpy.org/doc/stable/reference/typing.html#numpy.typing.NDArray",
}


def groups() -> dict[str, dict[str, Any]]:
    return tomllib.loads((SITE / "api.toml").read_text())


def public() -> set[str]:
    """Every public name, as it follows `mpm.`; modules apart."""
    found = set()
    for part in PARTS:
        module = importlib.import_module(f"dolfinmpm.{part}".rstrip("."))
        names = {name for name in module.__all__ if not inspect.ismodule(getattr(module, name))}
        found |= {f"{part}.{name}".lstrip(".") for name in names}
    return found


def places() -> dict[str, str]:
    """Where each public name is defined → the name under which it is documented."""
    found = {}
    for name in public():
        owner, _, last = f"dolfinmpm.{name}".rpartition(".")
        thing = getattr(importlib.import_module(owner), last)
        if hasattr(thing, "__qualname__"):
            found[f"{thing.__module__}.{thing.__qualname__}"] = f"dolfinmpm.{name}"
    return found


def write_inventory(file: Path) -> None:
    """Writes an inventory of names of DOLFINx for intersphinx: the build has no network."""
    lines = []
    for module in ("dolfinx.mesh", "dolfinx.fem"):
        for name in importlib.import_module(module).__all__:
            lines.append(f"{module}.{name} py:function 1 {module}.html#{module}.{name} -")
    head = (
        "# Sphinx inventory version 2\n# Project: DOLFINx\n# Version: \n# The remainder is zlib.\n"
    )
    file.parent.mkdir(parents=True, exist_ok=True)
    body = zlib.compress("\n".join([*lines, ""]).encode())
    if not file.exists() or file.read_bytes() != head.encode() + body:
        file.write_bytes(head.encode() + body)


def write_pages(write: Any, source: Path) -> None:
    """Writes one page per group and the page that lists them.

    Raises
    ------
    SystemExit
        A public name is on no page or on two, or a name on a page is not public.
    """
    pages = groups()
    named = [name for page in pages.values() for name in page["names"]]
    twice = {name for name in named if named.count(name) > 1}
    if set(named) != public() or twice:
        raise SystemExit(
            f"docs/site/api.toml: on no page: {sorted(public() - set(named))}; "
            f"not public: {sorted(set(named) - public())}; twice: {sorted(twice)}"
        )
    for stem, page in pages.items():
        lines = [f"# {page['title']}", "", page["text"], "", "```{eval-rst}"]
        for name in page["names"]:
            owner, _, last = f"dolfinmpm.{name}".rpartition(".")
            kind = inspect.isclass(getattr(importlib.import_module(owner), last))
            lines += [f".. autoclass:: dolfinmpm.{name}", "   :members:", ""] if kind else []
            lines += [] if kind else [f".. autofunction:: dolfinmpm.{name}", ""]
        write(source / "reference" / "api" / f"{stem}.md", "\n".join([*lines, "```", ""]))
    index = ["# API", "", "`import dolfinmpm as mpm` gives all names below.", ""]
    for stem, page in pages.items():
        refs = ", ".join(f"{{py:obj}}`{name} <dolfinmpm.{name}>`" for name in page["names"])
        index += [f"**[{page['title']}](api/{stem}.md)**: {page['text']}", "", refs, ""]
    tree = "\n".join(f"api/{stem}" for stem in pages)
    index += ["```{toctree}", ":hidden:", tree, "```", ""]
    write(source / "reference" / "api.md", "\n".join(index))


def resolve(app: Any, env: Any, node: Any, content: nodes.Node) -> nodes.Node | None:
    """Links a type: names of the package by their last part, names of others to their pages."""
    if node.get("refdomain") != "py":
        return None
    target = node["reftarget"]
    last = target.rpartition(".")[2]
    if target.startswith("dolfinmpm.") or "." not in target:
        for part in PARTS:
            name = ".".join(filter(None, ("dolfinmpm", part, last)))
            found = env.domains["py"].objects.get(name)
            if found and name != target:
                return env.domains["py"].resolve_xref(
                    env, node["refdoc"], app.builder, "obj", name, node, content
                )
    if last in OTHERS:
        return nodes.reference("", "", content, internal=False, refuri=OTHERS[last])
    return None
