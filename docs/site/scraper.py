"""What a program has written to output/ goes to its page: pictures and films."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import judged
from sphinx_gallery.scrapers import figure_rst

VIDEO = """
.. raw:: html

    <video class="film" controls loop muted playsinline preload="metadata"
           src="{source}" aria-label="{label}"></video>
"""


class NewFiles:
    """Takes the pictures and films that are newer than the block of code before.

    sphinx-gallery calls it after each block of a program, in the folder of the program, and again
    for the next program. It knows figures of pyplot only; those of dolfinmpm are files.
    """

    def __init__(self) -> None:
        self.seen: dict[Path, int] = {}

    def __repr__(self) -> str:
        return "NewFiles"

    def __call__(self, block: Any, variables: dict[str, Any], conf: dict[str, Any]) -> str:
        folder = Path(variables["src_file"]).parent
        source = Path(conf["src_dir"])
        program = Path(variables["src_file"]).stem
        if entries := judged.judge(block[1], vars(variables["fake_main"])):
            judged.keep(program, entries)
        pictures, films = [], ""
        for file in sorted((folder / "output").glob("*")):
            if file.suffix not in {".png", ".gif", ".mp4"}:
                continue
            time = file.stat().st_mtime_ns
            if self.seen.get(file) == time:
                continue
            self.seen[file] = time
            target = Path(next(variables["image_path_iterator"]))
            if file.suffix == ".mp4":
                target = target.with_suffix(".mp4")
                shutil.copy(file, target)
                (source / "films").mkdir(exist_ok=True)
                shutil.copy(file, source / "films" / target.name)
                where = "../_static/films/" + target.name
                films += VIDEO.format(source=where, label=file.stem.replace("_", " "))
            else:
                target = target.with_suffix(file.suffix)
                shutil.copy(file, target)
                pictures.append(str(target))
        return figure_rst(pictures, str(source)) + films
