"""Robot files from flights whose vehicle is known: accelerations by a table of effectiveness, which the fit does not see."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from aerial_gym.cli.main import main
from aerial_gym.errors import ConfigError, DataError, UnknownNameError
from aerial_gym.robots.catalog import robot_by_name
from aerial_gym.robots.drafts.draft import ValueWithOrigin, robot_yaml_with_origins
from aerial_gym.robots.drafts.frames import FRAMES
from aerial_gym.sim2real.logs.raw_log import RawLog
from aerial_gym.sim2real.logs.readers.flight_log import read_flight_log, read_flights
from aerial_gym.sim2real.logs.readers.mapping import find_mapping
from aerial_gym.sim2real.teststand import vehicle_from_log
from aerial_gym.sim2real.teststand.log_geometry import (
    RotorLayout,
    ThrustLaw,
    _ardupilot_thrust_law,
    _betaflight_thrust_law,
    _layout_of_parameters,
    _px4_layout,
    frame_layout,
)
from aerial_gym.sim2real.teststand.vehicle_draft import mean_command
from aerial_gym.sim2real.teststand.vehicle_from_log import _torque_ratio_and_yaw_inertia, draft_vehicle
from tests.unit.sim2real import flat_flights, ulog_files

RATE, SECONDS, MASS = 400.0, 16.0, 0.5
SIGNS = np.array(((-1, -1, 1, 1), (1, -1, 1, -1), (1, -1, -1, 1)))  # Roll, pitch, yaw, of Betaflight's order
QUAD = frame_layout("quad_x_betaflight", 4)
assert QUAD.places is not None
assert QUAD.spins is not None
PLACES, SPINS = QUAD.places, QUAD.spins
SIZES = np.array((2.3e-5, 1.6e-5, 3.0e-6))  # Angular acceleration per squared speed
LIFT, LAG, IDLE, GAIN, POWER = 6.2e-7, 0.02, 450.0, 3600.0, 0.7


def write_flight(
    path: Path,
    seed: int,
    *,
    speeds: bool = True,
    seconds: float = SECONDS,
    lag: float = LAG,
    frame: str = "quad_x_betaflight",
    load: float = 1.0,
) -> Path:
    """Write a flight with slow random commands about hover; the vehicle's motion follows by sums over rotors.

    Commands are those of a mixer: of the collective, roll, pitch and yaw. ``load``: factor of the mass in the second half.
    """
    count = len(FRAMES[frame].split())
    weights = frame_layout(frame, count).weights
    assert weights is not None
    patterns = np.concatenate((np.ones((1, count)), weights))
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, seconds, 1.0 / RATE)
    tones, phases = rng.uniform(0.3, 8.0, (6, 1, 4)), rng.uniform(0.0, 2 * np.pi, (6, 1, 4))
    command = 0.35 + 0.03 * np.sin(2 * np.pi * tones * time[:, None] + phases).sum(axis=0) @ patterns / 2.0
    steady = IDLE + GAIN * command**POWER
    speed = steady.copy()
    for k in range(1, time.size):
        speed[k] = steady[k - 1] + (speed[k - 1] - steady[k - 1]) * np.exp(-1.0 / (RATE * lag))
    speed *= 1.0 + 1e-3 * rng.normal(size=speed.shape)
    acceleration = (speed**2) @ (weights * SIZES[:, None]).T
    acceleration -= acceleration.mean(axis=0)
    rates = np.cumsum(acceleration, axis=0) / RATE + 0.01 * rng.normal(size=(time.size, 3))
    force = np.zeros((time.size, 3))
    force[:, 2] = LIFT * (speed**2).sum(axis=1) * 4.0 / count / np.where(time < 0.5 * seconds, 1.0, load)
    columns = {"t": time, "q_x": 0.0, "q_y": 0.0, "q_z": 0.0, "q_w": 1.0}
    columns |= {f"omega_{axis}": rates[:, k] for k, axis in enumerate("xyz")}
    columns |= {f"acc_{axis}": force[:, k] + 0.2 * rng.normal(size=time.size) for k, axis in enumerate("xyz")}
    columns |= {f"rotor_{k + 1}": speed[:, k] for k in range(count)} if speeds else {}
    columns |= {f"cmd_{k + 1}": command[:, k] for k in range(count)}
    pd.DataFrame(columns).to_csv(path, index=False)
    return path


@pytest.fixture(scope="module")
def flights(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("flights")
    return [write_flight(folder / f"flight_{seed}.csv", seed) for seed in range(2)]


def test_a_flight_gives_signs_sizes_curve_and_lag(flights: list[Path]) -> None:
    draft = draft_vehicle(flights, mass=MASS, arm=0.1)
    assert draft.effectiveness is not None
    assert draft.curve is not None
    np.testing.assert_array_equal(draft.effectiveness.weights, SIGNS)
    for size, truth in zip(draft.effectiveness.sizes, (*SIZES, LIFT), strict=True):
        assert size.value == pytest.approx(truth, rel=0.05)
    assert draft.spins == SPINS
    np.testing.assert_array_equal(np.sign(draft.places[:, :2]), np.sign(PLACES[:, :2]))
    assert draft.values["thrust"].value == pytest.approx(MASS * LIFT, rel=0.02)
    assert draft.curve.lag.value == pytest.approx(LAG, rel=0.1)
    half = IDLE + GAIN * 0.35**POWER
    curve = draft.curve
    assert curve.offset.value + curve.gain.value * 0.35**curve.power.value == pytest.approx(half, rel=0.01)
    side = 0.1 / np.sqrt(2.0)
    assert draft.values["inertia_x"].value == pytest.approx(side * MASS * LIFT / SIZES[0], rel=0.06)


def test_a_flight_without_speeds_gives_thrusts(tmp_path: Path) -> None:
    draft = draft_vehicle([write_flight(tmp_path / "commands.csv", 5, speeds=False)], arm=0.1)
    assert draft.force_mode
    assert draft.values["mass"].is_assumed
    assert any("--mass-kg" in question for question in draft.questions)
    assert draft.values["hover_thrust"].is_assumed
    assert draft.values["largest_thrust"].is_assumed


def test_a_layout_that_the_flight_contradicts_is_replaced(flights: list[Path], monkeypatch: pytest.MonkeyPatch) -> None:
    places = PLACES * (1.0, -1.0, 1.0)
    turned = RotorLayout(count=4, places=places, spins=(1, -1, -1, 1), source="the frame")
    monkeypatch.setattr(vehicle_from_log, "layout_in_log", lambda path, count, frame: turned)
    draft = draft_vehicle(flights[:1], mass=MASS, arm=0.1)
    assert draft.spins == SPINS
    np.testing.assert_array_equal(np.sign(draft.places[:, :2]), np.sign(PLACES[:, :2]))
    assert len(draft.notes) == 1


def raw_log(kind: str, **parameters: float | str) -> RawLog:
    return RawLog(path="log", format=kind, topics=(), parameters=parameters)


def px4(side: float, moment: float = 0.05) -> RawLog:
    places = ((side, side), (-side, -side), (side, -side), (-side, side))
    rows = {f"CA_ROTOR{k}_P{axis}": p for k, place in enumerate(places) for axis, p in zip("XY", place, strict=True)}
    moments = {f"CA_ROTOR{k}_KM": moment * (1 if k < 2 else -1) for k in range(4)}
    return raw_log("ulog", **rows, **moments, CA_ROTOR_COUNT=4.0)


def test_arms_of_1_m_and_the_default_moment_are_placeholders() -> None:
    real, placeholder = _px4_layout(px4(0.2, 0.02), 4), _px4_layout(px4(1.0), 4)
    assert (real.has_lengths, real.torque_ratio) == (True, 0.02)
    assert (placeholder.has_lengths, placeholder.torque_ratio) == (False, None)
    assert real.places is not None
    np.testing.assert_allclose(real.places[0], (0.2, -0.2, 0.0))
    assert real.spins == (1, 1, -1, -1)
    other = _layout_of_parameters(px4(0.2), 6)
    assert (other.places, len(other.notes)) == (None, 1)


def test_the_command_writes_a_file_that_loads(
    flights: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "vehicle.yaml"
    assert main(["robot", "from-log", str(flights[0]), "--out", str(out), "--mass-kg", "0.5", "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    robot = robot_by_name(out)
    assert robot.body.mass == 0.5
    assert [mount.spin for mount in robot.mounts.layout] == list(SPINS)
    assert all(
        value["origin"].split(":")[0].split(" [")[0] in ("given", "logged", "measured here", "assumed")
        for value in result["values"].values()
    )
    assert any("--arm-m" in question for question in result["questions"])
    assert (tmp_path / "vehicle.mapping.yaml").exists()


def test_a_log_without_flight_is_refused(flights: list[Path], tmp_path: Path) -> None:
    table = pd.read_csv(flights[0]).iloc[:800]
    table.to_csv(tmp_path / "short.csv", index=False)
    with pytest.raises(DataError):
        draft_vehicle([tmp_path / "short.csv"])


def test_a_flight_of_8_s_gives_its_lag(tmp_path: Path) -> None:
    draft = draft_vehicle([write_flight(tmp_path / "short.csv", 3, seconds=8.0, lag=0.04)], mass=MASS, arm=0.1)
    assert draft.curve is not None
    assert draft.curve.lag.value == pytest.approx(0.04, rel=0.1)
    assert draft.curve.lag.low < draft.curve.lag.value


@pytest.mark.parametrize("arm", [0.07, 0.083, 0.1, 0.113, 0.17])
def test_the_inertia_of_each_file_is_that_of_a_body(flights: list[Path], arm: float, tmp_path: Path) -> None:
    """The file holds x + y as the largest moment about z: rounded numbers may not exceed it."""
    (tmp_path / "vehicle.yaml").write_text(
        robot_yaml_with_origins(draft_vehicle(flights[:1], mass=MASS, arm=arm), name="a: 'b' #2")
    )
    assert robot_by_name(tmp_path / "vehicle.yaml").summary == "vehicle of a: 'b' #2"


def test_numbers_on_an_assumed_mass_or_arm_are_assumed(flights: list[Path], tmp_path: Path) -> None:
    """The length of the arms does not tell how wide the frame is; places of rotors do."""
    known, no_arm, none = (
        draft_vehicle(flights[:1], mass=m, arm=a) for m, a in ((MASS, 0.1), (MASS, None), (None, None))
    )
    assert {name for name, value in known.values.items() if value.is_assumed} == {
        "inertia_x", "inertia_y", "torque_ratio", "inertia_z", "largest_thrust", "speed_gain",
    }  # fmt: skip
    assert not no_arm.values["thrust"].is_assumed
    written = tmp_path / "robot.yaml"
    written.write_text(robot_yaml_with_origins(known, name="known"))
    placed = draft_vehicle(flights[:1], mass=MASS, frame=str(written))
    assert {name for name, value in placed.values.items() if value.is_assumed} == {
        "torque_ratio", "inertia_z", "largest_thrust", "speed_gain",
    }  # fmt: skip
    assert none.values["thrust"].is_assumed
    assert none.values["largest_thrust"].is_assumed


def test_the_mapping_turns_commands_into_the_measured_speeds(flights: list[Path], tmp_path: Path) -> None:
    (tmp_path / "m.yaml").write_text(draft_vehicle(flights[:1], mass=MASS, arm=0.1).mapping)
    log = read_flight_log(flights[0], mapping=find_mapping(tmp_path / "m.yaml"))
    assert log.rotor_command is not None
    assert log.rotor_speed is not None
    np.testing.assert_allclose(log.rotor_command.mean(axis=0), log.rotor_speed.mean(axis=0), rtol=0.01)
    np.testing.assert_allclose(log.rotor_command.std(axis=0), log.rotor_speed.std(axis=0), rtol=0.2)


def test_a_thrust_curve_becomes_a_power_law_at_the_mean_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The command is logged too slowly to show its own curve."""
    layout = replace(QUAD, law=ThrustLaw(square=0.65))
    monkeypatch.setattr(vehicle_from_log, "layout_in_log", lambda path, count, frame: layout)
    monkeypatch.setattr(vehicle_from_log, "fit_thrust_power", lambda logs: None)
    draft = draft_vehicle([write_flight(tmp_path / "commands.csv", 5, speeds=False)], mass=MASS, arm=0.1)
    (tmp_path / "m.yaml").write_text(draft.mapping)
    law = find_mapping(tmp_path / "m.yaml").rotor_command
    assert law is not None
    for u in (0.33, 0.35, 0.37):
        thrust = draft.values["largest_thrust"].value * (0.65 * u**2 + 0.35 * u)
        assert law.gain * u**law.power == pytest.approx(thrust, rel=2e-3)
    assert draft.values["hover_thrust"].kind == "measured"
    assert draft.values["largest_thrust"].is_assumed  # by a curve that the flight does not show


def test_fast_commands_show_the_exponent_of_their_thrust(tmp_path: Path) -> None:
    """By the slope of ``(IDLE + GAIN u^POWER)²``; the lag of the speeds is that of the thrust."""
    path = write_flight(tmp_path / "commands.csv", 5, speeds=False)
    draft = draft_vehicle([path], mass=MASS, arm=0.1)
    part = GAIN * 0.35**POWER
    exponent = draft.values["thrust_exponent"]
    assert exponent.value == pytest.approx(2.0 * POWER * part / (IDLE + part), rel=0.05)
    assert exponent.origin.startswith("measured here")
    assert draft.values["lag"].value == pytest.approx(LAG, rel=0.3)
    hover, full = (draft.values[f"{name}_thrust"] for name in ("hover", "largest"))
    assert hover.value == pytest.approx(full.value * mean_command(read_flights([path])) ** exponent.value, rel=1e-6)
    assert hover.kind == "measured"
    assert full.is_assumed  # far beyond the commands of this flight


def test_a_thrust_beyond_the_flight_is_assumed(flights: list[Path]) -> None:
    """Commands reach 0.6 of full, so that speed and thrust of a full command are extrapolated."""
    draft = draft_vehicle(flights[:1], mass=MASS, arm=0.1)
    assert draft.curve is not None
    assert draft.curve.reached < 0.8 * draft.curve.full_speed
    assert {draft.values[name].kind for name in ("largest_thrust", "speed_gain")} == {"assumed"}


def test_inputs_that_would_turn_the_vehicle_give_a_note(tmp_path: Path) -> None:
    """Slow commands do not show the spins; those of each sign are 0.3 and 0.6 of full in one log, equal in the other."""
    path = write_flight(tmp_path / "slow.csv", 5, speeds=False)
    slow, table = replace(find_mapping("aerial_gym"), torques=False), pd.read_csv(path)
    commands, spins = [f"cmd_{k + 1}" for k in range(4)], np.array(frame_layout("quad_x", 4).spins)
    for ratio, notes in ((1.0, 0), (0.5, 1)):
        table.assign(**(table[commands] * np.where(spins > 0, ratio, 1.0))).to_csv(path, index=False)
        draft = draft_vehicle([path], mass=MASS, arm=0.1, frame="quad_x", mapping=slow)
        assert len(draft.notes) == notes


def test_the_lag_beside_a_dead_time_is_within_its_interval(flights: list[Path], tmp_path: Path) -> None:
    """One lag alone absorbs the dead time of 7.5 ms."""
    table = pd.read_csv(flights[0])
    commands = [name for name in table if name.startswith("cmd_")]
    table[commands] = table[commands].shift(-3).ffill()
    table.to_csv(tmp_path / "dead.csv", index=False)
    curve = draft_vehicle([tmp_path / "dead.csv"], mass=MASS, arm=0.1).curve
    assert curve is not None
    assert curve.lag.low < LAG < 0.9 * curve.lag.value


def test_slow_commands_show_an_exponent_that_contradicts_the_log(tmp_path: Path) -> None:
    """PX4's default curve is straight, but thrust follows the square of the command: its file must hold for the same log."""
    table = flat_flights.flight(3, seconds=20.0, noise=1.0)
    parts = ulog_files.topics(table)
    stamp, share = parts.pop("esc_status")["timestamp"][::10], table.filter(like="rotor_").to_numpy()[::20] / 1600.0
    parts["actuator_motors"] = {"timestamp": stamp} | {f"control[{i}]": share[:, i] for i in range(4)}
    path = ulog_files.write_ulog(tmp_path / "a.ulg", parts, {"THR_MDL_FAC": 0.0})
    draft = draft_vehicle([path], mass=0.6, arm=0.14, frame="quad_x")
    (tmp_path / "m.yaml").write_text(draft.mapping)
    law = find_mapping(tmp_path / "m.yaml").rotor_command
    assert law is not None
    assert law.power == pytest.approx(draft.values["thrust_exponent"].value)
    assert draft.mapping.count("\n") == 4  # no other column
    assert draft.values["thrust_exponent"].value == pytest.approx(2.0, rel=0.05)
    assert draft.values["thrust_exponent"].origin.startswith("measured here")


def test_curves_of_firmwares() -> None:
    """ArduPilot: expo between MOT_SPIN_MIN and MOT_SPIN_MAX. Betaflight: square of the duty cycle, with idle of 5.5 %."""
    ardupilot = _ardupilot_thrust_law(raw_log("dataflash", MOT_SPIN_MIN=0.15, MOT_SPIN_MAX=0.95, MOT_THST_EXPO=0.65))
    np.testing.assert_allclose(
        ardupilot.share(np.array((0.1, 0.55, 0.95))), (0.0, 0.65 / 4 + 0.35 / 2, 1.0), atol=1e-12
    )
    betaflight = _betaflight_thrust_law(raw_log("blackbox", motorOutput="158,2047"))
    duty = (110.0 + 0.4 * 1889.0) / 1999.0
    assert betaflight.share(np.array(0.4)) / betaflight.share(np.array(1.0)) == pytest.approx(duty**2)
    assert betaflight.slope(0.4) == pytest.approx(2.0 * 0.4 * 1889.0 / 1999.0 / duty, rel=1e-4)


@pytest.mark.parametrize("name", FRAMES)
def test_frames_hover_without_torque(name: str) -> None:
    """Equal thrusts give no roll, pitch or yaw, but for the pitch of Y frames, whose rear arm has another length."""
    layout = frame_layout(name, len(FRAMES[name].split()))
    weights = layout.weights
    assert weights is not None
    balanced = weights.sum(axis=1)
    assert abs(balanced[0]) < 1e-9
    assert name.startswith("y") or abs(balanced[1]) < 1e-9
    assert balanced[2] == 0.0
    assert np.linalg.matrix_rank(np.vstack((weights, np.ones(layout.count)))) == 4


def test_logs_state_frames_and_what_is_beyond_rotors() -> None:
    assert _layout_of_parameters(raw_log("dataflash", FRAME_CLASS=2.0, FRAME_TYPE=13.0), 6).spins == (
        1,
        -1,
        1,
        -1,
        1,
        -1,
    )
    assert _layout_of_parameters(raw_log("dataflash", FRAME_CLASS=5.0, FRAME_TYPE=10.0), 6).spins == (
        -1,
        1,
        -1,
        1,
        -1,
        1,
    )
    assert (
        _layout_of_parameters(raw_log("ulog", SYS_AUTOSTART=12001.0), 8).spins == frame_layout("coax_quad_x", 8).spins
    )
    unknown = _layout_of_parameters(raw_log("dataflash", FRAME_CLASS=1.0, FRAME_TYPE=4.0), 4)
    assert unknown.places is None
    tail_sitter = _layout_of_parameters(raw_log("ulog", CA_AIRFRAME=4.0, CA_ROTOR_COUNT=4.0), 4)
    assert len(tail_sitter.notes) == 1
    assert _layout_of_parameters(raw_log("blackbox", motorOutput="48,2047"), 6).origin == "assumed"


def test_the_order_of_six_rotors_follows_from_the_flight(tmp_path: Path) -> None:
    """A log without a frame: the default hexa_x has another order."""
    draft = draft_vehicle([write_flight(tmp_path / "hexa.csv", 7, frame="hexa_plus_betaflight")], mass=MASS, arm=0.1)
    truth = frame_layout("hexa_plus_betaflight", 6)
    assert truth.places is not None
    np.testing.assert_allclose(draft.places, 0.1 * truth.places, atol=0.01)
    assert draft.spins == truth.spins
    assert not any("--frame" in question for question in draft.questions)


def test_a_frame_is_given_by_name_or_robot_file(tmp_path: Path) -> None:
    """Slow commands show no rotors; without a frame a common one is assumed, and the command asks."""
    path = write_flight(tmp_path / "slow.csv", 5, speeds=False)
    slow = replace(find_mapping("aerial_gym"), torques=False)
    assumed = draft_vehicle([path], mass=MASS, arm=0.1, mapping=slow)
    assert any("--frame" in question for question in assumed.questions)
    named = draft_vehicle([path], mass=MASS, arm=0.1, mapping=slow, frame="quad_plus")
    np.testing.assert_allclose(named.places[0], (0.0, -0.1, 0.0), atol=1e-12)
    (tmp_path / "robot.yaml").write_text(robot_yaml_with_origins(named, name="plus"))
    again = draft_vehicle([path], mass=MASS, mapping=slow, frame=str(tmp_path / "robot.yaml"))
    np.testing.assert_allclose(again.places, named.places, atol=1e-5)
    assert "arm" not in again.values
    for wrong in ("hexa_x", "quadx"):
        with pytest.raises((ConfigError, UnknownNameError)):
            draft_vehicle([path], mass=MASS, arm=0.1, mapping=slow, frame=wrong)


def test_a_load_in_part_of_the_flight_makes_the_thrust_an_assumption(tmp_path: Path) -> None:
    draft = draft_vehicle([write_flight(tmp_path / "load.csv", 3, load=1.6)], mass=MASS, arm=0.1)
    assert draft.values["thrust"].is_assumed
    assert len(draft.questions) == 1


def test_wrong_masses_logs_and_layouts_are_refused(
    flights: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for mass, arm in ((-1.0, 0.1), (0.5, -0.1), (float("nan"), 0.1), (0.5, 0.0)):
        with pytest.raises(ConfigError):
            draft_vehicle(flights[:1], mass=mass, arm=arm)
    table = pd.read_csv(flights[0])
    table.assign(acc_z=0.4 * table.acc_z).to_csv(tmp_path / "light.csv", index=False)
    with pytest.raises(DataError, match="accelerometer"):
        draft_vehicle([tmp_path / "light.csv"], mass=MASS, arm=0.1)
    layouts = {str(path): replace(QUAD, places=float(k) * PLACES) for k, path in enumerate(flights, 1)}
    monkeypatch.setattr(vehicle_from_log, "layout_in_log", lambda path, count, frame: layouts[path])
    with pytest.raises(DataError, match="one vehicle"):
        draft_vehicle(flights, mass=MASS, arm=0.1)


def test_a_logged_torque_ratio_that_no_body_can_have_is_not_used() -> None:
    values = {name: ValueWithOrigin(value=1e-3, origin="given") for name in ("mass", "inertia_x", "inertia_y")}
    sizes = tuple(vehicle_from_log.Estimate.from_half_width(3e-6, 1e-7) for _ in range(4))
    known, weights = np.ones(3, dtype=bool), np.asarray(SIGNS, dtype=np.float64)
    effect = vehicle_from_log.Effectiveness(weights=weights, known=known, measured=~known, sizes=sizes)
    notes = list[str]()
    for ratio, used in ((0.01, True), (0.05, False)):
        layout = RotorLayout(count=4, torque_ratio=ratio)
        torque_ratio, inertia = _torque_ratio_and_yaw_inertia(layout, effect, 3e-7, values, notes)
        assert (torque_ratio.value == ratio) is used
        assert inertia.value < 2e-3 * (1.0 + 1e-9)
    assert len(notes) == 1


def test_a_velocity_replaces_the_accelerometer(flights: list[Path], tmp_path: Path) -> None:
    table = pd.read_csv(flights[0])
    rise = np.cumsum(table.acc_z - 9.80665) / RATE
    table = table.drop(columns=["acc_x", "acc_y", "acc_z"]).assign(v_x=0.0, v_y=0.0, v_z=rise)
    table.to_csv(tmp_path / "velocity.csv", index=False)
    thrust = draft_vehicle([tmp_path / "velocity.csv"], mass=MASS, arm=0.1).values["thrust"].value
    assert thrust == pytest.approx(MASS * LIFT, rel=0.03)
