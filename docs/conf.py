"""The documentation as a site: ``sphinx-build -W docs outputs/site`` (``pip install -e '.[docs]'``)."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

import make_reference
from docutils.nodes import SkipNode
from latex2mathml.converter import convert

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


html_math_renderer = "mathml"


def write_inline_math(page, node) -> None:
    page.body.append(convert(node.astext()))
    raise SkipNode


def write_math_block(page, node) -> None:
    page.body.append(
        f'<div style="overflow: auto hidden; padding: 0.3em 0">{convert(node.astext(), display="block")}</div>'
    )
    raise SkipNode


def setup(app) -> None:
    """What is written by the code itself is made before the pages are read. Formulas need no script from elsewhere."""
    app.connect("builder-inited", lambda _: make_reference.main())
    app.add_html_math_renderer("mathml", (write_inline_math, None), (write_math_block, None))
