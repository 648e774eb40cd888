"""The table of licences has a row for each dependency of the project, with the extras that list it."""

import re
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement

from docs.generate import licences

ROOT = Path(__file__).parents[2]


def test_every_dependency_has_its_row_and_a_licence() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    expected: dict[str, list[str]] = {}
    for extra, texts in {"core": project["dependencies"], **project["optional-dependencies"]}.items():
        for name in (Requirement(text).name for text in texts):
            expected.setdefault(name, []).append(extra)
    del expected["aerial-gym"]
    table = licences.PAGE.read_text(encoding="utf-8")
    rows = re.findall(r"^\| `([^`]+)` \| ([^|]*) \| ([^|]*) \|$", table, re.MULTILINE)
    assert {name: extras.replace("`", "").split(", ") for name, extras, _ in rows} == expected
    assert [name for name, _, licence in rows if licence in ("", "not installed")] == []


def test_licences_come_from_the_metadata_of_packages(monkeypatch: pytest.MonkeyPatch) -> None:
    assert licences.licence("numpy") not in (None, "see its files")
    assert licences.licence("no-such-package") is None
    monkeypatch.setattr(licences, "direct_dependencies", lambda: {"no-such-package": ["`bees`"], "other": ["core"]})
    page = f"{licences.BEGIN}\n| `no-such-package` | `bees` | MIT |\n{licences.END}"
    assert "| `no-such-package` | `bees` | MIT |" in licences.licence_table(page)
    assert "| `other` | core | not installed |" in licences.licence_table(page)
