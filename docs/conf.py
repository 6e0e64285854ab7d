"""The book: Sphinx reads Markdown, runs every notebook, and adds the pages that `book` generates.

Run `python -m sphinx -W docs docs/_build`; nothing is read from the network.
"""

import os
import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.parent)]
# The notebooks run in processes of their own: they find the cells' helpers, and one thread of BLAS.
os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, [str(HERE), os.environ.get("PYTHONPATH")]))
os.environ.setdefault("OMP_NUM_THREADS", "1")

import book

from pyomo_quad.version import __version__

project = "pyomo_quad"
author = "The pyomo_quad developers"
project_copyright = author
release = version = __version__

extensions = [
    "myst_nb",
    "numpydoc",
    "sphinx.ext.autodoc",
    "sphinx.ext.viewcode",
]
exclude_patterns = [
    "_build",
    "jupyter_execute",
    "**/.ipynb_checkpoints",
    "repository/reports/*/figures/*.md",
]
templates_path = []
default_role = "py:obj"

html_theme = "furo"
html_title = f"pyomo_quad {release}"
html_static_path = ["_static"]
html_css_files = ["book.css"]
html_math_renderer = "mathml"
html_copy_source = False
html_show_sphinx = False

myst_enable_extensions = ["amsmath", "colon_fence", "dollarmath"]
myst_heading_anchors = 4
myst_links_external_new_tab = False
suppress_warnings = ["myst.header", "misc.highlighting_failure"]

nb_execution_mode = "force"
nb_execution_in_temp = True
nb_execution_timeout = 1800
nb_execution_raise_on_error = True
nb_execution_show_tb = True
nb_merge_streams = True
nb_render_markdown_format = "myst"  # tables and formulas in outputs
nb_mime_priority_overrides = [("html", "image/png", 0)]

autodoc_typehints = "none"  # the numpydoc sections say the types
autodoc_member_order = "bysource"
numpydoc_show_class_members = False
linkcheck_ignore = [r"https?://.*"]  # built offline: links between pages are checked by Sphinx


def setup(app):
    """Generate the pages before Sphinx looks for files, and adapt each source as it is read."""
    book.generate(Path(app.srcdir))
    app.add_html_math_renderer(
        "mathml",
        inline_renderers=(book.visit_math, None),
        block_renderers=(book.visit_math_block, None),
    )
    app.connect("source-read", book.adapt_source)
    return {"parallel_read_safe": True}
