"""Write the pages that are made from the code: `python -m docs.site_pages`.

The catalogue of effects, the reference of all public names, and `llms.txt`, an index of all pages. Equations and
sentences come from docstrings, so that a page cannot differ from what it describes.
"""

import inspect
import re
import sys
from pathlib import Path
from types import ModuleType

import ddetumble as dd
from ddetumble.contact.effect import AbstractEffect, Parameter
from ddetumble.families import FAMILIES, Family


FOLDER = Path(__file__).resolve().parent
NAMESPACES = [dd, *(one for name in dd.__all__ if isinstance(one := getattr(dd, name), ModuleType))]
BEFORE_CATALOGUE = """\
# The catalogue of effects

Physics that a reference model may be missing: law, parameters with what physics allows, source, and a picture of the
signature. `ddetumble effects` lists the same in a terminal, and `dd.effects` holds the classes.

In every picture grey is a record of a shipped campaign as the reference model has it, and blue the same with the
effect. Blue on the right is their difference, the *signature*; red is what is left of it when parameters and settings
are fitted again. The red part alone can be seen, and its share over the whole campaign, the *visible share*, stands
above it. Each effect is drawn at a size at which it leaves three times the noise, or as near to that as physics allows.

Parameters that are *held* stay at their value until freeing them predicts better; `--free` frees them in a fit by hand.
An effect of your own takes [ten lines](guide/own-effect.md).
"""
BEFORE_REFERENCE = """\
# Reference

Every public name, from its docstring. `import ddetumble as dd` is all that is needed: what is heavy is imported when it
is first used. Symbols, units and signs are those of the table below, everywhere.

"""


def list_public(module: ModuleType) -> list[str]:
    """Public names of a namespace that are no modules, in alphabetical order."""
    names = getattr(module, "__all__", None) or [name for name in vars(module) if not name.startswith("_")]
    return sorted(name for name in names if not isinstance(getattr(module, name), ModuleType))


def shorten(module: ModuleType) -> str:
    """Name of a namespace without those that it lies in."""
    return module.__name__.rpartition(".")[2]


def describe(module: ModuleType, name: str) -> str:
    """The first sentence on a public name: of its docstring, or of a constant in that of its namespace; '' if none."""
    thing = getattr(module, name)
    if inspect.isclass(thing) or inspect.isroutine(thing):
        text = thing.__doc__ or ""  # its own, not that of a class which it derives from
        return "" if text.startswith(f"{thing.__name__}(") else take_sentence(text)  # or of a dataclass by itself
    found = re.search(rf"^    {name}: (.+)$", module.__doc__ or "", re.M)
    return found[1][:1].upper() + found[1][1:] if found else ""


def take_sentence(text: str) -> str:
    """The first sentence of a text's first paragraph, on one line."""
    words = " ".join(text.strip().split("\n\n")[0].split())
    return re.split(r"(?<=\.)\s(?=[A-Z`])", words)[0].rstrip(":")


def write_reference(module: ModuleType) -> str:
    """The page of a namespace: a table of its names, then what Sphinx makes of their docstrings."""
    names = list_public(module)
    if module is dd:
        inner = {shorten(one): take_sentence(one.__doc__ or "") for one in NAMESPACES[1:]}
        lines = [BEFORE_REFERENCE, "| namespace | what it holds |", "| --- | --- |",
                 *(f"| [`dd.{short}`]({short}.md) | {text} |" for short, text in inner.items()),
                 "", "```{toctree}", ":hidden:", *inner, "```", ""]
    else:
        lines = [f"# `dd.{shorten(module)}`", "", (module.__doc__ or "").partition("\n\nAttributes:")[0].strip(), ""]
    lines += ["| name | what it is |", "| --- | --- |"]
    lines += [f"| `{name}` | {escape(describe(module, name))} |" for name in names]
    return "\n".join([*lines, "", "```{eval-rst}", f".. automodule:: {module.__name__}",
                      f"   :members: {', '.join(names)}", "   :show-inheritance:", "```", ""])


def escape(text: str) -> str:
    """Text as a cell of a table."""
    return text.replace("|", "\\|")


def write_catalogue() -> str:
    """The page of all effects, by the records on which they act."""
    lines = [BEFORE_CATALOGUE]
    for family in FAMILIES.values():
        lines += [f"## On {family.name} records", ""]
        others = [other for other in family.accepts if other != family.name]
        if others:
            lines += [f"The effects on {' and '.join(others)} records act on these, too.", ""]
        for effect in family.effects:
            lines += write_effect(effect, family)
    return "\n".join(lines)


def write_effect(effect: type[AbstractEffect], family: Family) -> list[str]:
    """Lines of one effect: what it is, its picture, its parameters and where it comes from."""
    needs = f" It needs {' and '.join(effect.requires)}." if effect.requires else ""
    rows = [f"| {write_parameter(p)} |" for p in dd.effects.parameters_of(effect)]
    return [f"### `{effect.id}`", "", (inspect.getdoc(effect) or "").split("\n\n")[0].replace("\n", " "), "",
            f"![Signature of {effect.id}](catalogue/{effect.id}.png)", "",
            "| parameter | unit | at first | what it is | physics allows |", "| --- | --- | --- | --- | --- |",
            *rows, "",
            f"Law: `{effect.law}`. Stage: {dd.effects.stage_of(effect)}.{needs} Source: {effect.reference}. "
            f"Class: `dd.effects.{effect.__name__}`.", ""]


def write_parameter(p: Parameter) -> str:
    """Cells of one parameter's row."""
    low, high = p.limits
    span = f"{low:g} to {high:g}" if high < float("inf") else f"at least {low:g}"
    allowed = f"{span}: {p.limits_reason}" if p.limits_reason else ""
    kind = "null" if p.kind == "amplitude" else "from"
    return " | ".join([f"`{p.name}`", f"{p.unit or '-'}", f"{kind} {p.default:g}{'' if p.free else ', held'}",
                       escape(p.text), escape(allowed)])


def read_page(path: Path) -> tuple[str, str]:
    """Title of a page of Markdown, and the first sentence below it."""
    head, _, rest = path.read_text(encoding="utf-8").partition("\n")
    text = re.sub(r"^```.*?^```", "", rest, flags=re.M | re.S)
    text = re.sub(r"^Made by `[^`]*`(: [^.]*)?\. ?", "", text, flags=re.M)
    text = re.sub(r"\*\*|\[([^\]]*)\]\([^)]*\)", r"\1", text)
    first = next((part for part in text.split("\n\n") if re.match(r"\s*[\w`]", part)), "")
    return head.lstrip("# "), take_sentence(first)


def write_index() -> str:
    """`llms.txt`: every page of the documentation, as it is on disk, with a line on it."""
    root = FOLDER.parent
    front = FOLDER / "index.md"
    listed = [*(root / path for path in ("README.md", "CONTRIBUTING.md", "data/README.md", "fits/README.md",
                                                "benchmarks/README.md")), *sorted(set(FOLDER.rglob("*.md")) - {front})]
    lines = [f"# {read_page(front)[0]}", "", f"> {read_page(front)[1]}", "", "Pages, relative to this file:", ""]
    for path in listed:
        title, sentence = read_page(path)
        lines.append(f"- [{title}]({path.relative_to(root).with_suffix('.html').as_posix()}): {sentence}")
    return "\n".join([*lines, ""])


def write_pages() -> dict[str, str]:
    """The pages, by name of their files below `docs`."""
    reference = {f"reference/{shorten(one)}.md": write_reference(one) for one in NAMESPACES}
    return {"catalogue.md": write_catalogue(), **reference}


if __name__ == "__main__":
    for page, text in write_pages().items():
        (FOLDER / page).write_text(text, encoding="utf-8")
        sys.stdout.write(f"{page}\n")
    (FOLDER / "site" / "llms.txt").write_text(write_index(), encoding="utf-8")
