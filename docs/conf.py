"""How `make docs` builds the pages: Sphinx, offline, every warning an error."""

import argparse
import os
import re
from pathlib import Path

from docutils import nodes
from docutils.parsers.rst import Directive

from bsp_gp import __version__
from bsp_gp.cli_options import build_parser

os.environ["COLUMNS"] = "96"  # width of the help of commands
project = "bsp_gp"
author = "bsp_gp contributors"
release = __version__
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx_copybutton"]
html_theme = "furo"
html_title = "bsp_gp"
html_show_sourcelink = False
html_show_copyright = False
myst_heading_anchors = 3
autodoc_typehints = "none"
autodoc_default_options = {"members": True}
napoleon_google_docstring = False
napoleon_use_rtype = False

_OTHERS = "OTHER PAGES"
_HERE = Path(__file__).parent


class Commands(Directive):
    """The help of every command, a section each."""

    def run(self):
        """Return the sections."""
        return [_section(parser) for parser in _parsers(build_parser())]


def _parsers(parser):
    """The parsers of commands, and of their actions, that have none below them."""
    below = [a for a in parser._actions if isinstance(a, argparse._SubParsersAction)]
    if not below:
        return [parser]
    return [p for action in below for each in action.choices.values() for p in _parsers(each)]


def _section(parser):
    section = nodes.section(ids=[nodes.make_id(parser.prog)])
    section += nodes.title(text=parser.prog)
    section += nodes.literal_block(text=parser.format_help(), language="none")
    return section


def _adopt(app, name, source):
    """Put pages that the index does not name in their place in it."""
    if name != "index":
        return
    named = set(re.findall(r"^[\w/-]+$", source[0], re.MULTILINE))
    pages = (p.relative_to(_HERE).with_suffix("").as_posix() for p in sorted(_HERE.rglob("*.md")))
    rest = [p for p in pages if p not in named and p != "index" and not p.startswith("gallery/")]
    source[0] = source[0].replace(_OTHERS, "\n".join(rest))


def setup(app):
    """Add what is ours to Sphinx."""
    app.add_directive("commands", Commands)
    app.connect("source-read", _adopt)
    return {"parallel_read_safe": True}
