"""The truth plant with two vehicles: references, wakes, clocks and what is hidden."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from benchmarks.undeclared.cases import list_flights, plan_flights
from benchmarks.undeclared.pairs import ABOVE, HIDDEN, make_pair_case, references_of_pair
from benchmarks.undeclared.simulate import CONTROL_RATE


def test_references_take_turns_above_each_other_and_are_consistent() -> None:
    lower = plan_flights(list_flights(2, 1), seed=3, duration_s=2.0)
    first, second = references_of_pair(lower, 3)
    away = second.position - first.position
    assert (away[:, [0, 2], 2] > ABOVE[0]).all()
    assert (away[:, 1, 2] < -ABOVE[0]).all()
    assert np.abs(away[:, :, :2]).max() < 0.51
    for reference in (first, second):
        for name, rate in (("position", "velocity"), ("velocity", "acceleration"), ("acceleration", "jerk")):
            slope = np.gradient(getattr(reference, name), 1.0 / CONTROL_RATE, axis=0)[5:-5]
            scale = np.abs(slope).max()
            np.testing.assert_allclose(getattr(reference, rate)[5:-5], slope, atol=0.02 * scale)


@pytest.mark.usefixtures("coarser_plant")
def test_logs_of_a_pair_share_a_clock_unless_it_is_hidden(tmp_path: Path) -> None:
    files = make_pair_case(tmp_path / "a", "clocks apart", seed=5, duration_s=1.0, rate_hz=100)
    assert len(files.train) == 8
    assert len(files.test) == 6
    assert files.pairs[0] == files.train[:2]
    offset = float(str(files.truth["clock_s"]))
    assert 0.15 <= abs(offset) <= 0.4
    first, second = (pd.read_csv(path) for path in files.pairs[0])
    np.testing.assert_allclose(second["t"] + offset, first["t"], atol=2e-6)
    assert "other_p_x" not in first


@pytest.mark.slow
@pytest.mark.parametrize(
    "kind", ["downwash", "gusts on both", "gusts on each", "effect on one", "downwash and ground effect"]
)
def test_every_kind_flies(kind: str, tmp_path: Path) -> None:
    files = make_pair_case(tmp_path, kind, seed=6, duration_s=1.0, rate_hz=100)
    effects = files.truth["effects"]
    assert files.truth["clock_s"] == 0.0
    assert isinstance(effects, dict)
    assert set(effects) <= {*HIDDEN[kind], "ground_effect"}
    assert all(path.is_file() for path in (*files.train, *files.test, files.robot))
    given = {*files.train, *files.test}
    assert all(set(pair) <= given for pair in files.pairs)
