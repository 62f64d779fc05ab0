"""Directives and hooks of the site: the errors' index, the plain program of a lecture."""

from __future__ import annotations

import inspect
import re
import shutil
from pathlib import Path
from typing import Any

import api
import cards
import measured
import runtimes
from sphinx.util.inspect import stringify_signature

SITE = Path(__file__).resolve().parent
ROOT = SITE.parents[1]


def plain(program: str) -> str:
    """The program without its texts, as one would type it."""
    body = re.sub(r'^"""(.|\n)*?"""\n', "", program, count=1)
    kept, text = [], False
    for line in body.split("\n"):
        text = line.startswith("# %%") or (text and line.startswith("#"))
        if not text:
            kept.append(line)
    return re.sub(r"\n{3,}", "\n\n", "\n".join(kept)).strip() + "\n"


def add_program(app: Any, name: str, source: list[str]) -> None:
    """Gives each step of the course its plain program at the end."""
    program = ROOT / "docs" / f"{name}.py"
    if not name.startswith("course/") or not program.exists():
        return
    lines = "\n".join(f"    {line}" for line in plain(program.read_text()).split("\n"))
    block = f".. code-block:: python\n    :class: plain-program\n\n{lines}\n"
    whole = f"The plain program\n-----------------\n\n{block}"
    mark = ".. _sphx_glr_download"
    before, found, after = source[0].partition(mark)
    source[0] = f"{before}\n{whole}\n{found}{after}"


def offer_files(app: Any, name: str, source: list[str]) -> None:
    """Links to files of the repository outside docs/ become downloads."""

    def download(link: re.Match[str]) -> str:
        file = (ROOT / "docs" / name).parent.joinpath(link[2]).resolve()
        if not file.is_file() or file.is_relative_to(ROOT / "docs"):
            return link[0]
        target = Path(app.srcdir) / "files" / file.relative_to(ROOT)
        target.parent.mkdir(parents=True, exist_ok=True)
        if not target.exists() or target.read_bytes() != file.read_bytes():
            shutil.copy(file, target)
        text = link[1].replace("`", "")
        return f"{{download}}`{text} </files/{file.relative_to(ROOT)}>`"

    source[0] = re.sub(r"\[([^\[\]]+)\]\((\.\./[^)\s#]+)\)", download, source[0])


def read_plainly(
    app: Any, what: str, name: str, thing: Any, options: Any, lines: list[str]
) -> None:
    """Docstrings are plain text: bars are absolute values, code is indented after a colon."""
    # Sphinx removes flags of doctest from the page, and codeautolink would not find the block there
    lines[:] = [re.sub(r" *# doctest: .*", "", line) for line in lines]
    lines[:] = [re.sub(r"(?<!\\)\|", r"\\|", line) for line in lines]
    for i, line in enumerate(lines[:-2]):
        after = lines[i + 2]
        deeper = len(after) - len(after.lstrip()) > len(line) - len(line.lstrip())
        if re.search(r"[^:]:$", line) and not lines[i + 1].strip() and after.strip() and deeper:
            lines[i] = f"{line}:"


def show_arguments(app: Any, what: str, name: str, thing: Any, *_: Any) -> tuple[str, str] | None:
    """The arguments of a class are those of its __init__, whatever __new__ takes."""
    if what != "class":
        return None
    try:
        return stringify_signature(inspect.signature(thing), show_annotation=False), ""
    except (TypeError, ValueError):
        return None


def setup(app: Any) -> dict[str, bool]:
    app.add_directive("gallery", cards.Gallery)
    app.add_directive("measured", measured.Measured)
    app.add_directive("runtimes", runtimes.RunTimes)
    app.connect("autodoc-process-docstring", read_plainly)
    app.connect("autodoc-process-signature", show_arguments)
    app.connect("missing-reference", api.resolve)
    app.connect("source-read", add_program)
    app.connect("source-read", offer_files)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
