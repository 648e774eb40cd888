"""Pages of one design: self-contained HTML files from ``templates/base.html.j2``, and Markdown."""

from collections.abc import Mapping
from pathlib import Path

from aerial_gym.sim2real.report.tables import format_rise, interval_text, number_text, percent_text
from aerial_gym.sim2real.wording import join_texts, text

TEMPLATES = Path(__file__).parent / "templates"


def write_page(path: Path, name: str, context: Mapping[str, object], folder: Path = TEMPLATES) -> None:
    """Write a page from the template ``name`` of a folder, which may extend the templates of this package."""
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    environment = Environment(
        loader=FileSystemLoader([folder, TEMPLATES]), autoescape=name.endswith(".html"), undefined=StrictUndefined,
        trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True,
    )  # fmt: skip
    environment.filters |= {"num": number_text, "interval": interval_text, "percent": percent_text}
    environment.filters |= {"risen": format_rise, "text": text, "joined": join_texts}
    page = environment.get_template(f"{name}.j2").render(context)
    path.write_text(page, encoding="utf-8", errors="surrogateescape")
