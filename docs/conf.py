"""How the documentation is built: ``python -m sphinx -W docs docs/_build``."""

import sys
from importlib.metadata import version as installed_version
from pathlib import Path

import mcrim_mitsuba  # noqa: F401  (before mitsuba: it chooses the LLVM library)
from mcrim_mitsuba.transport.variants import use_variant

sys.path.insert(0, str(Path(__file__).parent / "_extensions"))

# modules of `transport` derive from Mitsuba's classes, which a variant brings
use_variant()

project = "mcrim_mitsuba"
author = copyright = "The mcrim_mitsuba developers"
version = release = installed_version("mcrim-mitsuba")

extensions = [
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "myst_nb",
    "data_comments",
    "mathml",
    "python_reference",
]

exclude_patterns = ["_build"]
# `name` in a docstring links to what it names, where the reference has it
default_role = "py:obj"

add_module_names = False
autodoc_member_order = "bysource"
# docstrings have types and units in words
autodoc_typehints = "none"
autodoc_use_type_comments = False  # nobody writes any, and looking for them takes long
python_maximum_signature_line_length = 88
napoleon_google_docstring = False
# types are words and stay text: looking each of them up takes longer than all else
napoleon_use_param = napoleon_use_rtype = False
napoleon_custom_sections = [("Attributes", "params_style")]

myst_enable_extensions = ["dollarmath", "deflist", "colon_fence"]
myst_heading_anchors = 3
# notebooks are kept without outputs, which a build makes anew
nb_execution_timeout = 600
nb_execution_raise_on_error = True

html_math_renderer = "mathml"
html_theme = "furo"
html_title = f"mcrim_mitsuba {release}"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_copy_source = False
html_show_sourcelink = False
