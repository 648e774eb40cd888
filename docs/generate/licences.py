"""The table of licences in ``docs/reference/licences.md``: ``python -m docs.generate.licences`` writes it anew.

Licences are those in the metadata of installed packages. The row of a package that is not installed stays as it is.
"""

import re
from importlib import metadata
from pathlib import Path

from aerial_gym.extras import PROJECT, requirements
from docs.generate.markdown import table

PAGE = Path(__file__).parents[1] / "reference" / "licences.md"
BEGIN, END = "<!-- licences -->", "<!-- end of licences -->"
LONGEST = 120  # Longest name of a licence [characters]; packages that give the whole text are shown by their classifier


def direct_dependencies() -> dict[str, list[str]]:
    """Return the packages that extras list, with the extras of each; `core` for those that are always installed."""
    packages: dict[str, list[str]] = {}
    for extra, rows in requirements().items():
        for row in rows:
            if row.name != PROJECT:
                packages.setdefault(row.name, []).append(f"`{extra}`" if extra else "core")
    return dict(sorted(packages.items(), key=lambda item: item[0].lower()))


def licence(package: str) -> str | None:
    """Return the licence in the metadata of an installed package; None if it is not installed."""
    try:
        known = metadata.metadata(package)
    except metadata.PackageNotFoundError:
        return None
    classified = [
        text.rpartition(" :: ")[2] for text in known.get_all("Classifier") or () if text.startswith("License")
    ]
    stated = [known.get("License-Expression"), known.get("License"), ", ".join(classified)]
    return next((text for text in stated if text and len(text) <= LONGEST and "\n" not in text), "see its files")


def licence_table(page: str) -> str:
    """Return the table; rows of packages that are not installed are those of the page."""
    earlier = dict(re.findall(r"^\| `([^`]+)` \| [^|]* \| ([^|]*) \|$", page, re.MULTILINE))
    rows = (
        (f"`{name}`", ", ".join(extras), licence(name) or earlier.get(name, "not installed"))
        for name, extras in direct_dependencies().items()
    )
    return table(("package", "extras", "licence"), rows)


def main() -> None:
    """Write the table into the page."""
    text = PAGE.read_text(encoding="utf-8")
    head, _, rest = text.partition(BEGIN)
    tail = rest.partition(END)[2]
    PAGE.write_text(f"{head}{BEGIN}\n\n{licence_table(text)}\n\n{END}{tail}", encoding="utf-8")


if __name__ == "__main__":
    main()
