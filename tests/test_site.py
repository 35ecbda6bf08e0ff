"""The documentation: links lead somewhere, public names are explained, what is generated is current, and it builds."""

import dataclasses as dc
import importlib.util
import re
import subprocess
import sys
import types
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote

import pytest
from markdown_it import MarkdownIt

from ddetumble.effects import CATALOGUE
from docs import site_pages


ROOT = Path(__file__).resolve().parent.parent
DOCS = ROOT / "docs"
PAGES = sorted({*DOCS.rglob("*.md"), *(ROOT / "fits").rglob("*.md"), ROOT / "README.md", ROOT / "CONTRIBUTING.md",
                ROOT / "data" / "README.md", ROOT / "benchmarks" / "README.md"})
MADE = site_pages.write_pages()


def read_tokens(path):
    """Tokens of a page of Markdown, those inside of its lines included."""
    for token in MarkdownIt("commonmark").enable("table").parse(path.read_text(encoding="utf-8")):
        yield token
        yield from token.children or ()


def list_targets(path):
    """Files and anchors that a page links to or shows, and pages that its toctrees name."""
    for token in read_tokens(path):
        target = str(token.attrGet("href") or token.attrGet("src") or "")
        if target and not re.match(r"https?:|mailto:", target):
            name, _, anchor = unquote(target).partition("#")
            yield (path.parent / name).resolve() if name else path, anchor
        elif token.type == "fence" and token.info == "{toctree}":
            for name in token.content.splitlines():
                name = name.partition("<")[2].rstrip(">") or name  # a title may stand before it
                if name and not name.startswith(":") and "*" not in name:
                    yield (path.parent / f"{name}.md").resolve(), ""


def list_anchors(path):
    """Anchors of the headings of a page, as GitHub and MyST make them from their words."""
    tokens, found = list(read_tokens(path)), set()
    for head, line in zip(tokens, tokens[1:], strict=False):
        if head.type == "heading_open":
            words = "".join(child.content for child in line.children or ())
            found.add(re.sub(r"[^\w\- ]", "", words.lower()).replace(" ", "-"))
    return found


def find_dead(path):
    """Links of a page to what is no file, and to headings that are not there."""
    return [(target.name, anchor) for target, anchor in list_targets(path)
            if not target.is_file() or (anchor and target.suffix == ".md" and anchor not in list_anchors(target))]


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_links(path):
    """What a page links to is there."""
    assert not find_dead(path)


def test_links_that_are_dead_are_found(tmp_path):
    """Missing files, folders, missing headings, and pages that a toctree names."""
    page = tmp_path / "page.md"
    (tmp_path / "folder").mkdir()
    page = tmp_path / "page.md"
    page.write_text("# A `page` of links\n\n[a](gone.md) [b](folder) [c](#a-page-of-links) [d](page.md#none)\n\n"
                    "| t |\n| - |\n| ![e](gone.png) |\n\n```{toctree}\n:hidden:\nlost\n```\n", encoding="utf-8")
    assert find_dead(page) == [("gone.md", ""), ("folder", ""), ("page.md", "none"), ("gone.png", ""), ("lost.md", "")]


def test_every_page_is_reached():
    """From the front page, by links, one comes to all pages."""
    reached, waiting = set(), [DOCS / "index.md"]
    while waiting:
        page = waiting.pop()
        if page not in reached and page.suffix == ".md" and page.exists():
            reached.add(page)
            waiting += [target for target, _ in list_targets(page)]
    assert not {path for path in PAGES if path.is_relative_to(DOCS)} - reached


@pytest.mark.parametrize("module", site_pages.NAMESPACES, ids=lambda module: module.__name__)
def test_every_public_name_is_in_the_reference(module):
    """With a sentence on it, from its docstring."""
    page = MADE[f"reference/{site_pages.shorten(module)}.md"]
    names = site_pages.list_public(module)
    assert names
    assert not [name for name in names if not site_pages.describe(module, name)]
    assert not [name for name in names if f"| `{name}` | " not in page]


def test_names_without_a_docstring_are_found():
    """A function, a class that only inherits one, a dataclass that only shows its fields, and a constant."""
    module = types.ModuleType("own")
    vars(module).update(function=lambda: None, derived=type("derived", (site_pages.Family,), {}), constant=1,
                        record=dc.make_dataclass("record", ["field"]))
    assert site_pages.list_public(module) == ["constant", "derived", "function", "record"]
    assert not [name for name in site_pages.list_public(module) if site_pages.describe(module, name)]
    module.__doc__ = "A module.\n\nAttributes:\n    constant: one of them.\n"
    assert site_pages.describe(module, "constant") == "One of them."


@pytest.mark.parametrize("name", MADE)
def test_generated_pages_are_current(name):
    """`python -m docs.site_pages` would write what is there."""
    assert (DOCS / name).read_text(encoding="utf-8") == MADE[name]


def test_index_is_current():
    """`llms.txt` has every page with a line on it, and its links are those of the site."""
    text = site_pages.write_index()
    assert (DOCS / "site" / "llms.txt").read_text(encoding="utf-8") == text
    links = re.findall(r"^- \[.+?\]\((.+?)\.html\): (.+)$", text, re.M)
    assert {ROOT / f"{name}.md" for name, _ in links} >= {*DOCS.rglob("*.md")} - {DOCS / "index.md"}


def test_every_effect_has_its_picture():
    """The catalogue shows the signature of each effect, and of nothing else."""
    assert {path.stem for path in (DOCS / "catalogue").glob("*.png")} == {effect.id for effect in CATALOGUE}


class Outside(HTMLParser):
    """Collects what a page would load from elsewhere."""

    def __init__(self):
        super().__init__()
        self.found, self.equations = [], 0

    def handle_starttag(self, tag, attrs):
        self.equations += tag == "math"
        given = dict(attrs)
        loaded = given.get("src") if tag in ("script", "img", "iframe") else (
            given.get("href") if tag == "link" and given.get("rel") not in ("canonical", "author") else None)
        if loaded and re.match(r"(https?:)?//", loaded):
            self.found.append(loaded)


@pytest.mark.slow
def test_site_builds_strictly(tmp_path):
    """Sphinx has nothing to say, pages load nothing from elsewhere, and equations are MathML."""
    if not all(importlib.util.find_spec(name) for name in ("sphinx", "myst_nb", "furo")):
        pytest.skip("the site's generator is not installed; it comes with the extra `docs`")
    command = ["-m", "sphinx", "-W", "--keep-going", "-q", "-c", "docs", ".", str(tmp_path / "site")]
    done = subprocess.run([sys.executable, *command], cwd=ROOT, capture_output=True, text=True, timeout=500)
    assert done.returncode == 0, done.stderr
    equations = 0
    for page in (tmp_path / "site").rglob("*.html"):
        reader = Outside()
        reader.feed(page.read_text(encoding="utf-8"))
        assert not reader.found, page
        equations += reader.equations
    assert equations > 50
    assert (tmp_path / "site" / "llms.txt").exists() and (tmp_path / "site" / "index.html").exists()
