"""What the last stage of the loop tells a reader, of results that are given."""

from dataclasses import replace

import numpy as np
import pytest

from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.identify.candidates.nuisance import OF_FLIGHTS, NuisanceColumns
from aerial_gym.sim2real.identify.selection.scoring import Criteria
from aerial_gym.sim2real.judge.analysis import (
    correct_robot,
    notes_on_implausible_deviations,
    notes_on_logs,
    notes_on_surrogates_and_offsets,
)
from aerial_gym.sim2real.predict.model_params import ModelParams, params_from_robot
from aerial_gym.sim2real.predict.tolerances import Tolerances
from tests.unit.sim2real.flat_flights import ROBOT
from tests.unit.sim2real.judge.builders import make_evaluation, make_excess, make_setup
from tests.unit.sim2real.predict.test_scene import hover
from tests.unit.sim2real.set_fits import PLACE, make_choice, make_fit, make_selection

RANDOM = {"gusts": {"std": 1.5, "corr_time": 0.8}, "random_force": {"x": 0.1, "y": 0.1, "z": 0.2, "hold": 0.01}}


def mass_notes(size: float, left: list[float]) -> list[Finding]:
    """Return the notes where the mass is off by ``size`` deviations, which leaves such forces in place of 0.2 m/s²."""
    deviation = np.zeros(len(names := Tolerances().names(4)))
    deviation[names.index("mass")] = size
    excess = make_excess(deviation, left=[np.outer([1.0, -1.0], left)])
    return notes_on_implausible_deviations(
        make_setup([hover("a", 5.0)]), ModelParams(), Criteria().material, excess, make_evaluation(0.2, 0.2, 0.2)
    )


@pytest.mark.parametrize(
    ("left", "changed"),
    [([0.2, 0.1, 0.27], {"specific_force.y": (0.1, 0.2), "specific_force.z": (0.27, 0.2)}), ([0.2, 0.199, 0.201], {})],
)
def test_of_a_strained_tolerance_it_is_said_what_it_changes(left, changed) -> None:
    first, last = mass_notes(4.0, left)
    assert first == Finding("tolerance_strained", "mass", {"deviation_std": 4.0})
    assert last.code == ("strained_changes" if changed else "strained_changes_little")
    errors = {row["channel"]: (row["with_m_s2"], row["without_m_s2"]) for row in last.values.get("errors", ())}
    assert errors == {channel: pytest.approx(pair) for channel, pair in changed.items()}
    assert mass_notes(2.0, left) == []


@pytest.mark.parametrize(
    ("count", "band", "told"),
    [
        (3, 10.0, {}),
        (3, 10.0 - 1e-9, {"band_limited": {"band_hz": 10.0 - 1e-9, "slowest_hz": 50.0}}),
        (2, 10.0, {"few_flights": {"flights": 2}}),
        (1, 5.0, {"band_limited": {"band_hz": 5.0, "slowest_hz": 50.0}, "few_flights": {"flights": 1}}),
    ],
)
def test_slow_logs_and_few_flights_are_told(count: int, band: float, told: dict[str, dict]) -> None:
    flights = [hover(f"f{n}", 5.0, rate=50.0 + n) for n in range(count)]
    assert {note.code: note.values for note in notes_on_logs(make_setup(flights, band=band))} == told


def test_an_effect_that_only_stands_in_for_a_structure_is_told_with_it() -> None:
    chosen = make_choice(make_fit(), surrogates={"thrust_coefficient": "time"})
    (note,) = notes_on_surrogates_and_offsets(make_selection(chosen))
    assert note == Finding("stands_in", "thrust_coefficient", {"structure": "time"})
    assert notes_on_surrogates_and_offsets(make_selection(make_choice(make_fit()))) == []


def test_offsets_that_each_flight_has_of_its_own_are_told_with_their_size() -> None:
    own = NuisanceColumns(kind=OF_FLIGHTS, channel="specific_force.x", columns=[], size=0.0123)
    (note,) = notes_on_surrogates_and_offsets(make_selection(make_choice(make_fit(structures=(own, PLACE)))))
    assert note.code == "offsets_sizes"
    assert note.values == {"offsets": [{"channel": "specific_force.x", "rms_m_s2": 0.0123}]}
    assert notes_on_surrogates_and_offsets(make_selection(make_choice(make_fit(structures=(PLACE,))))) == []


def test_what_is_random_in_a_robot_file_stays_in_the_corrected_one() -> None:
    robot = replace(ROBOT, effects={**RANDOM, "rotor_drag": {"dx": 0.1, "dy": 0.1, "dz": 0.0}}, effects_source="test")
    declared = make_setup([hover("a", 5.0)], robot)
    params = params_from_robot(robot).with_effect("payload_mass", np.array([0.02]))
    result = correct_robot(declared, params, ["payload_mass"]).effects
    assert {name: result[name] for name in RANDOM} == RANDOM
    assert {"rotor_drag", "payload_mass"} == set(result) - set(RANDOM)
    params = params.with_effect("gusts", np.array([2.0, 0.5]))
    result = correct_robot(declared, params, ["payload_mass", "gusts"]).effects
    assert result["gusts"] == {"std": 2.0, "corr_time": 0.5}
