"""Every check of a log against what it claims to be: quiet on good logs, one clear sentence on bad ones."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation, RotationSpline

from aerial_gym.errors import DataError
from aerial_gym.sim2real.logs.checks.conventions import body_rate_from_attitude, check_log
from aerial_gym.sim2real.logs.checks.copies import LogRegister
from aerial_gym.sim2real.logs.checks.duration import check_duration_and_rate
from aerial_gym.sim2real.logs.flights import load_flights, read_flight_inputs
from aerial_gym.sim2real.logs.readers.flight_log import read_flight_log
from aerial_gym.sim2real.logs.signals import log_at_equal_steps, without_bad_quaternions
from tests.refusals import assert_refused
from tests.unit.sim2real.flat_flights import ROBOT, flight, load_flight, write

G = 9.81
Q, P = ["q_x", "q_y", "q_z", "q_w"], ["p_x", "p_y", "p_z"]
V, OMEGA, ACC = ([f"{name}_{axis}" for axis in "xyz"] for name in ("v", "omega", "acc"))
ROTORS = [f"rotor_{n}" for n in range(1, 5)]


@pytest.fixture(scope="module")
def table() -> pd.DataFrame:
    return flight(1, seconds=8.0, rate=100.0, noise=1.0)


def check(table: pd.DataFrame, folder: Path) -> list[str]:
    log = read_flight_log(write(table, folder / "a.csv"))
    check_duration_and_rate(log)
    return check_log(log_at_equal_steps(without_bad_quaternions(log)), ROBOT)


def replace_columns(table: pd.DataFrame, columns: list[str], values: object) -> pd.DataFrame:
    changed = table.copy()
    changed[columns] = np.asarray(values)
    return changed


def test_good_logs_pass(table: pd.DataFrame, tmp_path: Path) -> None:
    for missing in ([], ACC, OMEGA, V):
        assert check(table.drop(columns=missing), tmp_path) == []


def test_a_sign_jump_of_the_quaternion_is_no_defect(table: pd.DataFrame, tmp_path: Path) -> None:
    sign = np.where(np.arange(len(table)) % 7 < 3, -1.0, 1.0)[:, None]
    assert check(replace_columns(table, Q, table[Q].to_numpy() * sign), tmp_path) == []


def body_to_world(table: pd.DataFrame) -> Rotation:
    return Rotation.from_quat(table[Q].to_numpy(copy=True))


def turn(table: pd.DataFrame, columns: list[str], *, inverse: bool = False) -> pd.DataFrame:
    """Return the log with a vector in world axes in place of body axes, or the inverse."""
    turned = body_to_world(table).apply(table[columns].to_numpy(copy=True), inverse=inverse)
    return replace_columns(table, columns, turned)


def scale(table: pd.DataFrame, columns: list[str], factor: object) -> pd.DataFrame:
    return replace_columns(table, columns, table[columns] * np.asarray(factor))


def frd(table: pd.DataFrame) -> pd.DataFrame:
    """Return the log with body axes x forward, y right, z down."""
    body = (body_to_world(table) * Rotation.from_quat([1.0, 0.0, 0.0, 0.0])).as_quat()
    result = replace_columns(table, Q, body)
    return scale(scale(result, OMEGA, (1, -1, -1)), ACC, (1, -1, -1))


def mirror(table: pd.DataFrame) -> pd.DataFrame:
    """Return the log with position and velocity in world axes north, east, down, the attitude as it was."""
    result = table
    for names in (P, V):
        result = replace_columns(result, names, result[names].to_numpy()[:, [1, 0, 2]] * (1, 1, -1))
    return result


def ned(table: pd.DataFrame) -> pd.DataFrame:
    """Return the log with world axes north, east, down."""
    swap = Rotation.from_matrix([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    return replace_columns(mirror(table), Q, (swap * body_to_world(table)).as_quat())


def turn_heading(table: pd.DataFrame, angle: float) -> pd.DataFrame:
    """Return the log with position and velocity turned about z [deg], the attitude as it was."""
    about, result = Rotation.from_euler("z", angle, degrees=True), table
    for names in (P, V):
        result = replace_columns(result, names, about.apply(result[names].to_numpy(copy=True)))
    return result


def mirror_angle(table: pd.DataFrame, place: int) -> pd.DataFrame:
    """Return the log with the sign of yaw, pitch or roll reversed in attitude and angular velocity."""
    angles = body_to_world(table).as_euler("ZYX")
    angles[:, place] *= -1.0
    turned = Rotation.from_euler("ZYX", angles)
    rate = RotationSpline(table["t"].to_numpy(), turned)(table["t"].to_numpy(), 1)
    return replace_columns(replace_columns(table, Q, turned.as_quat()), OMEGA, rate)


@pytest.mark.parametrize(("change", "message"), [
    (
        lambda t: replace_columns(t, Q, t[["q_w", "q_x", "q_y", "q_z"]]),
        r"attitude .* and omega contradict each other .*the quaternion is stored w first",
    ),
    (lambda t: replace_columns(t, Q, body_to_world(t).inv().as_quat()), r"the quaternion turns world into body"),
    (lambda t: replace_columns(t, OMEGA, np.rad2deg(t[OMEGA])), r"omega is in degrees per second"),
    (lambda t: scale(t, OMEGA, (1, -1, -1)), r"omega is in axes x forward, y right, z down"),
    (lambda t: scale(t, ACC, -1), r"gravity has the wrong sign: .*\+9\.81 on z at hover.*invert the signs of acc"),
    (lambda t: scale(t, ACC, 1 / 9.81), r"multiples of g: multiply by 9\.81"),
    (
        lambda t: replace_columns(t, ACC, t[ACC] - body_to_world(t).apply([0, 0, G], inverse=True)),
        r"gravity was taken out",
    ),
    (lambda t: turn(t, ACC), r"acc_x.*agrees with the motion in world axes"),
    (lambda t: turn(t, V, inverse=True), r"it looks as if v is in body axes"),
    (frd, r"acc_z is -1\d\.\d+ m/s² on average.*give body_frame: frd in a mapping file"),
    (lambda t: ned(frd(t)), r"gravity has the wrong sign.*give body_frame: frd and world_frame: ned in a mapping"),
    (
        lambda t: ned(frd(t)).drop(columns=V),
        r"if only its signs are inverted, invert them; if body and world .*body_frame: frd and world_frame: ned",
    ),
    (ned, r"world axes are north, east, down: give world_frame: ned"),
    (lambda t: turn(t, ACC).drop(columns=[*V, *P]), r"acc_x.*agrees with thrust in world axes, not in body axes"),
    (lambda t: turn(t, V, inverse=True).drop(columns=P), r"velocity .* contradicts acc .*as if v is in body axes"),
    (mirror, r"velocity .* contradicts acc .*looks as if world axes there are north, east, down"),
    (lambda t: mirror(t).drop(columns=V), r"position .* contradicts acc .*there are north, east, down"),
    (lambda t: turn_heading(t, 90.0), r"x and y there must be turned by -90 deg about z to be those of the att"),
    (lambda t: scale(t, V, 1000.0), r"velocity .* and the derivative of position .* in mm/s"),
    (lambda t: scale(t, ROTORS, 60 / (2 * np.pi)), r"it looks like rpm: convert to rad/s"),
    (lambda t: scale(t, ROTORS, 1 / 3000), r"it looks like a fraction of full throttle"),
    (lambda t: scale(t, Q, 1.2), r"line 2 \(t = 0 s\): the attitude quaternion .* has norm 1\.2, must be 1"),
    *((lambda t, k=k: mirror_angle(t, k), rf"the {name} of the attitude has the wrong sign")
      for k, name in enumerate(("yaw", "pitch", "roll"))),
    (lambda t: scale(t, OMEGA, (1e-3, 1, 1)), r"omega_x shows 0\.00 ± .* of the attitude's turning"),
    (lambda t: scale(t, OMEGA, 1e-4), r"omega is at rest .* while the attitude turns"),
    (lambda t: t.assign(omega_y=0.01), r"ang_vel 2 is 0\.01 in every row; leave a sensor that did not work empty"),
    (lambda t: t.assign(rotor_3=0.0), r"rotor_speed 3 is 0 in every row"),
    (lambda t: t[:150], r"lasts 1\.49 s, needs at least 2 s"),
    (lambda t: t[::10], r"has 10 rows per second, needs at least 20"),
    (lambda t: t.drop(columns="rotor_4"), r"has 3 rotor columns, the robot has 4 rotors"),
])  # fmt: skip
def test_a_log_that_is_not_what_it_claims(table: pd.DataFrame, tmp_path: Path, change: object, message: str) -> None:
    with pytest.raises(DataError, match=message):
        check(change(table), tmp_path)


@pytest.mark.parametrize(("gain", "told"), [(1.015, False), (1.03, True), (0.95, True)])
def test_a_wrong_gain_is_told(gain: float, told: bool, table: pd.DataFrame, tmp_path: Path) -> None:
    """Of the gyro, whose attitude cannot have a wrong scale, and of a velocity and a position that both do."""
    columns = {
        "omega_x": (gain, 0.003, scale(table, OMEGA, (gain, 1, 1))),
        "acc_z": (1.0 / gain, 0.5 * abs(gain - 1.0) + 0.005, scale(table, [*V, *P], gain)),  # gravity keeps its size
    }
    for column, (expected, tolerance, changed) in columns.items():
        log = read_flight_log(write(changed, tmp_path / "a.csv"))
        notes = [note for note in check_log(log_at_equal_steps(log), ROBOT) if note.code == "sensor_gain"]
        assert [note.values["column"] for note in notes] == [column] * told
        assert [note.values["gain_ratio"] for note in notes] == pytest.approx([expected] * told, abs=tolerance)


@pytest.mark.parametrize(("change", "axes"), [
    (lambda t: t, ""),
    (lambda t: scale(t, ACC, (-1, 1, 1)), r"\(-acc_x, acc_y\)"),
    (lambda t: t.rename(columns={"acc_x": "acc_y", "acc_y": "acc_x"}), r"\(acc_y, acc_x\)"),
])  # fmt: skip
def test_drag_shows_signs_and_order_of_the_horizontal_axes(change, axes: str, tmp_path: Path) -> None:
    dragged = change(flight(1, seconds=8.0, rate=100.0, noise=1.0, drag=0.3))
    if not axes:
        assert check(dragged, tmp_path) == []
        return
    with pytest.raises(DataError, match=f"x and y of the body are {axes}"):
        check(dragged, tmp_path)


def test_the_order_of_the_quaternion_shows_in_a_quiet_hover_too(tmp_path: Path) -> None:
    rng, rows = np.random.default_rng(0), 400
    hover = flight(2, seconds=4.0, rate=100.0)
    still = {"q_x": 0.0, "q_y": 0.0, "q_z": 0.0, "q_w": 1.0, "v_x": 0.0, "v_y": 0.0, "v_z": 0.0}
    hover = hover.assign(**still, p_x=0.0, p_y=0.0, p_z=1.0)
    hover[OMEGA] = 0.003 * rng.standard_normal((rows, 3))
    hover[ACC] = [0.0, 0.0, 9.81] + 0.05 * rng.standard_normal((rows, 3))
    assert check(hover, tmp_path) == []
    with pytest.raises(DataError, match=r"the quaternion is stored w first; reorder the columns"):
        check(hover.assign(q_x=1.0, q_w=0.0), tmp_path)


def test_jitter_and_a_late_start_are_no_defect_of_the_time(table: pd.DataFrame, tmp_path: Path) -> None:
    jitter = table.assign(t=table["t"] + 0.002 * np.sin(np.arange(len(table))))
    assert check(jitter, tmp_path) == []
    path = write(table.assign(t=table["t"] + 1.7e9), tmp_path / "epoch.csv")
    assert load_flight(path, ROBOT, mapping=None, bandwidth=10.0).time[0] == 0.0


@pytest.mark.parametrize(("change", "message"), [
    (lambda t: t.assign(t=1e3 * t["t"]), r"0\.1 rows per second, .*time unit: ms"),
    (lambda t: t.assign(t=1e-3 * t["t"]), r"lasts 0\.00799 s, .*is t in seconds"),
    (lambda t: t.assign(t=1e6 * t["t"]), r"0\.0001 rows per second, .*time unit: us"),
    (lambda t: t.assign(t=1e9 * t["t"]), r"1e-07 rows per second, .*time unit: ns"),
])  # fmt: skip
def test_a_defect_of_the_time_is_not_taken_for_a_frozen_sensor(table, tmp_path, change, message) -> None:
    slow = table.copy()
    slow.loc[[200, 300], P] = slow.loc[[199, 199], P].to_numpy()
    with pytest.raises(DataError, match=message):
        load_flight(write(change(slow), tmp_path / "a.csv"), ROBOT, mapping=None, bandwidth=10.0)


def test_one_flight_is_not_two(table: pd.DataFrame, tmp_path: Path) -> None:
    path = write(table, tmp_path / "a.csv")
    with pytest.raises(DataError, match=r"a\.csv: is given twice"):
        load_flights([path, tmp_path / "." / "a.csv"], ROBOT, mapping=None, bandwidth=10.0)


def test_the_rate_of_a_steady_turn_is_its_rate() -> None:
    """q = (0, 0, sin(w t / 2), cos(w t / 2)) turns with w about z, in body as in world axes."""
    time = np.arange(0.0, 6.0, 0.01)
    quaternion = np.stack((0 * time, 0 * time, np.sin(0.7 * time), np.cos(0.7 * time)), axis=1)
    inner = body_rate_from_attitude(quaternion, 100.0, 4.0)[150:-150]
    np.testing.assert_allclose(inner, np.tile([0.0, 0.0, 1.4], (len(inner), 1)), atol=1e-4)


@pytest.mark.parametrize(("change", "share"), [
    (lambda t: t, "100%"),
    (lambda t: t.assign(t=t["t"] + 1.7e9), "100%"),
    (lambda t: t[250:600].assign(t=t["t"] - 2.5), "100%"),
    (lambda t: t[::2], "100%"),
    (lambda t: t.drop(columns=["v_x", "v_y", "v_z", "acc_x", "acc_y", "acc_z"]), "100%"),
    (lambda t: t[list(t.columns[::-1])].assign(vbat=11.1), "100%"),
    (lambda t: pd.concat((t[400:], flight(2, seconds=4.0, rate=100.0).assign(t=lambda f: f["t"] + 8.0))), "50%"),
])  # fmt: skip
def test_a_copy_is_refused(table: pd.DataFrame, tmp_path: Path, change: object, share: str) -> None:
    first, second = write(table, tmp_path / "a.csv"), tmp_path / "b.csv"
    write(change(table), second)
    seen = LogRegister()
    seen.add(read_flight_log(first))
    with pytest.raises(DataError, match=rf"b\.csv: {share} of the measurements are those of .*a\.csv, value by value"):
        seen.add(read_flight_log(second))


def test_a_test_flight_that_is_a_copy_is_left_out(table: pd.DataFrame, tmp_path: Path) -> None:
    paths = [write(table, tmp_path / name) for name in ("train.csv", "copy.csv")]
    other = write(flight(2, seconds=8.0, rate=100.0, noise=1.0), tmp_path / "other.csv")
    assert_refused(DataError, "a copy is no other flight", load_flights, paths, ROBOT, mapping=None, bandwidth=10.0)
    result = read_flight_inputs(ROBOT, paths[:1], [paths[1], other], mapping=None, bandwidth=10.0)
    assert [one.name for one in result.test] == ["other"]
    assert "a copy is no other flight" in result.left_out[0].values["error"]
    with pytest.raises(DataError, match="give each flight once, to train or to test"):
        read_flight_inputs(ROBOT, paths[:1], paths[1:], mapping=None, bandwidth=10.0)


def test_flights_that_begin_alike_or_rest_alike_are_different(table: pd.DataFrame, tmp_path: Path) -> None:
    logs = [table, *(flight(n, seconds=8.0, rate=100.0, noise=1.0) for n in (2, 3, 4))]
    logs[1][:50] = table[:50]
    for rests in logs[2:]:
        rests.loc[:300, table.columns[1:]] = 1.0
    seen = LogRegister()
    for number, one in enumerate(logs):
        seen.add(read_flight_log(write(one, tmp_path / f"{number}.csv")))


@pytest.mark.parametrize("noise", [0.0, 0.004])
def test_a_gyro_at_rest_is_refused_also_in_slow_turns_and_coarse_attitudes_are_not(
    noise: float, tmp_path: Path
) -> None:
    """Turning at 0.2 rad/s, with attitude noise of 4 mrad, as of a camera system: 0.03 rad/s in the band of the check."""
    rng = np.random.default_rng(4)
    time = np.arange(1600) / 100.0
    angles = 0.1 * np.sin(2.0 * np.pi * 0.35 * time[:, None] + np.arange(3))
    rates = 0.1 * 2.0 * np.pi * 0.35 * np.cos(2.0 * np.pi * 0.35 * time[:, None] + np.arange(3))
    table = flight(1, seconds=16.0, rate=100.0, noise=1.0)
    for scale, passes in ((0.02, False), (0.4, True)):  # of the rates; 0.4: a real slow flight
        shown = angles if not passes else scale * angles
        turns = Rotation.from_rotvec(shown) * Rotation.from_rotvec(noise * rng.standard_normal(angles.shape))
        gyro = scale * rates + 0.003 * rng.standard_normal(angles.shape)
        bare = table.drop(columns=[*V, *P, *ACC])
        slow = replace_columns(replace_columns(bare, Q, turns.as_quat()), OMEGA, gyro)
        if passes:
            check(slow, tmp_path)
        else:
            assert_refused(DataError, "omega is at rest", check, slow, tmp_path)
