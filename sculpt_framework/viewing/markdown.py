"""Names and messages in the page's text, which is Markdown that may hold HTML."""

import re

_SPECIAL = re.compile(r"([\\`*_\[\]<>&~|#!])")


def plain(text: object) -> str:
    """Shown as it is, on one line, whatever Markdown or HTML it looks like."""
    return _SPECIAL.sub(r"\\\1", " ".join(str(text).split()))


def code(text: object) -> str:
    """Shown as an option of the command line; a backtick, which would end that, is left out."""
    return f"`{' '.join(str(text).replace('`', '').split())}`"
