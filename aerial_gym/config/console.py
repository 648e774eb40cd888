"""Text for consoles of any encoding, with plain letters for other characters; the console of progress bars."""

import codecs
import json
import sys
import unicodedata
from importlib.util import find_spec
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console

PLAIN = "aerial_gym.plain"  # Name of the error handler for characters that an encoding lacks

SIGNS = {
    "→": "->", "←": "<-", "±": "+-", "×": "x", "·": "*", "−": "-", "–": "-", "—": "-", "≤": "<=", "≥": ">=", "≈": "~",
    "°": "deg", "µ": "u", "μ": "u", "∞": "inf", "∫": "int ", "Ω": "Ohm", "‘": "'", "’": "'", "“": '"', "”": '"',
}  # fmt: skip
"""Plain letters for signs that Unicode does not take apart."""


def ascii_fallback(error: UnicodeError) -> tuple[str, int]:
    """Return plain letters for unencodable characters and the next position, as an error handler of ``codecs``."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    missing = error.object[error.start : error.end]
    return "".join(SIGNS.get(sign) or _without_marks(sign) for sign in missing), error.end


def _without_marks(sign: str) -> str:
    """Return the ASCII letters of a character, ``?`` if it has none."""
    return unicodedata.normalize("NFKD", sign).encode("ascii", "ignore").decode("ascii") or "?"


def accept_any_console() -> None:
    """Make stdout and stderr replace characters outside their encoding by plain letters."""
    codecs.register_error(PLAIN, ascii_fallback)
    for stream in (sys.stdout, sys.stderr):
        reconfigure = getattr(stream, "reconfigure", None)
        if reconfigure is not None:
            reconfigure(errors=PLAIN)


def one_line(text: str) -> str:
    """Return a text with escapes in place of line breaks, control characters and bytes that are no UTF-8."""
    breaks = ("Cc", "Cs", "Zl", "Zp")
    return "".join(ascii(sign)[1:-1] if unicodedata.category(sign) in breaks else sign for sign in text)


def progress_console() -> "Console":
    """Return a console on the present stderr; bars are text in a notebook without ipywidgets, of which rich would complain."""
    from rich.console import Console

    console = Console(file=sys.stderr)
    if console.is_jupyter and find_spec("ipywidgets") is None:
        return Console(file=sys.stderr, force_jupyter=False, force_terminal=True)
    return console


def json_line(content: object, *, indent: int | None = None, allow_nan: bool = True) -> str:
    """Return JSON for stdout: characters that its encoding may lack are escaped, so that nothing is lost."""
    encoding = codecs.lookup(getattr(sys.stdout, "encoding", None) or "utf-8").name
    return json.dumps(content, ensure_ascii=not encoding.startswith("utf"), indent=indent, allow_nan=allow_nan)
