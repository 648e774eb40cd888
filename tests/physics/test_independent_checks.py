"""The table of ``docs/results/independent_checks.md``: every effect and law has a row, and every test that it names exists."""

import re
from pathlib import Path

from aerial_gym.control.controllers import WITH_MEMORY
from aerial_gym.control.laws import LAWS
from aerial_gym.physics import EFFECTS

ROOT = Path(__file__).parents[2]
ROWS = [
    line.split("|")[1:4]
    for line in (ROOT / "docs/results/independent_checks.md").read_text(encoding="utf-8").splitlines()
    if "`tests/" in line and line.startswith("|")
]


def test_every_effect_and_every_law_has_a_row() -> None:
    named = set(re.findall(r"`([\w*]+)`", " ".join(row[0] for row in ROWS)))
    laws = {"pid_*" if name is None else name for name in WITH_MEMORY} | {*LAWS, "thrust", "rotor_speed"}
    assert {*EFFECTS.names(), "learned_residual", *laws} - named == set()


def test_every_test_that_is_named_exists() -> None:
    for _, _, tests in ROWS:
        for names in tests.split("<br>"):
            path, *functions = re.findall(r"`([^`]+)`", names)
            text = (ROOT / path).read_text(encoding="utf-8")
            assert functions
            assert [name for name in functions if f"\ndef {name}(" not in text] == []
