"""The quick golden results, compared with their reference files in processes of their own; ``make golden`` compares all."""

import os
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pytest

from benchmarks.undeclared.effects import effect_parameters
from benchmarks.undeclared.vehicle import DECLARED
from tests.golden.__main__ import REFERENCE, TOPICS
from tests.golden.cases import CASES, FLIGHTS
from tests.golden.compare import compact, differences, is_machine_bound, read
from tests.golden.worker import SETTINGS

ROOT = Path(__file__).parents[2]


def test_quick_results_are_those_of_the_reference() -> None:
    """The reference of the interface holds what classes inherit from gymnasium 0.29, so it counts with that version alone."""
    topics = TOPICS if version("gymnasium").startswith("0.29") else [name for name in TOPICS if name != "interface"]
    command = [sys.executable, "-m", "tests.golden", *topics, "--quick", "--jobs", "1"]
    done = subprocess.run(
        command, cwd=ROOT, env=os.environ | SETTINGS, capture_output=True, encoding="utf-8", check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr[-2000:]


NAMED = ("com_offset", "ground_effect", "two_effects", "slung_payload", "gusts")
"""Cases of flights without small errors beside their effects."""


@pytest.mark.parametrize("name", NAMED)
def test_the_reference_names_what_a_case_hides(name: str) -> None:
    """Every value lies within four standard deviations. The quick results repeat the verdict on ``com_offset``."""
    verdict = reference_verdict(name)
    truth = effect_parameters(CASES[name]["effects"], declared=DECLARED, seed=FLIGHTS["seed"])
    assert verdict["verdict"] == "explained"
    assert {effect["name"] for effect in verdict["effects"]} == set(truth)
    for effect in verdict["effects"]:
        for key, std in effect["std"].items():
            assert abs(effect["params"][key] - truth[effect["name"]][key]) < 4.0 * std, (effect["name"], key)


def test_the_reference_corrects_the_residual_to_near_the_noise_floor() -> None:
    """Deviations within the tolerances are not in the corrected model: 1.6 times the floor beside a shifted centre of mass."""
    after = reference_verdict("com_offset")["after"]
    for kind in ("specific_force", "angular_acceleration", "rotor_speed"):
        for axis in set(after[kind]) - {"unit"}:
            assert after[kind][axis]["rms"] < 2.0 * after[kind][axis]["noise_floor"], (kind, axis)


def test_the_reference_names_nothing_where_nothing_is_hidden() -> None:
    verdict = reference_verdict("nothing")
    assert (verdict["verdict"], verdict["effects"]) == ("none", [])


def reference_verdict(name: str) -> dict[str, Any]:
    """Return the stored verdict on a case."""
    items = read(REFERENCE / "cases.json")["items"][name].items()
    return {key.removeprefix("verdict."): value for key, value in items if key.startswith("verdict.")}


def test_each_difference_is_named_with_both_values() -> None:
    reference = {"a": {"b": [1.0, 2.0]}, "gone": 1, "same": "x", "flag": True}
    present = {"a": {"b": [1.0, 2.1]}, "same": "x", "flag": 1, "more": 3}
    lines = ["t/a/b[1]: 2.0 -> 2.1", "t/gone: missing, was 1", "t/flag: true -> 1", "t/more: new, 3"]
    assert list(differences(reference, present, "t")) == lines


def test_an_error_is_one_difference() -> None:
    assert list(differences({"a": 1, "b": 2}, {"error": "ValueError: no"}, "t")) == ["t: ValueError: no"]


@pytest.mark.parametrize(("change", "count"), [(1e-5, 0), (4e-5, 1)])
def test_numbers_differ_beyond_the_tolerance(change: float, count: int) -> None:
    assert len(list(differences([1.0], [1.0 + change], "t"))) == count


def test_sentences_are_dropped_and_codes_are_kept() -> None:
    value = {"state": "not shown", "reason": "the flights show it", "notes": ["one two three four"], "x": 1.23456789}
    assert compact(value, prose=False) == {"state": "not shown", "x": 1.23457}
    assert compact(value, prose=True)["reason"] == "the flights show it"


def test_hashes_depend_on_the_machine_and_early_numbers_do_not() -> None:
    assert is_machine_bound('tasks/tracking_task/torch/hash/rewards: "a" -> "b"')
    assert not is_machine_bound("tasks/tracking_task/torch/early/1/rewards[0]: 1.0 -> 2.0")
