"""Means of flights against noise of known size, and a folder that is not there."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks.scores.flight_offsets import main, mean_and_error


def test_the_error_of_a_mean_counts_independent_rows() -> None:
    """White noise: std over the root of the rows; the same where each value stands four times: of a quarter of them."""
    white = np.random.default_rng(3).standard_normal((4000, 1))
    mean, error = mean_and_error(2.0 + white)
    assert mean[0] == pytest.approx(2.0, abs=4.0 / np.sqrt(4000))
    assert error[0] == pytest.approx(1.0 / np.sqrt(4000), rel=0.1)
    _, repeated = mean_and_error(np.repeat(white, 4, axis=0))
    assert repeated[0] == pytest.approx(error[0], rel=0.15)


def test_a_folder_that_is_not_there_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--data", str(tmp_path / "none"), "--set", "idsia", "--effects", "rotor_drag"]) == 2
    assert "no such folder" in capsys.readouterr().err
