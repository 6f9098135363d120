"""Sphinx configuration: Markdown pages, the Python interface from the docstrings."""

from importlib.metadata import version as installed_version

project = "deshybrid"
author = "the deshybrid developers"
copyright = "2026, the deshybrid developers"  # noqa: A001
version = release = installed_version("deshybrid")
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx.ext.viewcode"]
myst_enable_extensions = ["colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 3
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
napoleon_google_docstring = False
exclude_patterns = ["_build"]
html_theme = "furo"
html_title = "deshybrid"
