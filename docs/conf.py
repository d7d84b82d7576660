"""How the pages become a site: ``tools/site``."""

from smarttac_can import __version__

project = "SMARTTAC CAN"
author = "The SMARTTAC CAN authors"
copyright = author
release = __version__
extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "numpydoc",
    "sphinx.ext.viewcode",
    "sphinx_external_toc",
]
html_theme = "furo"
html_title = f"{project} {release}"
html_last_updated_fmt = None
exclude_patterns = ["conf.py"]
external_toc_path = "_toc.yml"
# Pages are Markdown as a code host shows it, with links to headings.
myst_heading_anchors = 4
# A name in single backticks is Python's in docstrings; what has no page stays a name.
default_role = "py:obj"
autodoc_typehints = "signature"
autodoc_member_order = "bysource"
autodoc_default_options = {"members": True, "show-inheritance": True}
numpydoc_show_class_members = False
