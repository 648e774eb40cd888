"""The quick golden results, compared with their reference files in processes of their own; ``make golden`` compares all."""

import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import pytest

from tests.golden.__main__ import TOPICS
from tests.golden.compare import compact, differences, is_machine_bound

ROOT = Path(__file__).parents[2]


def test_quick_results_are_those_of_the_reference() -> None:
    """The reference of the interface holds what classes inherit from gymnasium 0.29, so it counts with that version alone."""
    topics = TOPICS if version("gymnasium").startswith("0.29") else [name for name in TOPICS if name != "interface"]
    command = [sys.executable, "-m", "tests.golden", *topics, "--quick", "--jobs", "1"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, encoding="utf-8", check=False)
    assert done.returncode == 0, done.stdout + done.stderr[-2000:]


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
