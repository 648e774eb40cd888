"""What the last stage of the loop tells a reader, of results that are given."""

from types import SimpleNamespace

import numpy as np
import pytest

from aerial_gym.sim2real.identify.selection.scoring import Criteria
from aerial_gym.sim2real.judge.analysis import strained_notes
from aerial_gym.sim2real.predict.channels import Channel
from aerial_gym.sim2real.predict.tolerances import Tolerances
from tests.unit.sim2real.flat_flights import ROBOT
from tests.unit.sim2real.predict.test_scene import hover

FORCES = [Channel(kind="specific_force", axis=axis) for axis in "xyz"]


def notes_of(size: float, left: list[float]) -> list[str]:
    """Return the notes where the mass is off by ``size`` deviations, which leaves such forces in place of 0.2 m/s²."""
    deviation = np.zeros(len(names := Tolerances().names(4)))
    deviation[names.index("mass")] = size
    declared = SimpleNamespace(
        tolerances=Tolerances(), train=SimpleNamespace(flights=[hover("a", 5.0)]), stated=ROBOT, channels=FORCES
    )
    refitted = SimpleNamespace(
        declared=declared, params=SimpleNamespace(effects={}), selection=SimpleNamespace(criteria=Criteria())
    )
    unexplained = SimpleNamespace(deviation=deviation, left=[np.outer([1.0, -1.0], left)])
    named = SimpleNamespace(residual=[SimpleNamespace(value=0.2)] * 3)
    return strained_notes(refitted, unexplained, named)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("left", "said"),
    [
        ([0.2, 0.1, 0.27], "are left specific force y 0.1 in place of 0.2 m/s², specific force z 0.27 in place of 0.2"),
        ([0.2, 0.199, 0.201], "hardly anything changes on the test flights"),
    ],
)
def test_of_a_strained_tolerance_it_is_said_what_it_changes(left: list[float], said: str) -> None:
    """Better and worse, and not what changes by less than is material; nothing where no tolerance is strained."""
    first, last = notes_of(4.0, left)
    assert "mass to be off by +4.0" in first
    assert said in last
    assert notes_of(2.0, left) == []
