"""The table of docs/concepts/rotors.md says what the effects say."""

import re
from pathlib import Path

from aerial_gym.physics import EFFECTS

PAGE = Path(__file__).parents[3] / "docs" / "concepts" / "rotors.md"


def test_the_table_of_effects_is_that_of_the_code() -> None:
    rows = re.findall(r"^\| `(\w+)` \| (\w+) \| (\w+) \| (\w+) \|$", PAGE.read_text(encoding="utf-8"), re.MULTILINE)
    told = {name: tuple(word == "yes" for word in words) for name, *words in rows}
    traits = ("reversible", "force", "slew")
    assert told == {n: tuple(trait in EFFECTS.get(n).rotors for trait in traits) for n in EFFECTS.names()}
    assert all("dead_band" in EFFECTS.get(name).rotors for name in EFFECTS.names())
