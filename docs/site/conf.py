"""Settings of Sphinx for the site; docs/build runs it."""

from __future__ import annotations

import os
import sys
from pathlib import Path

SITE = Path(__file__).resolve().parent
sys.path.insert(0, str(SITE))

import api
from scraper import NewFiles

import dolfinmpm

project = "dolfinmpm"
author = "The dolfinmpm developers"
copyright = author
version = release = dolfinmpm.__version__

extensions = [
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx.ext.intersphinx",
    "sphinx-mathjax-offline",
    "myst_nb",
    "sphinx_gallery.gen_gallery",
    "sphinx_codeautolink",
    "sphinxcontrib.bibtex",
    "sphinx_design",
    "sphinx_copybutton",
    "site_directives",
]
# The scraper is an object; a name inside of an f-string is not found by codeautolink.
suppress_warnings = ["config.cache", "codeautolink.match_name"]
nitpicky = False
exclude_patterns = [
    "**/GALLERY_HEADER.rst",
    "**/sg_execution_times.rst",
    "sg_execution_times.rst",
    "course/*.ipynb",
    "demos/*.ipynb",
]
root_doc = "index"

# text
myst_enable_extensions = ["dollarmath", "amsmath", "colon_fence", "deflist", "attrs_inline"]
myst_heading_anchors = 3
nb_execution_mode = "cache"
nb_execution_cache_path = str(SITE.parent / "_build" / "notebooks")
nb_execution_raise_on_error = True
bibtex_bibfiles = [str(SITE.parent / "references.bib")]
bibtex_default_style = "plain"
copybutton_exclude = ".linenos, .gp, .go"
mathjax3_config = {"chtml": {"displayAlign": "left", "displayIndent": "2em"}}

# API
default_role = "py:obj"
autodoc_member_order = "bysource"
autodoc_typehints = "description"
autodoc_typehints_format = "short"
autoclass_content = "class"
napoleon_numpy_docstring = False
napoleon_use_rtype = False
napoleon_use_ivar = True
napoleon_preprocess_types = True
inventory = SITE.parent / "_build" / "dolfinx.inv"
api.write_inventory(inventory)
intersphinx_mapping = {"dolfinx": (api.DOLFINX, str(inventory))}
codeautolink_autodoc_inject = False
codeautolink_concat_default = True
codeautolink_inventory_map = api.places()

# programs
wanted = os.environ.get("DOLFINMPM_SITE_EXAMPLES", r"\.py$")  # "none", or what fits their paths
run = wanted != "none"
programs = SITE.parent / "_build" / "programs"
sphinx_gallery_conf = {
    "examples_dirs": [str(programs / "course"), str(programs / "demos")],
    "gallery_dirs": ["course", "demos"],
    "filename_pattern": wanted,
    "plot_gallery": str(run),
    "image_scrapers": (NewFiles(),),
    "reset_modules": (),
    "parallel": os.process_cpu_count(),
    "capture_repr": (),
    "within_subsection_order": "FileNameSortKey",
    "download_all_examples": False,
    "remove_config_comments": True,
    "show_signature": False,
    "abort_on_example_error": True,
    "min_reported_time": 0,
    "show_memory": False,
    "copyfile_regex": r".*\.(csv|msh|txt)",
    "default_thumb_file": str(SITE / "static" / "thumbnail.png"),
}

# pages
html_theme = "pydata_sphinx_theme"
html_title = "dolfinmpm"
made = SITE.parent / "_build" / "static"
made.mkdir(parents=True, exist_ok=True)
html_static_path = ["static", str(made)]
html_favicon = "static/logo.svg"
html_domain_indices = False
html_css_files = ["site.css"]
html_js_files = ["gallery.js"]
templates_path = ["templates"]
html_show_sourcelink = False
html_copy_source = False
html_context = {"default_mode": "auto"}
html_theme_options = {
    "logo": {
        "text": "dolfinmpm",
        "image_light": "_static/logo.svg",
        "image_dark": "_static/logo.svg",
    },
    "navbar_align": "left",
    "header_links_before_dropdown": 8,
    "show_prev_next": True,
    "secondary_sidebar_items": ["page-toc"],
    "footer_start": ["copyright"],
    "footer_end": [],
    "navigation_with_keys": False,
    "show_toc_level": 2,
}
html_sidebars = {"index": []}
