"""Commands of the package, run in the process of a test."""

import pytest

from aerial_gym.cli.main import main


def run(capsys: pytest.CaptureFixture[str], *argv: str) -> tuple[int, str, str]:
    """Return exit status, stdout and stderr of a command."""
    status = main(argv)
    captured = capsys.readouterr()
    return status, captured.out, captured.err


def run_bench(capsys: pytest.CaptureFixture[str], *argv: str) -> tuple[int, str, str]:
    """Return those of a benchmark."""
    return run(capsys, "bench", *argv)
