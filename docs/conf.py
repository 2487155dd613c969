"""Configuration of the site: `make docs` builds it into `build/docs/html`."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

project = "xdex_drake"
author = "The xdex_drake authors"
copyright = author
extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx_copybutton",
    "sphinx_design",
    "site_checks",
]
exclude_patterns = ["generated/gallery_cards.md"]

html_theme = "furo"
html_title = "xdex_drake"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_show_copyright = False
html_copy_source = False
html_show_sourcelink = False

nb_execution_mode = "off"  # generate.py has executed them
myst_enable_extensions = ["colon_fence", "deflist"]
myst_heading_anchors = 3
copybutton_prompt_text = "$ "

default_role = "code"
autodoc_member_order = "bysource"
autodoc_preserve_defaults = True
autodoc_typehints = "none"  # site_checks.py gives signatures as they are written
python_use_unqualified_type_names = True
napoleon_use_ivar = True
napoleon_attr_annotations = False
napoleon_google_docstring = True
napoleon_numpy_docstring = False
