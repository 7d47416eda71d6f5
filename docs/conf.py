# SPDX-License-Identifier: Apache-2.0
"""Settings of the site; `make docs` builds it."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent / "_ext"))

import foretouch

project = "foretouch"
version = release = foretouch.__version__
copyright = "the foretouch developers, Apache-2.0"  # noqa: A001  the name is Sphinx's
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "foretouch_docs"]
html_theme = "furo"
html_title = "foretouch"

myst_heading_anchors = 3
autodoc_member_order = "bysource"
autodoc_typehints = "description"
autodoc_typehints_format = "short"
autodoc_typehints_description_target = "documented_params"
autodoc_preserve_defaults = True
napoleon_use_ivar = True
napoleon_attr_annotations = False
smartquotes = False
default_role = "literal"
