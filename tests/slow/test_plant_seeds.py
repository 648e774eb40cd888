"""Every effect hidden in flights of seeds that nothing else uses, with and without small errors everywhere."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("nuisance", [(), ("--nuisance",)])
def test_the_hidden_effect_is_named_on_another_seed(nuisance: tuple[str, ...]) -> None:
    command = [sys.executable, "-m", "benchmarks.scores.score_undeclared", "--seeds", "205", *nuisance]
    out = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    assert "right 7 of 7" in out


def test_flights_that_only_hover_make_up_no_effect() -> None:
    module, flags = "benchmarks.scores.score_undeclared", ["--seeds", "1823", "--nuisance", "--hover", "--json"]
    command = [sys.executable, "-m", module, *flags]
    out = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    rows = [json.loads(line) for line in out.splitlines() if line.startswith("{")]
    hovers = [row for row in rows if "hover" in row["features"]]
    assert len(hovers) == 6
    assert {row["judgement"] for row in hovers} <= {"quiet", "right", "near"}
