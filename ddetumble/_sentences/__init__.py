"""All sentences about results: templates in the files beside this one, fed by the facts of a record."""

import functools
import re
from collections.abc import Mapping
from importlib import resources
from typing import Any


class Sentence(str):
    """A sentence that keeps what it was made from."""

    name: str  # of its template, `file.macro`
    facts: Mapping[str, Any]  # what the template was given


def say(name: str, /, **facts) -> Sentence:
    """The sentence of a template, on one line.

    Args:
        name: `file.macro` of a template in this folder.
        **facts: plain values that it tells.
    """
    sentence = Sentence(_join_lines(_render(name, facts)))
    sentence.name, sentence.facts = name, facts
    return sentence


def tell(name: str, /, **facts) -> list[str]:
    """The blocks of a template, which empty lines part: each on one line, but rows of a table on one each."""
    blocks = (block.strip() for block in re.split(r"\n\s*\n", _render(name, facts)))
    return [block if block.startswith("| ") else _join_lines(block) for block in blocks if block]


def _render(name: str, facts: Mapping[str, Any]) -> str:
    file, macro = name.split(".")
    return str(getattr(_load().get_template(f"{file}.jinja").module, macro)(**facts))


def _join_lines(text: str) -> str:
    return re.sub(r" ([;,.)])(?=\s|$)", r"\1", " ".join(text.split()))


def join_sentences(*parts: str) -> Sentence:
    """Sentences in a row; name and facts are those of the first."""
    joined = Sentence(" ".join(part for part in parts if part))
    joined.name, joined.facts = getattr(parts[0], "name", ""), getattr(parts[0], "facts", {})
    return joined


@functools.lru_cache(maxsize=1)
def _load():
    import jinja2

    from ..measurement import quantities as q

    def read(name: str) -> str:
        return resources.files(__package__ or "").joinpath(name).read_text(encoding="utf-8")

    environment = jinja2.Environment(loader=jinja2.FunctionLoader(read), undefined=jinja2.StrictUndefined)
    environment.filters |= {
        "words": q.join_words, "alternatives": lambda words: q.join_words(words, "or"), "percent": q.format_share,
        "name": lambda name: q.describe_quantity(name).name,
        "estimate": lambda one: q.format_estimate(one.estimate, one.sd, one.unit),
        "plain": q.format_plain,
        "g": lambda value, digits=3: f"{value:.{digits}g}", "f": lambda value, digits=2: f"{value:.{digits}f}",
        "signed": lambda value, digits=2: f"{value:.{digits}f}".replace("-", "−"),
        "begin": lambda text: text[:1].upper() + text[1:],
        "count": lambda number, noun: f"{number} {noun}{'' if number == 1 else 's'}",
    }
    return environment
