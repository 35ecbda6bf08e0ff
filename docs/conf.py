"""How the documentation is built, by Sphinx: `python3 run.py site`.

Pages are those that Markdown links reach anyway, so that the same files are read in the repository and on the site.
Equations become MathML when the site is built: no script and no network are needed to read them.
"""

import re

from docutils import nodes
from math_core import LatexToMathML
from pygments.lexers.special import TextLexer

import ddetumble


project, author, copyright = "ddetumble", "The ddetumble developers", "The ddetumble developers, MIT licence"
version = release = ddetumble.__version__
extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
root_doc = "docs/index"
include_patterns = ["*.md", "docs/**", "fits/**", "data/README.md", "benchmarks/README.md", "notebooks/*"]
exclude_patterns = [".*", "build", "docs/site", "docs/static"]
html_theme, html_title = "furo", "ddetumble"
html_extra_path = ["site"]  # llms.txt, and the way from the top to the front page
html_static_path, html_css_files = ["static"], ["look.css"]
html_copy_source = html_show_sourcelink = False
highlight_language = "none"  # of blocks that name no language
pygments_style = "friendly"
# That links lead to every page is checked by tests/test_site.py; `title` in a docstring may be one of several.
suppress_warnings = ["toc.not_included", "ref.python"]
myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 4  # made from the words of a heading, as GitHub makes them
nb_execution_mode = "off"  # what notebooks show is kept in them
default_role = "py:obj"  # `names` of docstrings lead to what they name, where the reference has it
autodoc_member_order = "groupwise"
autodoc_typehints = "signature"
python_maximum_signature_line_length = 120
napoleon_use_ivar, napoleon_attr_annotations = True, False


def draw_equation(block: bool):
    """A visitor that writes an equation as MathML, in a line of text or as a block; LaTeX that it cannot read fails."""
    def visit(translator, node):
        converter = LatexToMathML()
        translator.body.append(converter.convert_with_local_state(node.astext(), displaystyle=block))
        raise nodes.SkipNode
    return visit, None


def convert_docstring(app, what, name, thing, options, lines):
    """From docstrings to what Sphinx wants: equations between dollars, bars that are bars, code that is indented."""
    if what == "module" and name != "ddetumble":  # its page begins with it
        lines.clear()
    parts = re.split(r"\$([^$]+)\$", "\n".join(lines))  # text and equations in turn
    parts = [f":math:`{part}`" if k % 2 else part.replace("|", r"\|") for k, part in enumerate(parts)]
    lines[:] = re.sub(r":\n\n(?=    )", r"::\n\n", "".join(parts)).split("\n")


def setup(app):
    """Tell Sphinx of both, and that tables of numbers are plain text."""
    app.add_html_math_renderer("mathml", draw_equation(False), draw_equation(True))
    app.config.html_math_renderer = "mathml"
    app.connect("autodoc-process-docstring", convert_docstring)
    app.add_lexer("csv", TextLexer)
