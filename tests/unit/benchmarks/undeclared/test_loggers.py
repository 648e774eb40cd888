"""The truth plant: logs as loggers write them, and the evidence that a log can show, against a closed form.
Failures of the truth plant against closed forms: rotors that are told one speed all along.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from aerial_gym.sim2real.logs.readers.flight_log import read_flight_log
from benchmarks.undeclared import PlantFailure, make_case
from benchmarks.undeclared.cases import SETTLE_S, CaseRecord, fly_case
from benchmarks.undeclared.dynamics import ROTOR, VEL, rest_state
from benchmarks.undeclared.evidence import EVERY, FlightStates, evidence_over_rivals
from benchmarks.undeclared.full_dynamics import FullPlant
from benchmarks.undeclared.loggers import (
    LOGGERS,
    LONGEST_BURST,
    START_US,
    PlantLogger,
    burst_rows,
    disturb_record,
    smooth_noise,
    write_rows,
    write_ulog,
)
from benchmarks.undeclared.sensors import PlantNoise, PlantNuisance
from benchmarks.undeclared.simulate import CONTROL_RATE
from benchmarks.undeclared.surroundings import Failures, PlantSurroundings
from benchmarks.undeclared.vehicle import DECLARED, GRAVITY, Array
from tests.refusals import assert_refused

FIRST = round(SETTLE_S * CONTROL_RATE)
ROWS = slice(FIRST, None)
EXACT = PlantNuisance(**dict.fromkeys(PlantNuisance.__dataclass_fields__, 0.0))


@pytest.fixture(scope="module")
def case() -> CaseRecord:
    bias = {"ax": 0.02, "ay": 0.0, "az": 0.0, "gx": 0.0, "gy": 0.0, "gz": 0.0}
    return fly_case(effects={"imu_bias": bias}, seed=3, num_train=1, num_test=0, duration_s=4.0)


def at_rows(time: Array, values: Array) -> Array:
    """Return values (T, ...) at the sample of each time of a log."""
    return values[np.rint((time - 1e-6 * START_US) * CONTROL_RATE).astype(int)]


def test_ulog_is_read_back(case: CaseRecord, tmp_path: Path) -> None:
    """The reader of the package finds the same motion, each topic on its own samples, commands as shares of the largest."""
    write_ulog(tmp_path / "a.ulg", case.record, 0, ROWS, PlantLogger(file="ulg"), full=2000.0)
    log, seen = read_flight_log(tmp_path / "a.ulg"), {k: v[ROWS, 0] for k, v in case.record.measured.items()}
    assert log.rotor_command is not None
    assert log.lin_vel is not None
    assert log.ang_vel is not None
    assert log.specific_force is not None
    np.testing.assert_allclose(log.ang_vel, at_rows(log.time, seen["rate"]), atol=1e-5)
    np.testing.assert_allclose(log.specific_force, at_rows(log.time, seen["acc"]), atol=1e-5)
    np.testing.assert_allclose(log.rotor_command, at_rows(log.time, case.record.command[ROWS, 0]) / 2000.0, atol=1e-6)
    np.testing.assert_allclose(log.lin_vel, at_rows(log.time, seen["velocity"]), atol=1e-5)
    assert {name: round(one.rate) for name, one in log.streams.items() if name != "battery"} == dict.fromkeys(
        ("ang_vel", "specific_force", "attitude", "position", "lin_vel", "rotor_command", "rotor_speed"), 400
    )


def test_slow_topics_keep_their_rates(case: CaseRecord, tmp_path: Path) -> None:
    rates = {"imu": 200.0, "attitude": 20.0, "position": 10.0, "command": 10.0, "battery": 5.0}
    logger = PlantLogger(file="ulg", rates=rates, rotor_speeds=False)
    write_ulog(tmp_path / "a.ulg", case.record, 0, ROWS, logger, full=2000.0)
    log = read_flight_log(tmp_path / "a.ulg")
    expected = {"attitude": 20, "position": 10, "lin_vel": 10, "ang_vel": 200, "battery": 5}
    assert {name: round(log.streams[name].rate) for name in expected} == expected
    assert log.rotor_speed is None


def test_bursts_lose_their_share_of_rows() -> None:
    lost = burst_rows(6400, 0.03, np.random.default_rng(1))
    assert 0.03 <= lost.mean() < 0.03 + LONGEST_BURST / 6400
    edges = np.flatnonzero(np.diff(np.concatenate(([0], lost, [0]))))
    assert (edges[1::2] - edges[::2]).max() > 1


def test_rows_have_jitter_and_no_rotor_speeds(case: CaseRecord, tmp_path: Path) -> None:
    logger = PlantLogger(row_rate=400.0, lost=0.1, jitter=0.00015, rotor_speeds=False)
    write_rows(tmp_path / "a.csv", case.record, 0, ROWS, logger, 7)
    names = (tmp_path / "a.csv").read_text().partition("\n")[0].split(",")
    time = np.loadtxt(tmp_path / "a.csv", delimiter=",", skiprows=1)[:, 0]
    assert not any(name.startswith("rotor_") for name in names)
    assert "cmd_1" in names
    off = time - np.rint(time * CONTROL_RATE) / CONTROL_RATE
    assert off.std() == pytest.approx(0.00015, rel=0.1)
    assert len(time) == pytest.approx(0.9 * 1601, rel=0.02)


def test_late_streams_and_vibration(case: CaseRecord) -> None:
    before, logger = case.record.measured, PlantLogger(late=(0.1, 0.1), vibration=1.0)
    after = disturb_record(case.record, logger, 3).measured
    np.testing.assert_allclose(after["velocity"][500:], before["velocity"][460:-40], atol=1e-12)
    np.testing.assert_array_equal(after["rotation"], before["rotation"])
    assert (after["acc"] - before["acc"]).std() == pytest.approx(1.0, rel=0.05)


def test_positions_wander_without_jumps() -> None:
    """Behind ``1 / (1 + T s)²``: variance 1, and a derivative of the standard deviation 1 / T."""
    noise = smooth_noise(np.random.default_rng(4), (200_000, 3), 0.5)
    assert noise.std() == pytest.approx(1.0, rel=0.1)
    assert np.diff(noise, axis=0).std() * CONTROL_RATE == pytest.approx(2.0, rel=0.1)


def test_ulog_has_no_place_for_a_ceiling(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="ULog"):
        make_case(
            tmp_path, effects={}, features=("ceiling",), seed=1, num_test=0, num_train=1, duration_s=1.0, logger="px4"
        )


def test_evidence_of_a_bias_is_its_noncentrality(case: CaseRecord) -> None:
    """Without small errors ``q = n b² / s²``, of n samples of a bias b under white noise s; ``q / 2 - 3 ln(1 + q / 6)``."""
    states, noise = FlightStates(case.record, [0], FIRST, PlantLogger()), PlantNoise()
    q = len(states.state) * EVERY * (0.02 / noise.acc) ** 2
    evidence = evidence_over_rivals(states, case.params, noise, EXACT)
    assert evidence["nothing"] == pytest.approx(0.5 * q - 3.0 * np.log(1.0 + q / 6.0), rel=0.02)
    assert 0.0 <= min(evidence.values()) <= evidence["nothing"]


def test_evidence_falls_with_the_small_error_that_looks_the_same(case: CaseRecord) -> None:
    """With a prior of the bias of standard deviation p, q becomes ``q / (1 + n p² / s²)``."""
    states, noise = FlightStates(case.record, [0], FIRST, PlantLogger()), PlantNoise()
    gain = len(states.state) * EVERY * (0.02 / noise.acc) ** 2
    q = gain / (1.0 + gain)
    evidence = evidence_over_rivals(states, case.params, noise, PlantNuisance(**{**vars(EXACT), "acc_bias": 0.02}))
    assert evidence["nothing"] == pytest.approx(0.5 * q - 3.0 * np.log(1.0 + q / 6.0), abs=0.01)


@pytest.mark.slow
def test_evidence_of_a_centre_of_mass_needs_places_of_accelerometer_and_velocity() -> None:
    """Without torques only lever arms tell: of a large q, an offset o and two places of error s leave ``2 o² / s²``."""
    offset = {"x": 0.005, "y": 0.0, "z": 0.0}
    flown = fly_case(effects={"com_offset": offset}, seed=3, num_train=1, num_test=0, duration_s=8.0)
    states = FlightStates(flown.record, [0], FIRST, LOGGERS["px4"])

    def evidence(imu_place: float, velocity_place: float) -> float:
        sizes = replace(PlantNuisance(), imu_place=imu_place, velocity_place=velocity_place)
        return evidence_over_rivals(states, flown.params, PlantNoise(), sizes)["nothing"]

    assert min(evidence(0.005, 0.0), evidence(0.0, 0.005)) > 20.0
    assert evidence(0.005, 0.005) == pytest.approx(1.0 - 1.5 * np.log(1.0 + 2.0 / 3.0), abs=0.05)


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
    assert_refused(ValueError, "Known: motor_failure", PlantFailure, kind="loss", time=1.0)
    assert_refused(ValueError, "must be 1, 2, 3 or 4", PlantFailure, kind="stuck_rotor", motor=5, time=1.0)
    with pytest.raises(ValueError, match="no flight"):
        make_case(tmp_path, effects={}, seed=1, failures={"test_9": PlantFailure(kind="stuck_rotor", time=1.0)})
