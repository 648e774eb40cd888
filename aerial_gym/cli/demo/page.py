"""The page of the demo."""

from pathlib import Path
from typing import Any

import jinja2

TEMPLATES = Path(__file__).parents[1] / "templates"


def write_page(path: Path, **content: Any) -> Path:
    """Write the page from its sections and return its path."""
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(TEMPLATES), autoescape=True, undefined=jinja2.StrictUndefined
    )
    path.write_text(
        environment.get_template("demo.html.j2").render(**content), encoding="utf-8", errors="surrogateescape"
    )
    return path
