"""README and site: code blocks run, links resolve, pages are reachable, and the site needs no network. A block of
language ``python`` or ``sh`` runs, block after block, in one folder for each page. A comment in front of a block
changes this: ``<!-- file: NAME -->`` writes it to a file, ``<!-- slow -->`` leaves it to the slow suite, and ``<!-- not
run: REASON -->`` leaves it out. Pages of results name commands for other machines, so that only blocks with ``<!--
compare -->`` run there: the slow suite compares their output with the page."""

import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from glob import glob
from html.parser import HTMLParser
from pathlib import Path

import pytest
from mkdocs.commands.build import build
from mkdocs.config import load_config

from aerial_gym.cli.main import main
from aerial_gym.robots import ROBOTS
from aerial_gym.robots.check import draw_rotors
from docs.generate.commands import command_page
from docs.generate.configuration import configuration_names, documented_names

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGES = [ROOT / "README.md", *sorted(DOCS.rglob("*.md"))]
MARKS = ("slow", "compare", "file: ", "not run: ")
COMMANDS = {"make golden"}  # Of the glossary: names that are commands


@dataclass(frozen=True)
class Block:
    """A fenced block of a page."""

    page: Path
    mark: str
    language: str
    text: str

    @property
    def runs(self) -> bool:
        """Whether the tests run or write it, fast or slow; commands of results are compared instead."""
        if DOCS / "results" in self.page.parents or self.mark.startswith("not run: "):
            return False
        return self.language in ("python", "sh") or self.mark.startswith("file: ")


def page_blocks(page: Path) -> list[Block]:
    fences = r"(?:^ *<!-- ([^\n]*?) -->\n+)?^ *```(\w*)[^\n]*\n(.*?)^ *```"
    fields = re.findall(fences, page.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    return [Block(page, mark if mark.startswith(MARKS) else "", language, text) for mark, language, text in fields]


def page_name(page: Path) -> str:
    return str(page.relative_to(ROOT))


def find_pages(mark: str) -> list[Path]:
    return [page for page in PAGES if any(block.mark == mark for block in page_blocks(page))]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, own_registries: None) -> Path:
    """Return an empty working folder with the examples and benchmarks of the repository."""
    for name in ("examples", "benchmarks"):
        (tmp_path / name).symlink_to(ROOT / name)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    return tmp_path


def run_commands(text: str, install_project: Callable[[Path], None]) -> None:
    for line in text.replace("\\\n", " ").splitlines():
        program, *words = shlex.split(line, comments=True) or [""]
        words = [path for word in words for path in (sorted(glob(word)) if "*" in word else [word])]
        if program == "aerial-gym":
            assert main(words) == 0, line
        elif program == "python":
            subprocess.run([sys.executable, *words], check=True)
        elif program == "pip" and len(words) == 2 and Path(words[1]).is_dir():
            install_project(Path(words[1]))
        else:
            assert not program, f"{line}: give the block the mark 'not run: REASON'"


def run_page(page: Path, install_project: Callable[[Path], None], *, slow: bool) -> None:
    names: dict = {"__name__": "__main__"}
    for block in filter(lambda block: block.runs, page_blocks(page)):
        if block.mark.startswith("file: "):
            path = Path(block.mark.removeprefix("file: "))
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(block.text, encoding="utf-8")
        elif block.mark == "slow" and not slow:
            continue
        elif block.language == "python":
            exec(compile(block.text, page_name(page), "exec"), names)
        else:
            run_commands(block.text, install_project)


@pytest.mark.parametrize("page", [page for page in PAGES if any(b.runs for b in page_blocks(page))], ids=page_name)
@pytest.mark.usefixtures("folder")
def test_blocks_of_a_page_run(page: Path, install_project: Callable[[Path], None]) -> None:
    run_page(page, install_project, slow=False)


@pytest.mark.slow
@pytest.mark.parametrize("page", find_pages("slow"), ids=page_name)
@pytest.mark.usefixtures("folder")
def test_all_blocks_of_a_page_run(page: Path, install_project: Callable[[Path], None]) -> None:
    run_page(page, install_project, slow=True)


@pytest.mark.slow
@pytest.mark.parametrize("page", find_pages("compare"), ids=page_name)
@pytest.mark.usefixtures("folder")
def test_figures_of_a_page_are_those_of_its_command(page: Path) -> None:
    numbers = r"-?\d+(?:\.\d+)?(?:e[-+]?\d+)?"
    text = re.findall(numbers, page.read_text(encoding="utf-8"))
    for block in page_blocks(page):
        if block.mark == "compare":
            command = shlex.split(block.text.replace("\\\n", " "))
            done = subprocess.run([sys.executable, *command[1:]], check=True, capture_output=True, text=True)
            rest = iter(text)
            missing = [number for number in re.findall(numbers, done.stdout) if number not in rest]
            assert not missing, f"{page_name(page)}: printed by {block.text}, but not on the page: {missing[:5]}"


@pytest.mark.parametrize("page", PAGES, ids=page_name)
def test_every_block_names_its_language(page: Path) -> None:
    assert all(block.language for block in page_blocks(page))


def test_names_and_pages_that_pages_and_code_name_exist() -> None:
    files = (path for path in (ROOT / "aerial_gym").rglob("*.*") if path.suffix in (".py", ".yaml"))
    words = set(re.findall(r"\w+", " ".join(path.read_text(encoding="utf-8") for path in files)))
    definitions = re.findall(r"Code:(.*?)(?:\n\n|\Z)", (DOCS / "glossary.md").read_text(encoding="utf-8"), re.DOTALL)
    names = {name for text in definitions for name in re.findall(r"`([^`]+)`", text)}
    parts = {name: re.findall(r"\w+", name) for name in names - COMMANDS}
    assert not [name for name, pieces in parts.items() if not words.issuperset(pieces)]
    files = [path for folder in ("aerial_gym", "benchmarks", "examples") for path in (ROOT / folder).rglob("*.*")]
    texts = (path.read_text(encoding="utf-8") for path in files if path.suffix in (".py", ".yaml"))
    named = {page for text in texts for page in re.findall(r"\bdocs/[\w/]+\.md", text)}
    assert not [page for page in sorted(named) if not (ROOT / page).is_file()]


def test_pages_are_short() -> None:
    """README has at most 70 lines, and a page that is no result some 1,500 words outside of code."""
    assert len((ROOT / "README.md").read_text(encoding="utf-8").splitlines()) <= 70
    for page in (page for page in PAGES if DOCS / "results" not in page.parents):
        text = re.sub(r"^ *```.*?^ *```", "", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
        assert len(text.split()) <= 1_650, page_name(page)


class External(HTMLParser):
    """Collects what a page loads from a network."""

    def __init__(self) -> None:
        super().__init__()
        self.urls: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        values = dict(attrs)
        loads = tag in ("script", "img", "iframe", "source") or (tag == "link" and values.get("rel") != "canonical")
        urls = (values.get("src"), values.get("href")) if loads else ()
        self.urls += [url for url in urls if url and url.startswith(("http:", "https:", "//"))]


def test_the_site_is_complete_and_loads_nothing_from_a_network(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Robots share the drawing of one; ``unit/robots/check/test_picture.py`` draws others."""
    drawing = tmp_path / "quadrotor.svg"
    draw_rotors(ROBOTS.get("base_quadrotor"), drawing)
    monkeypatch.setattr("aerial_gym.robots.check.draw_rotors", lambda robot, path: shutil.copy(drawing, path))
    monkeypatch.setenv("NO_MKDOCS_2_WARNING", "1")
    site = tmp_path / "site"
    config = load_config(str(ROOT / "mkdocs.yml"), site_dir=str(site))
    assert config.strict
    config.plugins.on_startup(command="build", dirty=False)
    build(config)
    assert [record.message for record in caplog.records if record.levelname in ("WARNING", "ERROR")] == []
    assert not external_urls(site)
    index = (site / "search" / "search_index.js").read_text(encoding="utf-8")
    pages = (page.relative_to(DOCS).with_suffix(".html").as_posix() for page in DOCS.rglob("*.md"))
    assert not [page for page in pages if f'"location":"{page}"' not in index]
    assert 'id="base_quadrotor"' in (site / "reference" / "robots.html").read_text(encoding="utf-8")
    assert (site / "reference" / "pictures" / "base_quadrotor.svg").is_file()


def external_urls(site: Path) -> list[str]:
    """Return the addresses of scripts, styles, images and fonts that a site loads from a network."""
    parser = External()
    for page in site.rglob("*.html"):
        parser.feed(page.read_text(encoding="utf-8"))
    styles = "".join(path.read_text(encoding="utf-8") for path in site.rglob("*.css"))
    return parser.urls + re.findall(r"(?:url\(|@import)\s*[\"']?((?:https?:)?//[^\"')]*)", styles)


def test_external_urls_are_those_that_a_page_loads(tmp_path: Path) -> None:
    page = '<script src="https://a/x.js"></script><link href="//b/y.css"><a href="https://c"></a><img src="z.png">'
    (tmp_path / "page.html").write_text(page, encoding="utf-8")
    style = "@font-face { src: url('https://d/f.woff') } i { src: url(g.woff) }"
    (tmp_path / "style.css").write_text(style, encoding="utf-8")
    assert external_urls(tmp_path) == ["https://a/x.js", "//b/y.css", "https://d/f.woff"]


def test_every_option_of_a_command_has_a_meaning() -> None:
    assert [line for line in command_page().splitlines() if line.endswith("|  |")] == []


def test_every_configuration_class_is_in_the_reference() -> None:
    assert configuration_names() <= documented_names()
