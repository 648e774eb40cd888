"""Text of the pages: README, CONTRIBUTING and ``docs``; words of sentences and tables, headings and links."""

import re
from collections.abc import Iterator
from functools import cache
from typing import NamedTuple

from tests.language.names import ROOT

WORD = re.compile(r"[A-Za-z][A-Za-z'-]*")
LINK = re.compile(r"!?\[([^\]]*)\]\(<?([^)\s>]*)>?[^)]*\)")
ADDRESS = re.compile(r"<(?:img|a|source)\b[^>]*?\b(?:src|href)=[\"']([^\"']+)")
REFERENCE = re.compile(r"^\[[^\]]+\]:\s*(\S+)", re.MULTILINE)
ITEM = re.compile(r"\s*(?:[-*+]|\d+\.)\s+")


class PageLine(NamedTuple):
    """A line outside of code blocks: heading, table row, item of a list, blank line or text."""

    kind: str
    text: str


@cache
def pages() -> dict[str, str]:
    """Return the text of each page by its path."""
    files = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
    return {file.relative_to(ROOT).as_posix(): file.read_text("utf-8") for file in files}


@cache
def menu() -> list[str]:
    """Return the pages of the site's menu; those below ``docs/reference`` are generated, and not in the repository."""
    names = re.findall(r"^\s+- (?:.*: )?(\S+\.md)$", (ROOT / "mkdocs.yml").read_text("utf-8"), re.M)
    return [f"docs/{name}" for name in names]


def prose_lines(text: str) -> Iterator[str]:
    """Yield the lines outside of code blocks; a blank line stands for each block."""
    fence = ""
    for line in text.splitlines():
        mark = re.match(r"\s*(```+|~~~+)", line)
        if mark and not fence:
            fence = mark[1]
            yield ""
        elif fence:
            fence = "" if line.strip() == fence else fence
        else:
            yield line


def lines(text: str) -> Iterator[PageLine]:
    """Yield the lines of a page outside of code blocks."""
    for line in prose_lines(text):
        if not line.strip():
            yield PageLine("blank", "")
        elif re.match(r"#+ ", line):
            yield PageLine("heading", line.lstrip("# "))
        elif line.lstrip().startswith("|"):
            yield PageLine("table", line)
        elif ITEM.match(line):
            yield PageLine("item", ITEM.sub("", line, count=1))
        else:
            yield PageLine("text", line)


def plain(text: str) -> str:
    """Return a text with one word for each inline code, and the text of each link."""
    return LINK.sub(r"\1", re.sub(r"`[^`]*`", "x", text))


def paragraphs(text: str) -> Iterator[str]:
    """Yield the paragraphs and items of lists of a page; neither headings nor tables."""
    block: list[str] = []
    for line in [*lines(text), PageLine("blank", "")]:
        if line.kind != "text" and block:
            yield plain("\n".join(block))
            block = []
        if line.kind in ("text", "item"):
            block.append(line.text)


def sentences(text: str) -> list[str]:
    """Return the sentences of at least three words; a sentence ends at a full stop, question or exclamation mark."""
    parts = (part for paragraph in paragraphs(text) for part in re.split(r"[.!?](?:\s|$)", paragraph))
    return [part.strip() for part in parts if count(part) >= 3]


def count(text: str) -> int:
    """Return the number of words."""
    return len(WORD.findall(text))


def mean_length(text: str) -> float:
    """Return the mean number of words of a sentence; 0 for a page without sentences."""
    lengths = [count(sentence) for sentence in sentences(text)]
    return sum(lengths) / len(lengths) if lengths else 0.0


def table_share(text: str) -> float:
    """Return the share of a page's words that stand in tables."""
    numbers = [(line.kind == "table", count(plain(line.text))) for line in lines(text)]
    total = sum(number for _, number in numbers)
    return sum(number for table, number in numbers if table) / total if total else 0.0


def targets(text: str) -> list[str]:
    """Return the addresses of links and images, outside of code, that lie in the repository."""
    body = re.sub(r"`[^`\n]*`", "", "\n".join(prose_lines(text)))
    addresses = [*(match[2] for match in LINK.finditer(body)), *ADDRESS.findall(body), *REFERENCE.findall(body)]
    return [address for address in addresses if not re.match(r"[a-z]+:", address)]


def anchors(text: str) -> set[str]:
    """Return the anchors of a page's headings, as GitHub and mkdocs write them, and those set by hand."""
    result = {anchor for pair in re.findall(r"\bid=[\"']([^\"']+)|\{\s*#([\w-]+)", text) for anchor in pair if anchor}
    repeats: dict[str, int] = {}
    for heading in (line.text for line in lines(text) if line.kind == "heading"):
        bare = re.sub(r"[^\w\s-]", "", LINK.sub(r"\1", heading)).strip().lower()
        for anchor, mark in ((re.sub(r"\s", "-", bare), "-"), (re.sub(r"[-\s]+", "-", bare), "_")):
            number = repeats[anchor + mark] = repeats.get(anchor + mark, -1) + 1
            result.add(f"{anchor}{mark}{number}" if number else anchor)
    return result


def dead_links(path: str, text: str) -> list[str]:
    """Return the links of a page whose file or anchor does not exist; the site build checks those of the reference."""
    wrong = []
    for target in targets(text):
        name, _, anchor = target.partition("#")
        file = ((ROOT / path).parent / name).resolve() if name else ROOT / path
        if file.is_relative_to(ROOT / "docs/reference") and file.relative_to(ROOT).as_posix() in menu():
            continue
        if not file.exists() or (anchor and anchor not in anchors(file.read_text("utf-8"))):
            wrong.append(target)
    return wrong


def reachable() -> set[str]:
    """Return the pages that a chain of links reaches from README or the site's menu."""
    reached: set[str] = set()
    waiting = [path for path in ("README.md", *menu()) if path in pages()]
    while waiting:
        path = waiting.pop()
        reached.add(path)
        for target in targets(pages()[path]):
            file = ((ROOT / path).parent / target.partition("#")[0]).resolve()
            linked = file.relative_to(ROOT).as_posix() if file.is_relative_to(ROOT) else ""
            if linked in pages() and linked not in reached:
                waiting.append(linked)
    return reached
