"""How the documentation becomes a site: ``make docs``."""

from __future__ import annotations

import sys
from importlib.metadata import version as version_of
from pathlib import Path

from stkzoo._installation import project_url

sys.path.insert(0, str(Path(__file__).parent / "_extensions"))

project = "stkzoo"
author = "the stkzoo developers"
project_copyright = f"the game's pictures: the SuperTuxKart team; all else: {author}"
release = version = version_of("stkzoo")

extensions = [
    "generated_pages",
    "internal_links",
    "outside_links",
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
    "sphinx_copybutton",
    "sphinx_design",
]
exclude_patterns = ["_build", "_extensions", "schemas"]

# Markdown
myst_enable_extensions = ["attrs_inline", "colon_fence", "deflist", "fieldlist"]
myst_heading_anchors = 4
myst_url_schemes = ("http", "https", "mailto")

nb_execution_mode = "off"  # `python docs/_extensions/tutorials.py` runs them

# The reference, from docstrings in Google's form
add_module_names = False
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_typehints_format = "short"
autodoc_preserve_defaults = True
autodoc_default_options = {"members": True}
napoleon_numpy_docstring = False
napoleon_use_ivar = True
python_use_unqualified_type_names = True
python_maximum_signature_line_length = 88

# The site
html_theme = "furo"
html_title = f"stkzoo {version}"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_logo = html_favicon = "_static/logo.svg"
html_show_sphinx = False
html_show_sourcelink = False
html_theme_options = {
    "source_repository": project_url("Repository"),
    "source_branch": "main",
    "source_directory": "docs/",
    "footer_icons": [
        {"name": "Repository", "url": project_url("Repository"), "html": "Repository"}
    ],
    "sidebar_hide_name": False,
    "light_css_variables": {
        "color-brand-primary": "#0b6bcb",
        "color-brand-content": "#0b6bcb",
    },
    "dark_css_variables": {
        "color-brand-primary": "#6cb6ff",
        "color-brand-content": "#6cb6ff",
    },
}
pygments_style = "friendly"
pygments_dark_style = "github-dark"
copybutton_prompt_text = r">>> |\.\.\. |\$ "
copybutton_prompt_is_regexp = True
