"""How the pages become a site: ``tools/docs``."""

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
    "sphinx_gallery.gen_gallery",
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
# Each script of the gallery runs, and becomes a page with its figure, a script and a notebook.
sphinx_gallery_conf = {
    "examples_dirs": "../examples/gallery",
    "gallery_dirs": "gallery",
    "within_subsection_order": "FileNameSortKey",
    "abort_on_example_error": True,
    "show_memory": False,
    "write_computation_times": False,
    "min_reported_time": float("inf"),
    "download_all_examples": False,
    "show_signature": False,
}
# The index of the gallery has a tree of its own beside that of _toc.yml.
suppress_warnings = ["etoc.toctree"]
