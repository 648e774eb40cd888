"""MkDocs hook: adds the generated reference and the examples to the site."""

import re
from pathlib import Path
from tempfile import TemporaryDirectory

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

from aerial_gym.robots import ROBOTS
from aerial_gym.robots.check import draw_rotors
from docs.generate.api import api_pages
from docs.generate.commands import command_page
from docs.generate.configuration import configuration_pages
from docs.generate.markdown import page
from docs.generate.registries import registry_pages

ROOT = Path(__file__).parents[2]


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the generated pages and pictures, and the files that pages link to outside ``docs/``."""
    pages = {"commands.md": command_page()} | configuration_pages() | registry_pages() | api_pages()
    pages["index.md"] = _index(pages)
    for path, text in pages.items():
        files.append(File.generated(config, f"reference/{path}", content=text))
    for name, picture in _pictures().items():
        files.append(File.generated(config, f"reference/pictures/{name}.svg", content=picture))
    for example in sorted((ROOT / "examples").rglob("*")):
        if example.suffix in (".py", ".yaml"):
            path = example.relative_to(ROOT).as_posix() + ".txt"
            files.append(File.generated(config, path, content=example.read_text(encoding="utf-8")))
    return files


def on_page_markdown(markdown: str, page: Page, **_: object) -> str:
    """Point links to examples at their copies in the site: ``../../examples/x.py`` becomes ``../examples/x.py.txt``."""
    up = "../" * page.file.src_uri.count("/")
    return re.sub(r"\]\((?:\.\./)+(examples/[\w/]+\.(?:py|yaml))\)", rf"]({up}\1.txt)", markdown)


def _index(pages: dict[str, str]) -> str:
    links = (f"- [{text.partition(chr(10))[0].removeprefix('# ')}]({path})" for path, text in pages.items())
    introduction = "For everyone who looks up a name. All pages of this part are generated from the code."
    return page("Reference", introduction, ["\n".join(links)])


def _pictures() -> dict[str, str]:
    """Return a drawing of the rotors of each registered robot; robots with equal rotors share one."""
    drawings: dict[object, str] = {}
    pictures = {}
    with TemporaryDirectory() as folder:
        path = Path(folder) / "rotors.svg"
        for name in ROBOTS.names():
            robot = ROBOTS.get(name)
            rotors = (robot.mounts.layout, robot.body.com, tuple(rotor.radius for rotor in robot.rotor_types))
            if rotors not in drawings:
                draw_rotors(robot, path)
                drawings[rotors] = path.read_text(encoding="utf-8")
            pictures[name] = drawings[rotors]
    return pictures
