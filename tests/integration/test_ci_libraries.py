"""CI fails if tests skip for want of rl-games or Sample Factory, and names them in `.ci/run`."""

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]

SKIPPED = """
import pytest
{module}
def test_that_needs_a_library():
    pytest.importorskip("no_such_games", reason="no-such-games is not installed")

def test_that_needs_none():
    pass
"""


def run_tests(folder: Path, required: str, module: str = "") -> tuple[int, str]:
    """Return exit status and output of pytest for a file with a skip, in which a module may skip as a whole."""
    (folder / "test_one.py").write_text(SKIPPED.format(module=module), encoding="utf-8")
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-p",
        "tests.ci_libraries",
        "-p",
        "no:cacheprovider",
        "-q",
        str(folder),
    ]
    environ = os.environ | {"REQUIRED_LIBRARIES": required, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [*command, "--rootdir", str(folder)], env=environ, cwd=folder, capture_output=True, text=True, check=False
    )
    return done.returncode, done.stdout


def test_a_skip_for_want_of_a_required_library_fails_the_run(tmp_path: Path) -> None:
    status, told = run_tests(tmp_path, "no_such_games")
    assert (status, "a required library is missing: Skipped: no-such-games" in told) == (1, True)
    assert run_tests(tmp_path, "other_library")[0] == 0


def test_a_module_that_skips_as_a_whole_fails_the_run(tmp_path: Path) -> None:
    assert run_tests(tmp_path, "no_such_games", 'pytest.importorskip("no_such_games")')[0] == 1


def test_ci_requires_both_training_libraries() -> None:
    text = (ROOT / ".ci" / "run").read_text(encoding="utf-8")
    assert 'REQUIRED_LIBRARIES="rl_games sample_factory"' in text
