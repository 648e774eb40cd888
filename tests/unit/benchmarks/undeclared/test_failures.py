"""Failures of the truth plant against closed forms: rotors that are told one speed all along."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks.undeclared import PlantFailure, make_case
from benchmarks.undeclared.dynamics import ROTOR, VEL, rest_state
from benchmarks.undeclared.full_dynamics import FullPlant
from benchmarks.undeclared.surroundings import Failures, PlantSurroundings
from benchmarks.undeclared.vehicle import DECLARED, GRAVITY, Array

DT = 5e-4
TOLD = np.tile([1000.0, 1100.0, 1200.0, 1300.0], (2, 1))


def fly(failure: PlantFailure | Failures, seconds: float, told: Array = TOLD) -> tuple[FullPlant, Array]:
    """Return plant and states of two flights from hover, of which the second fails; logs begin with the simulation."""
    fails = failure if isinstance(failure, Failures) else Failures([None, failure], 0.0)
    around = PlantSurroundings(failures=fails, rate=1.0 / DT)
    plant = FullPlant(DECLARED, around)
    state = rest_state(DECLARED, np.array([[0.0, 0.0, 50.0]] * 2), np.zeros(2))
    for index in range(round(seconds / DT)):
        plant.begin_sample(index, np.full(2, 16.0))
        state = plant.step(state, told, DT)
    return plant, state


def lag_speed(start: Array | float, told: Array | float, seconds: float) -> Array:
    """Return the rotor speeds after a time [s] of first-order lag towards the command."""
    return told + (start - told) * np.exp(-seconds / DECLARED.tau_up)


def test_a_failed_motor_follows_its_share_from_its_time() -> None:
    """Order 4 at 0.5 ms and a lag of 38 ms leaves (dt / tau)^4 / 120: 3e-10 of a speed."""
    _, state = fly(PlantFailure(kind="motor_failure", motor=3, scale=0.6, time=0.05), 0.12)
    hover = DECLARED.hover_speed()
    np.testing.assert_allclose(state[0, ROTOR], lag_speed(hover, TOLD[0], 0.12), rtol=1e-8)
    expected = lag_speed(hover, TOLD[0], 0.12)
    expected[2] = lag_speed(lag_speed(hover, 1200.0, 0.05), 0.6 * 1200.0, 0.07)
    np.testing.assert_allclose(state[1, ROTOR], expected, rtol=1e-8)


def test_a_stuck_rotor_keeps_the_speed_of_its_time() -> None:
    _, state = fly(PlantFailure(kind="stuck_rotor", motor=1, time=0.03), 0.2)
    np.testing.assert_allclose(state[1, ROTOR][0], lag_speed(DECLARED.hover_speed(), 1000.0, 0.03), rtol=1e-8)
    np.testing.assert_allclose(state[1, ROTOR][1:], state[0, ROTOR][1:], rtol=1e-12)


def test_the_truth_says_which_speed_a_stuck_rotor_keeps() -> None:
    fails = Failures([None, PlantFailure(kind="stuck_rotor", motor=2, time=0.03)], 0.0)
    assert "speed" not in fails.document(1)
    fly(fails, 0.1)
    speed = float(lag_speed(DECLARED.hover_speed(), 1100.0, 0.03))
    told = {"kind": "stuck_rotor", "time": 0.03, "motor": 2, "speed": pytest.approx(speed, rel=1e-8)}
    assert fails.document(1) == told
    weak = PlantFailure(kind="weak_motor", motor=2, scale=0.5, time=0.0)
    assert Failures([weak], 0.0).document(0) == weak.document()


def test_a_brown_out_holds_all_rotors_back_and_ends() -> None:
    _, state = fly(PlantFailure(kind="brown_out", scale=0.5, time=0.02, duration=0.04), 0.1)
    low = lag_speed(lag_speed(DECLARED.hover_speed(), TOLD[0], 0.02), 0.5 * TOLD[0], 0.04)
    np.testing.assert_allclose(state[1, ROTOR], lag_speed(low, TOLD[0], 0.04), rtol=1e-8)


def test_a_weak_propeller_turns_as_told_and_gives_its_share() -> None:
    """At hover speed, one rotor of four at half its thrust: the vehicle begins to fall by g / 8 and to turn."""
    hover = np.full((2, 4), DECLARED.hover_speed())
    plant, state = fly(PlantFailure(kind="weak_motor", motor=2, scale=0.5, time=0.0), DT, hover)
    slope = plant.derivative(state, hover)
    np.testing.assert_allclose(state[:, ROTOR], hover, rtol=1e-12)
    np.testing.assert_allclose(slope[1, VEL][2] - slope[0, VEL][2], -GRAVITY / 8.0, rtol=1e-3)
    assert slope[1, 15] > slope[0, 15] + 1.0  # the right side goes down, the left up: about +x


@pytest.mark.slow
@pytest.mark.usefixtures("coarser_plant")
def test_only_the_named_flight_fails_and_ends_in_the_air(tmp_path: Path) -> None:
    short = {"effects": {}, "seed": 5, "num_train": 1, "num_test": 1, "duration_s": 3.0}
    plain = make_case(tmp_path / "plain", **short)
    motor = PlantFailure(kind="motor_failure", scale=0.0, time=0.5)
    failing = make_case(tmp_path / "failing", failures={"test_1": motor}, **short)
    assert failing.train[0].read_bytes() == plain.train[0].read_bytes()
    table, whole = (np.loadtxt(files.test[0], delimiter=",", skiprows=1) for files in (failing, plain))
    assert len(table) < len(whole)
    assert table[:, 3].min() > 0.0
    np.testing.assert_array_equal(table[:201], whole[:201])  # up to the row at 0.5 s


def test_a_failure_that_cannot_be_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="Known: motor_failure"):
        PlantFailure(kind="loss", time=1.0)
    with pytest.raises(ValueError, match="must be 1, 2, 3 or 4"):
        PlantFailure(kind="stuck_rotor", motor=5, time=1.0)
    with pytest.raises(ValueError, match="no flight"):
        make_case(tmp_path, effects={}, seed=1, failures={"test_9": PlantFailure(kind="stuck_rotor", time=1.0)})
