"""Sphinx configuration. `make docs` builds docs/_build; warnings are errors there."""

import sys
from pathlib import Path

from jaxisp import __version__

sys.path.insert(0, str(Path(__file__).parent))

project = "jaxisp"
author = "the jaxisp authors"
project_copyright = author
release = version = __version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "generated"]
exclude_patterns = ["_build", "_static", "**/_*"]
myst_enable_extensions = ["colon_fence", "deflist"]
myst_heading_anchors = 3

autodoc_member_order = "groupwise"
autodoc_typehints = "signature"
autodoc_preserve_defaults = True
napoleon_numpy_docstring = False
napoleon_use_ivar = True
napoleon_custom_sections = [("Gradient", "notes_style"), ("Source", "notes_style")]

html_theme = "furo"
html_title = f"jaxisp {release}"
html_show_sphinx = False
html_static_path = ["_static"]
html_css_files = ["code.css"]
