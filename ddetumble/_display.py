"""How results print: `str` gives the whole text, a notebook shows the same as prose and aligned tables."""

import abc
import html


class AbstractPrinted(abc.ABC):
    """A result that is printed by `str`, and by a notebook as HTML."""

    @abc.abstractmethod
    def __str__(self) -> str:
        """The whole result in words and aligned columns, the answer first."""

    def _repr_html_(self) -> str:
        return format_html(str(self))


def format_html(text: str) -> str:
    """A text of a terminal as HTML: its first block in bold, the others as they are aligned.

    Args:
        text: blocks with empty lines between them; everything is escaped.
    """
    first, *others = text.strip("\n").split("\n\n")
    return "\n".join(["<div>", f"<p><strong>{html.escape(' '.join(first.split()))}</strong></p>",
                      *(f"<pre>{html.escape(block)}</pre>" for block in others), "</div>"])
