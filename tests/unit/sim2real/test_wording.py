"""Every code has one template and is used; the golden file holds all sentences, which are short."""

import ast
import json
import math
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import aerial_gym.sim2real
from aerial_gym.physics import EFFECTS
from aerial_gym.sim2real.findings import CODES, Finding
from aerial_gym.sim2real.json_values import write_json
from aerial_gym.sim2real.wording import TEMPLATES, finding_rows, render_findings, text
from aerial_gym.sim2real.wording.effects import EFFECT_TEMPLATES
from aerial_gym.sim2real.wording.words import half_width_text, value_text
from tests.unit.sim2real.finding_samples import EFFECT_SAMPLES, GOLDEN, SAMPLES, effect, golden

ROOT = Path(aerial_gym.sim2real.__file__).parent
LONGEST = 25  # Words of a sentence

DATA_ROOMS = ("logs", "predict", "identify", "failures", "judge")  # Rooms that make findings and no sentences


def test_the_golden_file_holds_the_sentence_of_every_sample() -> None:
    """After a change of the wording: python -m tests.unit.sim2real.finding_samples."""
    assert golden().splitlines() == GOLDEN.read_text(encoding="utf-8").splitlines()


def test_every_code_has_a_template_and_a_sample() -> None:
    assert TEMPLATES.keys() == CODES.keys()
    assert {one.code for one in SAMPLES} == CODES.keys()
    assert {one.subject for one in EFFECT_SAMPLES} >= EFFECT_TEMPLATES.keys()


def test_every_effect_that_flights_can_show_has_its_own_sentence() -> None:
    random = {"gusts", "motor_failure", "stuck_rotor", "brown_out"}
    assert EFFECT_TEMPLATES.keys() == {name for name in EFFECTS if EFFECTS.get(name).is_candidate_of_selection} | random


def test_every_code_is_used() -> None:
    sources = [path for path in ROOT.rglob("*.py") if "wording" not in path.parts and path.name != "findings.py"]
    used = set(re.findall(r'"([a-z0-9_]+)"', "\n".join(path.read_text(encoding="utf-8") for path in sources)))
    assert CODES.keys() - used == set()


def test_sentences_are_short() -> None:
    sentences = [(one.code, part) for one in SAMPLES for part in re.split(r"(?<=[.!?])\s+", text(one))]
    long = [(code, part) for code, part in sentences if len(part.split()) > LONGEST]
    assert [one for one in long if "needed" not in one[1].lower()] == []  # excitations are those of the effects


def finding_calls(path: Path) -> Iterator[ast.Call]:
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "Finding":
            yield node


@pytest.mark.parametrize("room", DATA_ROOMS)
def test_findings_hold_names_and_numbers_but_no_prose(room: str) -> None:
    """No text with a blank within a call of ``Finding``."""
    for path in (ROOT / room).rglob("*.py"):
        for call in finding_calls(path):
            texts = [str(node.value) for node in ast.walk(call) if isinstance(node, ast.Constant)]
            assert [text for text in texts if " " in text] == [], f"{path.name}:{call.lineno}: prose in a finding"


def test_a_finding_of_an_unknown_code_is_refused() -> None:
    with pytest.raises(KeyError, match="no_such_code"):
        Finding("no_such_code")


def test_findings_within_json_become_sentences() -> None:
    note = Finding("few_flights", "", {"flights": 2})
    assert render_findings({"a": [note, 1.0], "b": (None,)}) == {"a": [text(note), 1.0], "b": [None]}


def test_an_interval_without_end_is_null_in_json_and_infinite_in_words() -> None:
    changes = {"before_m_s2": 0.1, "after_m_s2": 0.2, "rise": 1.0, "rise_low": -1.0, "rise_high": math.inf, "more": 0}
    finding = Finding("error_may_rise", "specific_force.x", changes)
    (row,) = finding_rows([finding])
    assert row["values"] == {**changes, "rise_high": None}
    assert "(-100 to +∞ %)" in text(finding)


@pytest.mark.parametrize(("value", "half_width", "shown"), [
    (5.513, 0.61, "5.5 ± 0.6"),
    (5.513, 0.14, "5.51 ± 0.14"),
    (1234.0, 30.0, "1234 ± 30"),
    (0.04, 0.002, "0.040 ± 0.002"),
    (-0.01, 0.5, "0.0 ± 0.5"),
])  # fmt: skip
def test_values_have_the_digits_that_their_intervals_allow(value: float, half_width: float, shown: str) -> None:
    assert f"{value_text(value, half_width)} {half_width_text(half_width, '')}" == shown


@pytest.mark.parametrize(("x", "words"), [(0.004, "4.0 mm ahead of"), (-0.004, "4.0 mm behind"), (3e-4, "not certain")])
def test_a_direction_is_named_only_if_its_interval_holds_no_zero(x: float, words: str) -> None:
    assert words in text(effect("com_offset", x=(x, 0.0, 0.0005)))
    assert "left" not in text(effect("com_offset", x=(x, 0.0, 0.0005), y=(0.0004, 0.0, 0.0005)))


@pytest.mark.parametrize(("scale", "word"), [(0.96, "less"), (1.04, "more")])
def test_a_weak_and_a_strong_rotor_have_their_sign_in_words(scale: float, word: str) -> None:
    sentence = text(effect("weak_motor", "front left", motor=(3.0, 1.0, None), scale=(scale, 1.0, 0.002)))
    assert f"Rotor 3 (front left) gives 4.0 % {word} thrust" in sentence


def test_json_holds_signs_as_they_are_and_no_number_that_is_none(tmp_path: Path) -> None:
    write_json(tmp_path / "found.json", {"unit": "m/s²"})
    assert "m/s²" in (tmp_path / "found.json").read_text(encoding="utf-8")
    assert json.loads((tmp_path / "found.json").read_text(encoding="utf-8")) == {"unit": "m/s²"}
    with pytest.raises(ValueError, match="not JSON compliant"):
        write_json(tmp_path / "none.json", {"value": np.nan})
