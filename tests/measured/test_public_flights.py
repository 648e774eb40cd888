"""The loop on public flights: what it names, and how much of the error it takes off flights that it has not fitted.
Every set of measured flights goes through its mapping: replayed, or refused with the reason.
"""

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from aerial_gym.errors import DataError
from aerial_gym.sim2real import close_loop, find_mapping, read_flight_log, replay
from benchmarks.scores.score_measured import write_log_part

DATA = Path(__file__).parents[2].parent / "shared" / "data"

pytestmark = pytest.mark.skipif(not DATA.is_dir(), reason=f"the measured flights are not on this machine: {DATA}")


def verdict_of_loop(
    robot: str, mapping: str, train: Sequence[str | Path], test: Sequence[str | Path], out: Path, **options: float
) -> dict:
    """Return the verdict on flights of one set, given as names, or as the files of their parts."""
    logs = [
        [DATA / mapping / f"{name}.csv" if isinstance(name, str) else name for name in part] for part in (train, test)
    ]
    close_loop(robot, *logs, out, mapping=mapping, **options)
    return json.loads((out / "verdict.json").read_text())


def position_errors(verdict: dict, horizon: str) -> list[float]:
    """Return the errors [m] before and after."""
    return [verdict[when]["rollout_given_attitude"][horizon]["position"]["rms"] for when in ("before", "after")]


@pytest.mark.slow
def test_drag_learned_at_other_wind_speeds_holds_at_an_unseen_one(tmp_path: Path) -> None:
    """A 2.6 kg quadrotor before a fan array (O'Connell et al., Science Robotics 2022). Trained at 0, 4.2 and 12.1 m/s,
    judged at 8.5 m/s; measured -85 %, -58 % and -80 % or more, held to 80 % of that. How the force is shared between
    drags that grow with the speed and with its square these flights hardly tell."""
    train = ("NF_nowind", "baseline_35wind", "indi_35wind", "baseline_100wind", "NF_100wind")
    test = ("NF_70wind", "baseline_70wind", "indi_70wind")
    verdict = verdict_of_loop("neural_fly_quad", "neural_fly", train, test, tmp_path / "out", bandwidth=5.0)
    assert {"rotor_drag", "quadratic_drag"} & {effect["name"] for effect in verdict["effects"]}
    before, after = (verdict[when]["specific_force"] for when in ("before", "after"))
    assert before["x"]["rms"] == pytest.approx(2.82, abs=0.05)
    assert after["x"]["rms"] < (1.0 - 0.8 * 0.83) * before["x"]["rms"]
    assert after["z"]["rms"] < (1.0 - 0.8 * 0.57) * before["z"]["rms"]
    assert after["y"]["rms"] < 1.02 * before["y"]["rms"]
    for horizon in ("0.5", "1", "2"):
        error = position_errors(verdict, horizon)
        assert error[1] < (1.0 - 0.8 * 0.77) * error[0]


@pytest.mark.slow
def test_drag_and_thrust_are_named_and_hold_on_other_shapes(tmp_path: Path) -> None:
    """A Crazyflie 2.1 of which duty cycles and battery voltage are known (NanoBench, arXiv 2603.09908). Trained on circle,
    eight, oval and star; measured -86, -61 and -97 % on trefoil and helix, held to 80 %."""
    train = ("B2_circle_fast_rep1", "B3_figure8_fast_rep1", "B7_oval_fast_rep1", "B8_star_medium_rep1")
    test = ("B9_trefoil_fast_rep1", "B5_helix_fast_rep1")
    verdict = verdict_of_loop("crazyflie_21", "nanobench_cf21", train, test, tmp_path / "out", bandwidth=4.0)
    assert {"rotor_drag", "h_force_flapping"} & {effect["name"] for effect in verdict["effects"]}
    assert {"thrust_coefficient", "payload_mass"} & set(verdict["candidates"])
    before, after = (verdict[when]["specific_force"] for when in ("before", "after"))
    for axis, fall in (("x", 0.86), ("y", 0.61), ("z", 0.97)):
        assert after[axis]["rms"] < (1.0 - 0.8 * fall) * before[axis]["rms"]
    for horizon in ("0.1", "0.5", "1", "2"):
        error = position_errors(verdict, horizon)
        assert error[1] < 0.25 * error[0]


def rms_at_heights(table: pd.DataFrame, flight: str, low: float, high: float) -> list[float]:
    """Return the residual along z [m/s²] between two heights [m], before and after."""
    rows = table[table["flight"] == flight]
    log = pd.read_csv(DATA / "neural_swarm" / f"{flight}.csv")
    height = np.interp(rows["t"] + log["t"].iloc[0], log["t"], log["pz"])
    near = rows[(height >= low) & (height < high)]
    return [float(np.sqrt(np.mean(near[f"specific_force_z_{when}"] ** 2))) for when in ("before", "after")]


@pytest.mark.slow
def test_the_ground_effect_is_named_and_holds_on_a_flight_not_fitted(tmp_path: Path) -> None:
    """Crazyflies that take off and land again and again (Shi et al., Neural-Swarm, ICRA 2020). Trained on three flights
    of three vehicles; measured -76 % below 0.13 m and -33 % from there to 0.3 m on the fourth, held to 80 % of that."""
    train = ("groundflight_cf50_a", "takeoff_cf52", "groundflight_cf101_parrot")
    verdict = verdict_of_loop("crazyflie_21", "neural_swarm", train, ("takeoff_cf50",), tmp_path, bandwidth=8.0)
    (effect,) = (one for one in verdict["effects"] if one["name"] == "ground_effect")
    assert effect["confidence"] > 0.99
    gains = effect["params"]  # measured_data.md 3.6: 9 to 15 % more thrust at 65 to 90 mm, which is 3 to 4 radii
    assert gains["k"] > 5.0 if effect["law"] == "formula" else gains["g2"] > 0.05
    table = pd.read_csv(tmp_path / "residuals.csv")
    near, above = (rms_at_heights(table, "takeoff_cf50", *heights) for heights in ((0.0, 0.13), (0.13, 0.3)))
    assert near[0] == pytest.approx(0.56, abs=0.05)
    assert near[1] < (1.0 - 0.8 * 0.76) * near[0]
    assert above[1] < (1.0 - 0.8 * 0.33) * above[0]  # a formula that acts too high up makes it larger
    high = [verdict[when]["specific_force"]["x"]["rms"] for when in ("before", "after")]
    assert high[1] == pytest.approx(high[0], rel=0.02)


@pytest.mark.slow
def test_a_wake_is_named_beside_vehicles_that_fly_alone(tmp_path: Path) -> None:
    """One Crazyflie passes below another (Neural-Swarm). Trained on the first passes and on two flights near the ground, of
    which neither has another vehicle; measured -38 % of the force along z in the later passes, held to 80 % of that."""
    for vehicle in ("cf50", "cf51"):
        log = pd.read_csv(DATA / "neural_swarm" / f"swap_ss_00_{vehicle}.csv")
        for name, rows in (("first", log["t"] < 14.0), ("later", log["t"] >= 14.0)):
            log[rows].to_csv(tmp_path / f"{name}_{vehicle}.csv", index=False)
    train = (tmp_path / "first_cf50.csv", "groundflight_cf50_a", "takeoff_cf52")
    verdict = verdict_of_loop(
        "crazyflie_21", "neural_swarm", train, (tmp_path / "later_cf50.csv",), tmp_path / "out", bandwidth=8.0
    )
    assert {"downwash", "ground_effect"} <= {effect["name"] for effect in verdict["effects"]}
    before, after = (verdict[when]["specific_force"]["z"]["rms"] for when in ("before", "after"))
    assert after < (1.0 - 0.8 * 0.38) * before


def without_rotor_speeds(folder: Path, *names: str) -> dict:
    """Return the verdict on a Crazyflie of which duty cycles, accelerometer and gyro are logged (Eschmann et al.,
    sysid.tools): the first halves of the logs train, the second halves test, as means of four rows, 126 Hz."""
    train, test = ([half(folder, name, number) for name in names] for number in (0, 1))
    return verdict_of_loop("crazyflie_2x_arpl", "arpl_crazyflie_imu", train, test, folder / "out")


def half(folder: Path, name: str, number: int) -> Path:
    log = pd.read_csv(DATA / "arpl_crazyflie_imu" / f"{name}.csv")
    rows = log[number * len(log) // 2 : (number + 1) * len(log) // 2].reset_index(drop=True)
    path = folder / f"{name}_{number}.csv"
    rows.groupby(rows.index // 4).mean().to_csv(path, index=False)
    return path


@pytest.mark.slow
def test_the_motor_lag_is_named_from_commands_alone(tmp_path: Path) -> None:
    """At 500 Hz -74 % of the force along z, -68 and -67 % of the torques; held to 80 % of that."""
    verdict = without_rotor_speeds(tmp_path, "log10", "log15")
    named = {effect["name"]: effect["params"] for effect in verdict["effects"]}
    lag = named.get("motor_time_constant") or named["motor_asymmetry"]
    assert 0.7 < named["thrust_coefficient"]["scale"] < 0.9  # a table of another motor, of 2015
    # measured_data.md 3.7: 0.07 to 0.08 s from three channels, with another law of thrust
    assert 0.03 < sum(lag.values()) / len(lag) < 0.1
    force = [verdict[when]["specific_force"]["z"]["rms"] for when in ("before", "after")]
    assert force[1] < (1.0 - 0.8 * 0.74) * force[0]
    before, after = (verdict[when]["angular_acceleration"] for when in ("before", "after"))
    assert after["x"]["rms"] < (1.0 - 0.8 * 0.68) * before["x"]["rms"]
    assert after["y"]["rms"] < (1.0 - 0.8 * 0.67) * before["y"]["rms"]


@pytest.mark.slow
def test_lag_and_inertia_of_the_rotors_are_named_together_with_a_flight_that_yaws(tmp_path: Path) -> None:
    """Either alone makes another axis worse; no mass takes the place of both, and no air where no speed is logged. The
    half of the yaw flight that no fit has seen gets better about every axis: 17.5 to 7.3, 22.1 to 12.8, 10.2 to 8.1
    rad/s²."""
    verdict = without_rotor_speeds(tmp_path, "log10", "log15", "log16_a")
    named = {effect["name"] for effect in verdict["effects"]}
    assert {"motor_time_constant", "rotor_inertia", "thrust_coefficient"} <= named
    assert not {"payload_mass", "h_force_flapping", "rotor_drag"} & named
    yawing = verdict["flights"]["log16_a_1"]
    assert all(yawing[f"angular_acceleration.{axis}"]["state"] == "better" for axis in "xyz")


@pytest.mark.parametrize(("robot", "flight", "bandwidth", "channels"), [
    ("crazyflie_21", "nanobench_cf21/B3_figure8_fast_rep1.csv", 4.0, 6),
    ("neural_fly_quad", "neural_fly/baseline_70wind.csv", 5.0, 3),
    ("crazyflie_21", "neural_swarm/takeoff_cf50.csv", 8.0, 6),
    pytest.param("crazyflie_2x_arpl", "arpl_crazyflie_imu/log15.csv", 10.0, 6, marks=pytest.mark.slow),
    ("crazyflie_21_brushless", "idsia_nanodrone/square_run2.csv", 10.0, 12),
])  # fmt: skip
def test_one_flight_of_each_set_is_replayed(robot: str, flight: str, bandwidth: float, channels: int) -> None:
    result = replay(robot, [DATA / flight], mapping=flight.split("/")[0], bandwidth=bandwidth)
    assert len(result.evaluation.channels) == channels
    assert all(rms.low <= rms.value <= rms.high for rms in result.evaluation.residual)


def test_neural_fly_before_any_fit_is_the_residual_of_the_study() -> None:
    """measured_data.md 3.5: 2.731 and 0.235 m/s² over four winds; the two flights of the middle winds lie around it."""
    flights = [DATA / "neural_fly" / f"NF_{wind}.csv" for wind in ("nowind", "35wind", "70wind", "100wind")]
    residual = replay("neural_fly_quad", flights, mapping="neural_fly", bandwidth=5.0).evaluation.residual
    assert residual[0].value == pytest.approx(2.731, rel=0.1)
    assert residual[1].value == pytest.approx(0.235, rel=0.2)


def test_crazypad_says_why_it_cannot_be_replayed() -> None:
    path = DATA / "crazypad" / "normal_flight_E9_log00.csv"
    with pytest.raises(DataError, match=r"has no attitude. No gyro and no full attitude .*cannot be replayed"):
        read_flight_log(path, mapping=find_mapping("crazypad"))


def test_the_passing_vehicle_is_found() -> None:
    log = read_flight_log(DATA / "neural_swarm" / "swap_ss_00_cf51.csv", mapping=find_mapping("neural_swarm"))
    assert log.other_position is not None
    assert log.battery is not None


@pytest.mark.slow
def test_the_wake_of_a_pair_is_named_beside_the_ground_effect_of_other_flights(tmp_path: Path) -> None:
    """Two Crazyflies that pass over each other, half of each log, and two ground flights (Neural-Swarm). Measured: vertical
    force error -39 % on the other half, held to 80 % of that."""
    parts = {
        (vehicle, number): write_log_part(DATA / "neural_swarm" / f"swap_ss_00_{vehicle}.csv", tmp_path, number)
        for vehicle in ("cf50", "cf51")
        for number in (0, 1)
    }
    pairs = [(parts["cf50", number], parts["cf51", number]) for number in (0, 1)]
    train = [
        *pairs[0][:1],
        *(DATA / "neural_swarm" / f"{name}.csv" for name in ("groundflight_cf50_a", "takeoff_cf52")),
    ]
    settings = {"mapping": "neural_swarm", "bandwidth": 8.0, "pairs": pairs}
    verdict = close_loop("crazyflie_21", train, pairs[1][:1], tmp_path / "out", **settings)
    assert {"downwash", "ground_effect_curve"} <= {effect.name for effect in verdict.effects}
    force = [
        result["specific_force"]["z"]["rms"] for result in (verdict.before.as_mapping(), verdict.after.as_mapping())
    ]
    assert force[1] < (1.0 - 0.8 * 0.39) * force[0]
