"""The documentation as a site: ``sphinx-build -W docs outputs/site`` (``pip install -e '.[docs]'``)."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

import make_reference

from sculpt_framework import __version__

project = "Gaussian Sculpting"
author = copyright = "the Gaussian Sculpting project"
version = release = __version__
extensions = ["myst_parser", "sphinx.ext.autodoc"]
# Pages of the repository that are read with it, not with the site.
exclude_patterns = ["blender_captures"]
html_theme = "furo"
html_title = f"Gaussian Sculpting {version}"
html_copy_source = False
myst_heading_anchors = 3
myst_enable_extensions = ["dollarmath"]
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_preserve_defaults = True


def setup(app) -> None:
    """What is written by the code itself is made before the pages are read."""
    app.connect("builder-inited", lambda _: make_reference.main())
