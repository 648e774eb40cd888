"""Round trips of flights that the simulator itself has flown: exact in the true vehicle, worse with a planted error."""

import json
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import torch
from scipy.spatial.transform import Rotation

from aerial_gym.config.autopilots import BetaflightCfg, Px4Cfg
from aerial_gym.config.controller import ControllerCfg
from aerial_gym.config.robot import RobotCfg
from aerial_gym.config.sim import STANDARD_GRAVITY
from aerial_gym.control.catalog import CONTROLLERS
from aerial_gym.control.controllers import make_controller
from aerial_gym.errors import ConfigError, DataError
from aerial_gym.physics import INTEGRATORS, BodyState, advance_remembering, build_model, vehicle_from_config
from aerial_gym.physics.law_memory import fresh_law_memory
from aerial_gym.physics.rotors import rotor_thrust
from aerial_gym.robots.catalog import robot_by_name
from aerial_gym.sim2real import replay
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.logs.flights import Flight, complete_flight
from aerial_gym.sim2real.logs.recording import FlightLog
from aerial_gym.sim2real.predict.round_trip import trip
from aerial_gym.sim2real.predict.round_trip.autopilot import (
    autopilot_of_flight,
    betaflight_parameters,
    px4_parameters,
)
from aerial_gym.sim2real.predict.rows.batches import expand_vehicle
from tests.repetitions import rare_values

PX4 = {
    **{f"MC_{axis}RATE_{key}": value for axis in ("ROLL", "PITCH") for key, value in (("P", 0.15), ("I", 0.2), ("D", 0.003))},
    **{"MC_YAWRATE_P": 0.2, "MC_YAWRATE_I": 0.1, "MC_ROLL_P": 6.5, "MC_PITCH_P": 6.5, "MC_YAW_P": 2.8, "MC_YAW_WEIGHT": 0.4},
    **{"MPC_XY_P": 0.95, "MPC_Z_P": 1.0, "MPC_XY_VEL_P_ACC": 1.8, "MPC_Z_VEL_P_ACC": 4.0, "MPC_XY_VEL_I_ACC": 0.4},
    **{"MPC_Z_VEL_I_ACC": 2.0, "MPC_THR_HOVER": 0.5, "MPC_THR_MIN": 0.12, "MPC_TILTMAX_AIR": 45.0, "THR_MDL_FAC": 0.0},
    **{f"MC_{axis}R_INT_LIM": 0.3 for axis in "RPY"},
    **{"MC_AIRMODE": 0, "IMU_GYRO_CUTOFF": 40.0, "IMU_DGYRO_CUTOFF": 30.0},
}  # fmt: skip
BETAFLIGHT = {
    **{"Firmware revision": "Betaflight 4.5.1 (77d01ba3b) STM32F405", "rollPID": "45,80,40", "pitchPID": "47,84,46"},
    **{
        "yawPID": "45,80,0",
        "d_min": "30,34,0",
        "ff_weight": "120,125,120",
        "features": 1 << 22,
        "iterm_relax": 1,
        "tpa_mode": 1,
    },
    **{"gyro_lpf1_type": 0, "gyro_lpf1_static_hz": 0.0, "gyro_lpf1_dyn_hz": "225,450", "dterm_lpf1_static_hz": 75.0},
}


@pytest.fixture(autouse=True)
def _short_windows(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(trip, "TRIP_HORIZONS_S", (0.5,))


def fly(
    robot: RobotCfg, cfg: ControllerCfg, action: Callable[[float], Array], step: float, seconds: float = 1.1
) -> dict[str, Array]:
    """Return the rows of a flight from hover, by column, with the command that acts from each row on."""
    vehicle = vehicle_from_config(robot, num_envs=1, dtype=torch.float64)
    law: Any = make_controller(cfg, vehicle, STANDARD_GRAVITY, dt=step, control=robot.control)
    model, zero = build_model(vehicle), torch.zeros(1, 3, dtype=torch.float64)
    hover = law.allocation.speed(law.allocation.inverse[..., 2] * float(vehicle.mass[0]) * STANDARD_GRAVITY)
    level = torch.tensor([[0.0, 0.0, 0.0, 1.0]], dtype=torch.float64)
    state = BodyState(position=zero, attitude=level, lin_vel=zero, ang_vel=zero, rotor_speed=hover)
    memory, rows = fresh_law_memory(law.needs, 1, zero), []
    with torch.inference_mode():
        for row in range(round(seconds / step)):
            asked = action(row * step)
            command, memory = law.command(state, torch.from_numpy(asked)[None], memory)
            rows.append([*(value[0].numpy() for value in vars(state).values()), command[0].numpy(), asked])
            state, _ = advance_remembering(model, INTEGRATORS["rk4"], None, state, command, step, 1, None)
    names = (*vars(state), "rotor_command", "action")
    return {name: np.stack(column) for name, column in zip(names, zip(*rows, strict=True), strict=True)}


def flight_of_rows(rows: Mapping[str, Array], step: float, setpoints: Mapping[str, Array], **more: Any) -> Flight:
    time = step * np.arange(len(rows["position"]))
    measured = {name: values for name, values in rows.items() if name != "action"}
    asked = {name: (time, values) for name, values in setpoints.items()}
    return complete_flight(FlightLog(path="a", time=time, setpoints=asked, **measured, **more))


def waves(*sizes: float) -> Callable[[float], Array]:
    """Return smooth actions of different frequencies."""
    return lambda time: np.array([size * np.sin((7.0 + 2.0 * k) * time) for k, size in enumerate(sizes)])


@cache
def px4_flight(level: str) -> tuple[RobotCfg, Flight]:
    """A flight of PX4 at one level, with logged parameters; the action of an attitude is roll, pitch and the present yaw."""
    robot = replace(robot_by_name("x500"), battery=None)
    name = {"rates": "rate"}.get(level, level)
    cfg = CONTROLLERS.get(f"px4_{name}_control")
    cfg = replace(cfg, px4=Px4Cfg(**px4_parameters(PX4)))
    sizes = {"rates": (0.1, 1.0, 1.0, 0.5), "attitude": (0.1, 0.2, 0.2, 0.0), "position": (0.4, 0.3, 0.2, 0.3)}[level]
    rows = fly(robot, cfg, waves(*sizes), 0.002)
    action = rows["action"]
    asked = {"thrust_setpoint": 0.5 * (1.0 + action[:, :1])}
    if level == "rates":
        asked["rate_setpoint"] = action[:, 1:]
    elif level == "attitude":
        yaw = Rotation.from_quat(rows["attitude"]).as_euler("ZYX")[:, :1]
        asked["attitude_setpoint"] = Rotation.from_euler("ZYX", np.hstack((yaw, action[:, 2:0:-1]))).as_quat()
    else:
        asked = {"position_setpoint": action[:, :3], "yaw_setpoint": action[:, 3:]}
    return robot, flight_of_rows(rows, 0.002, asked, parameters=PX4, log_format="ulog")


def betaflight_flight() -> tuple[RobotCfg, Flight]:
    """A flight of Betaflight's rate loop around a throttle of 0.45."""
    robot = replace(robot_by_name("racing_quadrotor"), battery=None)
    cfg = CONTROLLERS.get("betaflight_rate_control")
    cfg = replace(cfg, betaflight=BetaflightCfg(**betaflight_parameters(BETAFLIGHT)))
    vehicle = vehicle_from_config(robot, num_envs=1, dtype=torch.float64)
    throttle, weight = 0.45, robot.body.mass * STANDARD_GRAVITY
    lift = rotor_thrust(vehicle, vehicle.speed_low + throttle * (vehicle.speed_high - vehicle.speed_low)).sum()
    rates = waves(0.0, 2.0, 2.0, 1.0)
    rows = fly(robot, cfg, lambda time: rates(time) + np.array([float(lift) / weight - 1.0, 0.0, 0.0, 0.0]), 0.001)
    asked = {"rate_setpoint": rows["action"][:, 1:], "thrust_setpoint": np.full((len(rows["action"]), 1), throttle)}
    return robot, flight_of_rows(rows, 0.001, asked, parameters=BETAFLIGHT, log_format="blackbox")


def crazyflie_flight() -> tuple[RobotCfg, Flight]:
    """A flight of the Crazyflie's cascade with the parameters of the robot file."""
    robot = replace(robot_by_name("crazyflie_21"), battery=None, effects={})
    rows = fly(robot, CONTROLLERS.get("crazyflie_pid_control"), waves(0.3, 0.3, 0.2, 0.3), 0.002)
    asked = {"position_setpoint": rows["action"][:, :3], "yaw_setpoint": rows["action"][:, 3:]}
    return robot, flight_of_rows(rows, 0.002, asked, log_format="crazyflie")


FLIGHTS = {
    **{f"px4_{level}": lambda level=level: px4_flight(level) for level in ("rates", "attitude", "position")},
    "betaflight": betaflight_flight, "crazyflie": crazyflie_flight,
}  # fmt: skip


def robot_with_slow_rotors(robot: RobotCfg, factor: float) -> RobotCfg:
    """Return a robot whose rotors follow commands ``factor`` times as slowly."""
    assert robot.rotor is not None
    times = {name: factor * getattr(robot.rotor, name) for name in ("time_constant_up", "time_constant_down")}
    return replace(robot, rotor=replace(robot.rotor, **times))


@pytest.mark.parametrize("name", rare_values(FLIGHTS, ("px4_rates", "px4_position", "crazyflie")))
def test_the_true_vehicle_repeats_its_flight_and_a_planted_error_does_not(name: str) -> None:
    """The law and the integrator are those of the flight, so that only the mean of the gyro by the trapezoidal rule is off.
    Corrected is the declared vehicle with the effect that removes the planted error."""
    truth, flight = FLIGHTS[name]()
    assert truth.rotor is not None
    up, down = truth.rotor.time_constant_up, truth.rotor.time_constant_down
    declared = robot_with_slow_rotors(replace(truth, body=replace(truth.body, mass=truth.body.mass / 1.2)), 2.0)
    lag = {"motor_asymmetry": {"tau_up": up, "tau_down": down}, "payload_mass": {"dm": truth.body.mass / 6.0}}
    result = trip.fly_round_trip({"declared": declared, "corrected": replace(declared, effects=lag)}, [flight])
    (level,) = result.levels
    assert level.level == {"betaflight": "rates", "crazyflie": "position"}.get(name, name.removeprefix("px4_"))
    assert level.windows.row.size >= 1
    first = {vehicle: {q: values[0, -1] for q, values in table.items()} for vehicle, table in level.errors.items()}
    for quantity, least in (("velocity", 0.02), ("attitude", 0.001), ("body_rate", 0.01)):
        assert abs(first["corrected"][quantity]) < 1e-4
        assert first["declared"][quantity] > least
    assert abs(first["corrected"]["mean_command"]) < 1e-5


def test_a_bias_of_the_gyro_changes_nothing() -> None:
    """The law controls corrected rates; the bias would else become a trim that turns the vehicle."""
    robot, flight = px4_flight("attitude")
    biased = replace(flight, ang_vel=flight.ang_vel + np.array([0.1, -0.05, 0.1]))
    own, other = (
        trip.fly_round_trip({"declared": robot}, [one]).levels[0].errors["declared"] for one in (flight, biased)
    )
    np.testing.assert_allclose(other["attitude"], own["attitude"], atol=1e-9)


def test_windows_without_all_setpoints_are_left_out() -> None:
    """A pause of the setpoints within the only window leaves none; no setpoints at all neither."""
    robot, flight = px4_flight("rates")
    time, values = flight.setpoints["rate_setpoint"]
    paused = (time < 0.7) | (time > 0.9)
    for setpoints in ({"rate_setpoint": (time[paused], values[paused])}, {}):
        asked = {"thrust_setpoint": flight.setpoints["thrust_setpoint"], **setpoints}
        with pytest.raises(DataError, match="no second in flight with all setpoints of px4_rate_control"):
            trip.fly_round_trip({"declared": robot}, [replace(flight, setpoints=asked)])


def test_each_horizon_has_all_windows_that_reach_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """The second window starts 0.1 s before the end of the log."""
    monkeypatch.setattr(trip, "TRIP_HORIZONS_S", (0.05, 0.5))
    robot, flight = px4_flight("rates")
    (level,) = trip.fly_round_trip({"declared": robot}, [flight]).levels
    np.testing.assert_array_equal(level.valid, ((True, True), (True, False)))
    assert level.rms("declared", "attitude")[0.5].value == level.errors["declared"]["attitude"][0, 1]


def test_another_law_stands_for_an_unknown_firmware() -> None:
    """INDIFLIGHT's own law is none of the three; its thrust per mass becomes that of the declared vehicle."""
    robot, flight = px4_flight("rates")
    time, thrust = flight.setpoints["thrust_setpoint"]
    vehicle = expand_vehicle(vehicle_from_config(robot, num_envs=1, dtype=torch.float64), time.size)
    speed = vehicle.speed_low + torch.from_numpy(thrust) * (vehicle.speed_high - vehicle.speed_low)
    lift = rotor_thrust(vehicle, speed).sum(-1, keepdim=True).numpy() / robot.body.mass
    asked = {"rate_setpoint": flight.setpoints["rate_setpoint"], "specific_thrust_setpoint": (time, lift)}
    own = replace(flight, setpoints=asked, log_format="blackbox", parameters={"Firmware revision": "Indiflight 5.0.0"})
    result = trip.fly_round_trip({"declared": robot}, [own])
    assert [finding.code for finding in result.findings] == ["controller_stands_in"]
    assert result.findings[0].values == {"firmware": "Indiflight", "controller": "px4"}
    autopilot = autopilot_of_flight(own, robot)
    law = autopilot.law("rates", robot, vehicle)
    actions = autopilot.actions("rates", own, law, vehicle)
    assert actions is not None
    np.testing.assert_allclose(
        actions[0][:, :1] * float(law.gains.unit_thrust[0, 0]), robot.body.mass * lift, rtol=1e-9
    )


def test_a_controller_that_follows_no_logged_setpoints_is_refused() -> None:
    robot, flight = px4_flight("rates")
    with pytest.raises(ConfigError, match="cannot follow recorded setpoints"):
        trip.fly_round_trip({"declared": robot}, [flight], controller="lee_velocity_control")


def test_a_corrected_robot_without_setpoints_is_refused() -> None:
    with pytest.raises(ConfigError, match="give setpoints"):
        replay("crazyflie_21", ["a.csv"], corrected="crazyflie_21")


def test_parameters_come_from_the_headers_of_betaflight() -> None:
    """Dynamic cut-offs begin at their lower end, and d_min is the derivative gain of a calm flight."""
    read = betaflight_parameters(BETAFLIGHT)
    assert [read[f"{gain}_roll"] for gain in "pidf"] == [45.0, 80.0, 30.0, 120.0]
    assert read["d_yaw"] == 0.0
    assert read["airmode"] is True
    assert (read["gyro_lpf1_type"], read["gyro_lpf1_static_hz"]) == ("PT1", 225.0)
    assert read["iterm_relax"] == "RP"


@pytest.mark.slow
def test_replay_flies_the_setpoints_of_a_csv_file(tmp_path: Path) -> None:
    """Columns sp_* hold the setpoints; the control law is that of the robot file. Its integrals begin at zero in a window."""
    robot = replace(robot_by_name("crazyflie_21"), battery=None, effects={})
    rows = fly(robot, CONTROLLERS.get("crazyflie_pid_control"), waves(0.3, 0.3, 0.2, 0.3), 0.002, seconds=6.0)
    names = {
        "position": ["p_x", "p_y", "p_z"], "attitude": ["q_x", "q_y", "q_z", "q_w"], "lin_vel": ["v_x", "v_y", "v_z"],
        "ang_vel": ["omega_x", "omega_y", "omega_z"], "rotor_speed": [f"rotor_{n}" for n in range(1, 5)],
        "rotor_command": [f"cmd_{n}" for n in range(1, 5)], "action": ["sp_p_x", "sp_p_y", "sp_p_z", "sp_yaw"],
    }  # fmt: skip
    table = pd.concat([pd.DataFrame(rows[name], columns=columns) for name, columns in names.items()], axis=1)
    table.insert(0, "t", 0.002 * np.arange(len(table)))
    table.to_csv(tmp_path / "flight.csv", index=False)
    result = replay("crazyflie_21", [tmp_path / "flight.csv"], tmp_path / "out", setpoints=True)
    written = json.loads((tmp_path / "out" / "replay.json").read_text())["round_trip"]
    assert written["findings"][0]["code"] == "controller_flown"
    position = written["levels"]["position"]["position"]["declared"]["0.5"]
    assert position["rms"] < 0.05
    assert result.round_trip is not None


@pytest.mark.parametrize(
    ("release", "version"), [("4.5.1", "4.5"), ("4.2.9", "4.5"), ("4.6.0", "4.6"), ("2025.12.1", "4.6")]
)
def test_integrals_follow_the_release_of_betaflight(release: str, version: str) -> None:
    revision = f"Betaflight {release} (77d01ba3b) STM32F405"
    assert betaflight_parameters({"Firmware revision": revision})["version"] == version
