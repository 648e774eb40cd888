"""Bench identifications against curves whose numbers are known, and against integrated equations of motion."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.special import gamma

from aerial_gym.cli.main import main
from aerial_gym.config import load
from aerial_gym.config.joint import CreepCfg, SpringCfg
from aerial_gym.config.robot import RobotCfg, RotorCfg
from aerial_gym.errors import ConfigError, DataError
from aerial_gym.physics import rotor_state_for_thrust
from aerial_gym.sim2real.logs.recording import FlightLog
from aerial_gym.sim2real.teststand.hover import fit_hover
from aerial_gym.sim2real.teststand.joints.record import (
    ReleaseRecord,
    alternate_blocks,
    creep_elements,
    errors_on_alternate_blocks,
    fit_joint,
    law_angle,
    release_record,
)
from aerial_gym.sim2real.teststand.static import StaticFit, fit_static
from aerial_gym.sim2real.teststand.statistics import (
    estimates,
    fold_labels,
    hac_covariance,
    hc3_covariance,
    smallest_good_candidate,
)
from aerial_gym.sim2real.teststand.step import (
    StepRecord,
    difference_to_command_after_step,
    fit_steps,
    speed_of_law,
    step_record,
)
from aerial_gym.sim2real.teststand.studies import joint_law_yaml, rotor_fields_from_tests
from aerial_gym.sim2real.teststand.tables import read_columns

Array = NDArray[np.float64]

MAP = (0.02, -8e-5, 8.6e-7)  # Thrust [N] of the speed [rad/s]

RATIO = 0.014


def bench(table: pd.DataFrame, folder: Path, **units: str):
    path = folder / "bench.csv"
    table.to_csv(path, index=False)
    return read_columns(path, given={}, units=units)


def static_table(
    rng: np.random.Generator, noise: float, coefficients: tuple[float, float, float] = MAP
) -> pd.DataFrame:
    speed = np.linspace(200.0, 2000.0, 24)
    thrust = np.polyval(coefficients[::-1], speed)
    wrong = 1.0 + noise * rng.standard_normal((2, speed.size))  # a relative error: residuals of unequal size
    return pd.DataFrame({"omega": speed, "thrust_N": thrust * wrong[0], "torque_Nm": RATIO * thrust * wrong[1]})


def single_fit(table: pd.DataFrame, folder: Path, **units: str) -> StaticFit:
    (fit,), left_out = fit_static(bench(table, folder, **units))
    assert left_out == []
    return fit


def test_variance_of_a_mean_of_independent_values_is_its_closed_form() -> None:
    """HC3 of a mean: every residual over (1 - 1/n), squared, summed, over n²."""
    residual = np.random.default_rng(0).standard_normal(50)
    residual -= residual.mean()
    result = hc3_covariance(np.ones((50, 1)), residual)[0, 0]
    assert result == pytest.approx(((residual / (1.0 - 1.0 / 50)) ** 2).sum() / 50**2, rel=1e-12)


def test_variance_of_a_mean_of_correlated_values_is_its_closed_form() -> None:
    """AR(1): the variance of a mean is (1 + rho) / (1 - rho) times that of independent values (Anderson 1971, 8.3)."""
    rng, rho, rows = np.random.default_rng(1), 0.8, 200_000
    noise = rng.standard_normal(rows)
    values = np.empty(rows)
    values[0] = noise[0]
    for row in range(1, rows):
        values[row] = rho * values[row - 1] + noise[row]
    result = hac_covariance(np.ones((rows, 1)), values - values.mean())[0, 0] * rows
    assert result == pytest.approx(values.var() * (1.0 + rho) / (1.0 - rho), rel=0.1)


def test_flights_are_left_out_whole_and_a_single_one_in_fifths() -> None:
    assert fold_labels([2, 3]).tolist() == [0, 0, 1, 1, 1]
    assert fold_labels([10]).tolist() == [0, 0, 1, 1, 2, 2, 3, 3, 4, 4]


def test_fewer_terms_are_taken_if_they_cost_no_more_than_two_per_cent() -> None:
    terms = {"short": 1, "long": 2, "as long": 2}
    assert smallest_good_candidate({"short": 1.019, "long": 1.0, "as long": 1.0}, terms) == "short"
    assert smallest_good_candidate({"short": 1.021, "long": 1.01, "as long": 1.0}, terms) == "as long"


def test_intervals_hold_the_truth_as_often_as_they_say() -> None:
    """Slope of a line with correlated noise that grows with the regressor: 95 %, less what few rows cost."""
    rng, inside, draws, rows = np.random.default_rng(2), 0, 400, 300
    cause = np.column_stack((np.ones(rows), np.linspace(-1.0, 1.0, rows)))
    for _ in range(draws):
        shocks, noise = rng.standard_normal(rows), np.empty(rows)
        noise[0] = shocks[0]
        for row in range(1, rows):
            noise[row] = 0.6 * noise[row - 1] + shocks[row]
        effect = 2.0 * cause[:, 1] + noise * (0.5 + cause[:, 1] ** 2)
        gains = np.linalg.lstsq(cause, effect, rcond=None)[0]
        slope = estimates(gains, hac_covariance(cause, effect - cause @ gains), rows - 2)[1]
        inside += slope.low < 2.0 < slope.high
    assert 0.9 < inside / draws < 0.98


def test_the_map_and_the_ratio_are_found_and_the_intervals_hold_them(tmp_path: Path) -> None:
    fit = single_fit(static_table(np.random.default_rng(3), 0.01), tmp_path)
    assert fit.thrust_map.chosen in ("w² and w", "w², w and constant")
    assert fit.torque_map.chosen == "torque ratio"
    assert fit.torque_ratio.low < RATIO < fit.torque_ratio.high
    full = fit.thrust_map.candidates["w², w and constant"].params
    for power in range(3):
        assert full[f"c{power}"].low < MAP[power] < full[f"c{power}"].high
    assert fit.thrust_map.rms_chosen.value < fit.thrust_map.rms_squared_only.value


def test_held_out_errors_are_those_of_fits_without_the_row(tmp_path: Path) -> None:
    fit = single_fit(static_table(np.random.default_rng(8), 0.02), tmp_path)
    result = fit.thrust_map.candidates["w², w and constant"].held_out
    for row in range(fit.speed.size):
        rest = np.arange(fit.speed.size) != row
        expected = fit.thrust[row] - np.polyval(np.polyfit(fit.speed[rest], fit.thrust[rest], 2), fit.speed[row])
        assert result[row] == pytest.approx(expected, rel=1e-6, abs=1e-9)


def test_no_term_is_added_that_does_not_pay(tmp_path: Path) -> None:
    chosen = []
    for seed in range(20):
        fit = single_fit(static_table(np.random.default_rng(seed), 0.01, (0.0, 0.0, 8e-7)), tmp_path)
        best = min(fit.thrust_map.candidates.values(), key=lambda c: c.fit_rms)
        assert best.name in ("w², w and constant", "w³, w² and w")
        chosen.append(fit.thrust_map.chosen)
    assert chosen.count("w²") >= 12


@pytest.mark.parametrize(("column", "factor", "name", "units"), [
    ("omega", 30.0 / np.pi, "RPM", {}),
    ("omega", 30.0 / np.pi, "omega", {"speed": "rpm"}),
    ("omega", 0.5 / np.pi, "rps", {}),
    ("thrust_N", 1.0 / 9.80665e-3, "thrust_gf", {}),
    ("thrust_N", 1e3, "force", {"thrust": "mN"}),
    ("torque_Nm", 1e3, "torque_mNm", {}),
    ("torque_Nm", 1.0 / 9.80665e-5, "moment", {"torque": "gf cm"}),
])  # fmt: skip
def test_units_do_not_change_the_map(tmp_path, column, factor, name, units) -> None:
    table = static_table(np.random.default_rng(4), 0.01)
    plain = single_fit(table, tmp_path)
    changed = table.assign(**{column: table[column] * factor}).rename(columns={column: name})
    other = single_fit(changed, tmp_path, **units)
    assert other.thrust_coefficient.value == pytest.approx(plain.thrust_coefficient.value, rel=1e-9)
    assert other.torque_ratio.value == pytest.approx(plain.torque_ratio.value, rel=1e-9)


@pytest.mark.parametrize(("change", "message"), [
    (lambda t: t.assign(omega=t["omega"] * 60 / 6.28), r"must lie in \[0, 12000\].*--units speed rpm"),
    (lambda t: t.assign(torque_Nm=t["torque_Nm"] * 1e3), r"a unit is wrong. It would fit with .*torque in mN m"),
    (lambda t: t.assign(thrust_N=-t["thrust_N"]), r"thrust at the highest speed is .*invert its sign"),
    (lambda t: t.rename(columns={"thrust_N": "lift"}).drop(columns="torque_Nm"), r"no column for the thrust"),
    (lambda t: t[:5], r"has 5 different speeds, needs at least 6"),
    (lambda t: t.rename(columns={"thrust_N": "thrust_total_N"}), r"of several motors; say how many"),
    (lambda t: t.assign(torque_Nm="x"), r"line 2: torque_Nm = x is no number"),
])  # fmt: skip
def test_tables_that_are_not_what_they_claim(tmp_path: Path, change: object, message: str) -> None:
    table = change(static_table(np.random.default_rng(5), 0.01))
    with pytest.raises(DataError, match=message):
        fit_static(bench(table, tmp_path))


SPEEDS = np.linspace(400.0, 2200.0, 9)  # [rad/s]
RPM, GRAMS = SPEEDS * 30.0 / np.pi, 8.6e-7 * SPEEDS**2 / 9.80665e-3
WATTS = 25.0 * GRAMS * 9.80665e-3
FORMS = {  # As motor makers and test stands print them
    "g, rpm": {"Throttle": [f"{n}0%" for n in range(1, 10)], "Thrust(g)": GRAMS, "RPM": RPM, "Efficiency(g/W)": GRAMS / WATTS},
    "pull": {"Propeller": ["5 inch", *[""] * 8], "Voltage (V)": 16.0, "Load Current (A)": WATTS / 16.0, "Pull(g)": GRAMS,
             "RPM": [f"{round(n):,}" for n in RPM], "Power(W)": WATTS},
    "kgf": {"Time (s)": SPEEDS, "ESC signal (µs)": 1500, "Torque (N·m)": 1e-8 * SPEEDS**2, "Thrust (kgf)": GRAMS / 1e3,
            "Motor Electrical Speed (RPM)": 0, "Motor Optical Speed (RPM)": RPM, "Overall Efficiency (kgf/W)": 0.01},
    "letters": {"PWM(us)": 1500, "N(RPM)": RPM, "F(KG)": GRAMS / 1e3, "T(N.M)": 1e-8 * SPEEDS**2},
    "short": {"Thr (%)": 50, "Thr (g)": GRAMS, "RPM": RPM, "Vol (V)": 11.1, "Cur (A)": WATTS / 11.1, "Pow (w)": WATTS},
    "imperial": {"Thrust [oz]": GRAMS / 28.349523, "Speed [rpm]": RPM, "Torque [oz-in]": 1e-8 * SPEEDS**2 / 7.0615518e-3},
}  # fmt: skip


@pytest.mark.parametrize("form", FORMS)
def test_tables_of_motor_makers_and_test_stands_are_known_by_their_columns(form, tmp_path) -> None:
    (fit,), _ = fit_static(bench(pd.DataFrame(FORMS[form]), tmp_path))
    assert fit.thrust_coefficient.value == pytest.approx(8.6e-7, rel=1e-4)
    if fit.torque is not None:
        assert fit.torque == pytest.approx(1e-8 * SPEEDS**2)


def test_a_row_of_units_and_several_propellers_are_read(tmp_path: Path) -> None:
    path = tmp_path / "two.csv"
    pairs = list(enumerate(zip(GRAMS, RPM, strict=True)))
    rows = [f"{prop if n == 0 else ''},{g:.3f},{rpm:.1f}" for prop in ("5x4", "6x4") for n, (g, rpm) in pairs]
    path.write_text("\n".join(["Prop,Thrust,Speed", "inch,g,r/min", *rows]), encoding="utf-8")
    fits, _ = fit_static(read_columns(path, given={}, units={}))
    assert [fit.name for fit in fits] == [f"{path}, test 5x4", f"{path}, test 6x4"]
    assert fits[1].thrust_coefficient.value == pytest.approx(8.6e-7, rel=1e-3)


def test_the_electric_power_of_a_table_shows_a_wrong_unit_of_thrust(tmp_path: Path) -> None:
    table = pd.DataFrame({"Thrust (N)": GRAMS, "RPM": RPM, "Voltage (V)": 16.0, "Current (A)": WATTS / 16.0})
    with pytest.raises(
        DataError, match=r"power over thrust is 0.245 m/s .* It would fit with thrust in gf or thrust in ozf"
    ):
        fit_static(bench(table, tmp_path))


def test_a_table_without_speeds_says_so(tmp_path: Path) -> None:
    table = pd.DataFrame({"Throttle (%)": range(10, 100, 10), "Thrust (g)": GRAMS, "Current (A)": 3.0})
    with pytest.raises(DataError, match="has no column for the speed"):
        fit_static(bench(table, tmp_path))


def test_a_speed_sensor_that_does_not_read_is_left_out_and_tests_are_told_apart(tmp_path: Path) -> None:
    table = static_table(np.random.default_rng(6), 0.005)
    table = pd.concat([table.assign(test="a"), table.assign(test="b"), table.assign(test="c", thrust_N=-1.0)])
    table.iloc[5, 0] = 0.0
    fits, left_out = fit_static(bench(table, tmp_path))
    assert [fit.speed.size for fit in fits] == [23, 24]
    assert [(note.code, note.values) for note in fits[0].notes] == [("rows_without_speed", {"rows": 1})]
    assert len(left_out) == 1
    assert "test c: thrust at the highest speed is -1 N" in left_out[0].values["error"]


@pytest.mark.parametrize(("error", "tau", "slew"), [(800.0, 0.05, 1e9), (800.0, 0.03, 9e3), (-800.0, 0.03, 9e3)])
def test_lag_with_a_slew_limit_solves_its_equation(error: float, tau: float, slew: float) -> None:
    """Integrated by scipy to 1e-9: ``e' = -min(|e| / tau, slew) sign(e)``."""
    since = np.linspace(0.0, 0.3, 40)

    def motion(_: float, e: Array) -> Array:
        return -np.sign(e) * np.minimum(np.abs(e) / tau, slew)

    result = solve_ivp(motion, (0.0, 0.3), [error], t_eval=since, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(difference_to_command_after_step(error, tau, slew, since), result.y[0], atol=1e-5)
    assert difference_to_command_after_step(error, tau, slew, np.array([-0.01]))[0] == error


LEVELS = (300.0, 1500.0, 400.0, 2000.0, 900.0, 1700.0, 250.0, 1200.0)


def step_table(params: dict[str, float], *, noise: float, seed: int = 0, rate: float = 200.0) -> pd.DataFrame:
    time = np.arange(round(0.5 * rate) * len(LEVELS)) / rate
    command = np.repeat(LEVELS, round(0.5 * rate))
    table = pd.DataFrame({"t": time, "speed_cmd": command, "speed_meas": 0.0 * time})
    starts = np.arange(0, time.size + 1, round(0.5 * rate))
    record = StepRecord(path="", time=time, command=command, measured=0.0 * time, starts=starts)
    course = speed_of_law(record, params)
    return table.assign(speed_meas=course + noise * np.random.default_rng(seed).standard_normal(time.size))


@pytest.mark.parametrize(("params", "law"), [
    ({"tau": 0.04}, "one time constant"),
    pytest.param({"tau_up": 0.03, "tau_down": 0.06}, "up and down", marks=pytest.mark.slow),
    ({"tau_up": 0.03, "tau_down": 0.06, "delay": 0.012}, "up and down, delay"),
    pytest.param({"tau": 0.03, "slew_down": 2e4}, "one time constant, slew limit down", marks=pytest.mark.slow),
    ({"tau": 0.03, "slew_up": 3e4, "slew_down": 2e4}, "one time constant, slew limits"),
])  # fmt: skip
def test_steps_name_the_law_that_made_them(tmp_path: Path, params: dict[str, float], law: str) -> None:
    fit = fit_steps([step_record(bench(step_table(params, noise=4.0), tmp_path))])
    assert fit.chosen == law
    for name, value in params.items():
        result = fit.laws[law].params[name]
        assert abs(result.value - value) < result.high - result.low  # two half widths: eleven numbers are checked
        assert result.high - result.low < 0.2 * value
    assert fit.laws[law].held_out_rms == pytest.approx(4.0, rel=0.1)


def test_a_slew_limit_that_no_step_reaches_is_only_bounded_from_one_side(tmp_path: Path) -> None:
    fit = fit_steps([step_record(bench(step_table({"tau": 0.04}, noise=3.0), tmp_path))])
    slew = fit.laws["up and down, slew limits"].params["slew_up"]
    assert slew.high == 1e7
    assert slew.low >= 1500.0 / 0.045


@pytest.mark.parametrize(("change", "message"), [
    (lambda t: t.assign(speed_cmd=np.linspace(0, 2000, len(t))), r"needs at least two steps of 5 rows"),
    (lambda t: t.assign(t=0.0), r"time does not increase"),
    (lambda t: t.drop(columns="speed_meas"), r"no column for the measured"),
])  # fmt: skip
def test_records_that_show_no_steps(tmp_path: Path, change: object, message: str) -> None:
    with pytest.raises(DataError, match=message):
        step_record(bench(change(step_table({"tau": 0.04}, noise=1.0)), tmp_path))


JOINT = {"stiffness": 4800.0, "damping": 60.0, "rest": 0.125}
JOINT |= {"stiffness_1": 3000.0, "time_1": 0.06, "stiffness_2": 1200.0, "time_2": 1.5}


def release(rate: float = 100.0, seconds: float = 12.0) -> ReleaseRecord:
    time = np.arange(round(seconds * rate)) / rate
    return ReleaseRecord(path="", time=time, angle=0.0 * time, start=0.4)


def test_creep_solves_the_generalised_maxwell_equations() -> None:
    """Integrated by scipy: two Maxwell elements in parallel with a spring and a damper."""

    def motion(_: float, x: Array) -> list[float]:
        away = x[0] - JOINT["rest"]
        pull = sum(JOINT[f"stiffness_{i}"] * (away - x[1 + i]) for i in (1, 2))
        creep = [(away - x[1 + i]) / JOINT[f"time_{i}"] for i in (1, 2)]
        return [x[1], -JOINT["stiffness"] * away - JOINT["damping"] * x[1] - pull, *creep]

    record, options = release(), {"rtol": 1e-9, "atol": 1e-12, "method": "LSODA"}
    result = solve_ivp(motion, (0.0, 12.0), [0.4, 0.0, 0.275, 0.275], t_eval=record.time, **options)
    np.testing.assert_allclose(law_angle(record, JOINT), result.y[0], atol=1e-7)


def test_elements_of_a_power_law_relax_by_a_power() -> None:
    """``sum k_i exp(-t / T_i)`` is ``c Gamma(a) t^-a / h`` and a constant, h the logarithm of the ratio of two times.
    Elements that are left out, below 1 ms and above 32 s, and the steps between the others are within 2e-3 of it."""
    amount, exponent, step = 400.0, 0.43, 0.5 * np.log(10.0)
    stiffness, times = creep_elements({"creep": amount, "exponent": exponent})
    time = np.array([0.01, 0.03, 0.1, 0.3, 1.0])
    relaxed = (stiffness * np.exp(-time[:, None] / times)).sum(1)
    np.testing.assert_allclose(np.diff(relaxed), np.diff(amount * gamma(exponent) * time**-exponent / step), rtol=2e-3)


def test_a_joint_file_lists_the_elements_that_a_robot_file_has() -> None:
    power = {"stiffness": 1000.0, "damping": 60.0, "rest": 0.1, "creep": 400.0, "exponent": 0.43, "release": 0.002}
    written = yaml.safe_load(joint_law_yaml("linear spring, power-law creep", power))["joint"]
    assert "release" not in written
    assert written["creep"] == 400.0
    creep = SpringCfg(stiffness=1.0, creep=tuple(CreepCfg(**element) for element in written["elements"])).creep
    np.testing.assert_allclose([one.stiffness for one in creep], creep_elements(power)[0], rtol=1e-5)
    assert "elements" not in joint_law_yaml("linear spring", {"stiffness": 1000.0, "damping": 60.0, "rest": 0.1})


def test_what_is_held_out_of_alternate_blocks_does_not_change_its_prediction() -> None:
    params = {"stiffness": 4800.0, "damping": 60.0, "rest": 0.125}
    record = release(rate=200.0, seconds=0.6)
    record = replace(record, angle=law_angle(record, params))
    moved = replace(record, angle=record.angle + 0.01 * (alternate_blocks(record) == 1))
    odd = alternate_blocks(record) == 1
    assert 0.3 < odd.mean() < 0.7
    result, after = (errors_on_alternate_blocks("linear spring", each) for each in (record, moved))
    np.testing.assert_allclose(result, 0.0, atol=1e-5)
    np.testing.assert_allclose(after[odd], result[odd] + 0.01, atol=1e-9)
    assert np.abs(after[~odd] - result[~odd]).max() > 1e-3


def test_the_quadratic_spring_solves_its_equation_and_waits_for_the_release() -> None:
    params = {"quadratic_stiffness": 2400.0, "damping": 90.0, "rest": 0.13, "release": 0.05}
    record, options = release(), {"rtol": 1e-10, "atol": 1e-12, "method": "LSODA"}

    def motion(_: float, x: Array) -> list[float]:
        return [x[1], -2400.0 * abs(x[0] - 0.13) * (x[0] - 0.13) - 90.0 * x[1]]

    result = solve_ivp(motion, (0.0, 12.0), [0.4, 0.0], t_eval=record.time[:-5], **options)
    course = law_angle(record, params)
    np.testing.assert_allclose(course[:6], 0.4, atol=1e-12)
    np.testing.assert_allclose(course[5:], result.y[0], atol=1e-6)


@pytest.mark.slow
def test_creep_is_told_from_springs_and_its_numbers_are_found(tmp_path: Path) -> None:
    time = np.arange(-100, 1200) / 100.0
    record = ReleaseRecord(path="", time=time[time >= 0], angle=0.0 * time[time >= 0], start=0.4)
    angle = np.full(time.size, 0.4)
    angle[time >= 0] = law_angle(record, JOINT)
    angle += 5e-4 * np.random.default_rng(0).standard_normal(time.size)
    result = fit_joint(release_record(bench(pd.DataFrame({"t": time, "angle_deg": np.degrees(angle)}), tmp_path)))
    assert result.chosen == "linear spring, 2 creep elements"
    law = result.laws[result.chosen]
    for name in ("stiffness", "rest", "time_1", "time_2"):
        assert law.params[name].low < JOINT[name] < law.params[name].high
    assert np.std(law.held_out) < 6e-4
    assert np.std(result.laws["quadratic spring"].held_out) > 5.0 * np.std(law.held_out)


def test_a_record_without_its_release_is_refused(tmp_path: Path) -> None:
    table = pd.DataFrame({"t": np.arange(200) / 100.0, "angle": 0.1})
    with pytest.raises(DataError, match=r"0 rows before and 200 after .*--release-s"):
        release_record(bench(table, tmp_path))
    degrees = pd.DataFrame({"t": np.arange(-50, 150) / 100.0, "angle": 23.0})
    with pytest.raises(DataError, match=r"23 rad; .* --units angle deg"):
        release_record(bench(degrees, tmp_path))


def hover(seed: int, coefficient: float = 4e-8, *, mass: float = 0.045, drift: float = 0.0) -> FlightLog:
    """A hover of 12 s: sum of the thrusts is the weight, four unequal rotors, slow noise of the controller."""
    rng, rows = np.random.default_rng(seed), 1200
    force = 9.81 + 0.1 * np.repeat(rng.standard_normal(rows // 20), 20)
    share = np.array([0.24, 0.26, 0.27, 0.23]) * mass * force[:, None]
    still = np.zeros((rows, 3))
    return FlightLog(
        path=f"hover{seed}.csv", time=np.arange(rows) / 100.0, attitude=np.tile([0.0, 0.0, 0.0, 1.0], (rows, 1)),
        lin_vel=still + drift, ang_vel=still,
        specific_force=np.column_stack((still[:, :2], force + 0.05 * rng.standard_normal(rows))),
        rotor_speed=np.sqrt(share / coefficient) * (1.0 + 0.002 * rng.standard_normal((rows, 4))),
    )  # fmt: skip


def test_hover_gives_the_thrust_coefficient_by_weight() -> None:
    """``c_t = m f / sum(w²)``; twice the mass is twice the coefficient, and an unsure mass widens the interval as much."""
    declared = (0.0, 0.0, 4.4e-8)
    fit = fit_hover([hover(0), hover(1), hover(2)], mass=0.045, declared=declared)
    assert fit.thrust_coefficient.value == pytest.approx(4e-8, rel=1e-3)
    assert fit.scale.value == pytest.approx(4.0 / 4.4, rel=1e-3)
    assert fit.models["declared"].error.value == pytest.approx(0.1 * 9.81, rel=0.02)
    assert fit.models[fit.chosen].error.value < 0.05
    heavy = fit_hover([hover(0)], mass=0.09)
    assert heavy.thrust_coefficient.value == pytest.approx(8e-8, rel=1e-3)
    unsure = fit_hover([hover(0)], mass=0.045, mass_std=0.0045)
    assert unsure.thrust_coefficient.high - unsure.thrust_coefficient.value == pytest.approx(1.96 * 4e-9, rel=0.02)


def test_intervals_of_hover_hold_the_truth_as_often_as_they_say() -> None:
    """One flight each: windows only; of 60 intervals of 95 % fewer than 53 hold with probability 1 %."""
    result = [fit_hover([hover(seed)], mass=0.045).thrust_coefficient for seed in range(60)]
    assert sum(estimate.low < 4e-8 < estimate.high for estimate in result) >= 53


def test_without_an_accelerometer_the_weight_over_the_cosine_of_the_tilt_is_taken() -> None:
    log = hover(3)
    tilted = np.tile([np.sin(0.05), 0.0, 0.0, np.cos(0.05)], (log.time.size, 1))
    fit = fit_hover([replace(log, attitude=tilted, specific_force=None)], mass=0.045)
    assert fit.force == pytest.approx(9.80665 / np.cos(0.1), rel=1e-3)
    assert fit.notes[0].code == "thrust_from_gravity"


def test_a_flight_that_does_not_hover_is_refused_by_name() -> None:
    with pytest.raises(DataError, match=r"hover4.csv: hovers for 0 windows"):
        fit_hover([hover(4, drift=1.0)], mass=0.045)
    note = fit_hover([hover(4, drift=1.0), hover(5)], mass=0.045).notes[0]
    assert note.code == "flight_left_out"
    assert note.values["error"].startswith("hover4.csv")
    with pytest.raises(ConfigError, match=r"mass = -1"):
        fit_hover([hover(5)], mass=-1.0)


def test_the_command_writes_a_robot_that_loads(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    static, steps, out = tmp_path / "static.csv", tmp_path / "steps.csv", tmp_path / "out"
    static_table(np.random.default_rng(7), 0.01).to_csv(static, index=False)
    step_table({"tau_up": 0.03, "tau_down": 0.06}, noise=4.0).to_csv(steps, index=False)
    assert main(["identify", "motor", str(static), str(steps), "--robot", "tinyprop", "--out", str(out), "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["steps"]["chosen"] == "up and down"
    assert result["steps"]["after"]["held_out"]["rms"] < result["steps"]["before"]["held_out"]["rms"]
    robot = load(RobotCfg, out / "robot.yaml")
    assert robot.rotor.thrust_map[2] == pytest.approx(MAP[2], rel=0.1)
    assert robot.rotor.torque_ratio == pytest.approx(RATIO, rel=0.02)
    assert robot.rotor.time_constant_down == pytest.approx(0.06, rel=0.05)
    text = (out / "report.md").read_text()
    assert "up and down (chosen) (in robot file)" in text
    for name in ("thrust.png", "torque.png", "steps_1.png", "result.json"):
        assert (out / name).stat().st_size > 500


@pytest.mark.parametrize(("argv", "message"), [
    (("motor", "no.csv"), "no.csv: no such file"),
    (("motor", "no.csv", "--units", "spede", "rpm"), "no quantity 'spede'. Known: speed, thrust"),
    (("motor", "no.csv", "--num-motors", "0"), "num_motors = 0: must be at least 1"),
    (("hover", "no.csv"), "identify hover needs a mass: give --robot or --mass-kg"),
    (("hover", "no.csv", "--mass-kg", "1"), "no.csv: no such file"),
    (("joint", "no.csv"), "no.csv: no such file"),
])  # fmt: skip
def test_wrong_requests_are_one_sentence(argv, message, capsys) -> None:
    assert main(["identify", *argv]) == 2
    assert message in capsys.readouterr().err


def test_a_signed_table_gives_a_reversible_rotor(tmp_path: Path) -> None:
    """T = 1e-6 w² forwards and -(0.6e-6 w² + 1e-4 w) backwards, torque 0.012 and 0.02 m times the thrust."""
    speed = np.concatenate((np.linspace(200.0, 2000.0, 14), -np.linspace(200.0, 1800.0, 14)))
    rng = np.random.default_rng(8)
    thrust = np.where(speed > 0.0, 1e-6 * speed**2, -(0.6e-6 * speed**2 - 1e-4 * speed))
    torque = np.where(speed > 0.0, 0.012, 0.02) * thrust
    noise = 1.0 + 0.002 * rng.standard_normal((2, speed.size))
    table = pd.DataFrame({"omega": speed, "thrust_N": thrust * noise[0], "torque_Nm": torque * noise[1]})
    fits, _ = fit_static(bench(table, tmp_path))
    changes = rotor_fields_from_tests(fits, None)
    assert changes["thrust_map"] == pytest.approx((0.0, 0.0, 1e-6), rel=0.01)
    assert changes["reverse_thrust_map"] == pytest.approx((0.0, 1e-4, 0.6e-6), rel=0.05)
    torques = np.polyval(np.array(changes["reverse_torque_map"])[::-1], 1500.0)
    assert torques == pytest.approx(0.02 * (0.6e-6 * 1500.0**2 + 0.15), rel=0.01)
    rotor = RotorCfg(time_constant_up=0.03, time_constant_down=0.03, source="test", **changes)
    assert rotor.reversible
    assert rotor_state_for_thrust(rotor, -1.0) == pytest.approx(-1210.0, rel=0.01)


def test_steps_give_slew_rates_that_a_robot_file_holds(tmp_path: Path) -> None:
    params = {"tau": 0.03, "slew_down": 2e4}
    fit = fit_steps([step_record(bench(step_table(params, noise=4.0), tmp_path))])
    assert fit.in_robot == fit.chosen
    changes = rotor_fields_from_tests([], fit)
    assert changes["slew_rate"] is None
    assert changes["slew_rate_down"] == pytest.approx(2e4, rel=0.05)
    assert changes["time_constant_up"] == changes["time_constant_down"] == pytest.approx(0.03, rel=0.05)
