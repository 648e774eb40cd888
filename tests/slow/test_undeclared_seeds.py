"""Every effect hidden in flights of seeds that nothing else uses, with and without small errors everywhere."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("nuisance", [(), ("--nuisance",)])
def test_the_hidden_effect_is_named_on_another_seed(nuisance: tuple[str, ...]) -> None:
    command = [sys.executable, "-m", "benchmarks.score_undeclared", "--seeds", "205", *nuisance]
    out = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    assert "right 7 of 7" in out
