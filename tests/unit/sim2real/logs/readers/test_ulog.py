"""PX4 ULog files that the test itself writes: topics, rotor order, thrust curve and parameters. A real one, if it is there."""

import struct
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from aerial_gym.errors import DataError, MissingDependencyError
from aerial_gym.sim2real import read_flight_log
from aerial_gym.sim2real.logs.raw_log import RawLog
from aerial_gym.sim2real.logs.readers import log_readers
from aerial_gym.sim2real.logs.readers.flight_log import open_log
from aerial_gym.sim2real.logs.readers.ulog import UlogStream
from aerial_gym.sim2real.logs.recording import FrameOrigin
from tests.unit.sim2real.flat_flights import flight
from tests.unit.sim2real.ulog_files import read_topics, topics, write_ulog

pytest.importorskip("pyulog", reason="pyulog is not installed: pip install 'aerial-gym[logs]'")

REAL = Path(__file__).parents[6] / "shared" / "data" / "real_logs" / "px4"
STAMP = (np.arange(800) * 5000 + 10_000_000).astype(np.uint64)


def hover(**more: dict[str, float]) -> dict[str, dict[str, np.ndarray]]:
    """Hover facing north, moving north at 1 m/s and climbing at 0.5 m/s."""
    sizes = {
        "vehicle_attitude": dict(zip((f"q[{i}]" for i in range(4)), (1, 0, 0, 0), strict=True)),
        "vehicle_local_position": dict(zip(("x", "y", "z", "vx", "vy", "vz"), (2, 3, -4, 1, 0, -0.5), strict=True)),
        "sensor_combined": {f"accelerometer_m_s2[{i}]": v for i, v in enumerate((0.1, 0.2, -9.81))}
        | {f"gyro_rad[{i}]": v for i, v in enumerate((0.3, 0.4, 0.5))},
    } | more
    return {
        name: {"timestamp": STAMP} | {key: np.full(STAMP.size, value) for key, value in values.items()}
        for name, values in sizes.items()
    }


@pytest.mark.parametrize(("every", "source"), [(20, "sensor_gyro_fifo[0]"), (1, "vehicle_angular_velocity[0]")])
def test_raw_samples_of_a_gyro_replace_slow_rates(every: int, source: str) -> None:
    """Eight samples of 0.625 ms before each stamp, in counts, with a calibrated offset of 0.1 rad/s about x."""
    parts = topics(flight(5, seconds=8.0, rate=200.0))
    gyro = parts["vehicle_angular_velocity"]
    stamp, rates = gyro["timestamp"], np.stack([gyro[f"xyz[{i}]"] for i in range(3)], axis=1)
    at = stamp[:, None] - 625.0 * (7 - np.arange(8))
    raw = {"samples": np.full(stamp.size, 8.0), "scale": np.full(stamp.size, 1e-3), "dt": np.full(stamp.size, 625.0)}
    for k, axis in enumerate("xyz"):
        values = 1000.0 * (np.interp(at, stamp, rates[:, k]) + 0.1 * (axis == "x"))
        raw |= {f"{axis}[{i}]": values[:, i] if i < 8 else np.zeros(stamp.size) for i in range(32)}
    parts["sensor_gyro_fifo"] = {"timestamp": stamp, **raw}
    parts["vehicle_angular_velocity"] = {name: values[::every] for name, values in gyro.items()}
    log = read_topics(parts, CAL_GYRO0_XOFF=0.1)
    assert log.streams["ang_vel"].source == source
    assert log.ang_vel is not None
    seconds = 1e-6 * stamp.astype(float)
    shown = np.stack([np.interp(log.time, seconds, one) for one in (rates * (1.0, -1.0, -1.0)).T], axis=1)
    np.testing.assert_allclose(log.ang_vel[20:-20], shown[20:-20], atol=0.02)


def test_a_single_event_of_landing_counts_and_an_esc_without_telemetry_does_not(tmp_path: Path) -> None:
    """A log that begins in the air, with one landing; three of four ESCs send their speed, which no rotor is known to have."""
    parts = topics(flight(5, seconds=8.0, rate=100.0))
    stamp = parts["esc_status"]["timestamp"]
    parts["esc_status"]["esc[1].esc_rpm"] = np.zeros(stamp.size)
    parts["actuator_motors"] = {"timestamp": stamp} | {f"control[{i}]": np.full(stamp.size, 0.5) for i in range(4)}
    parts["vehicle_land_detected"] = {"timestamp": stamp[:1], "landed": np.zeros(1)}
    log = read_topics(parts)
    assert log.rotor_speed is None
    assert log.num_rotors == 4
    assert [note.values["topic"] for note in log.notes if note.code == "topic_left_out"] == ["esc_status[0]"]
    thrown = open_log(write_ulog(tmp_path / "a.ulg", parts), hover=True)  # a flywheel is one of four motors
    assert thrown.streams["rotor_speed"].values.shape[1] == 3


def test_hover_has_gravity_up_and_north_is_enu_y() -> None:
    """Signed cases, each by hand."""
    log = read_topics(hover(esc_status={f"esc[{i}].esc_rpm": 6000.0 * (i < 4) for i in range(8)}))
    np.testing.assert_allclose(log.position[0], (3.0, 2.0, 4.0))
    np.testing.assert_allclose(log.lin_vel[0], (0.0, 1.0, 0.5))
    np.testing.assert_allclose(log.specific_force[0], (0.1, -0.2, 9.81))
    np.testing.assert_allclose(log.ang_vel[0], (0.3, -0.4, -0.5))
    np.testing.assert_allclose(Rotation.from_quat(log.attitude[0]).apply([1.0, 0.0, 0.0]), (0.0, 1.0, 0.0), atol=1e-12)
    np.testing.assert_allclose(Rotation.from_quat(log.attitude[0]).apply([0.0, 0.0, 1.0]), (0.0, 0.0, 1.0), atol=1e-12)
    np.testing.assert_allclose(log.rotor_speed, np.full((len(log.time), 4), 200.0 * np.pi))


def test_the_origin_of_the_local_frame_is_its_reference() -> None:
    """Unknown without one, where the estimator has no global position, and where it moves."""
    speeds = {"esc_status": {f"esc[{i}].esc_rpm": 6000.0 * (i < 4) for i in range(8)}}
    assert read_topics(hover(**speeds)).origin == pytest.approx(FrameOrigin(), nan_ok=True)
    for moves, is_global, known in ((False, 1.0, True), (False, 0.0, False), (True, 1.0, False)):
        parts = hover(**speeds)
        states = {"ref_lat": 47.1, "ref_lon": 8.2, "ref_alt": 410.0, "xy_global": is_global, "z_global": 1.0}
        place = parts["vehicle_local_position"]
        place |= {name: np.full(STAMP.size, value) for name, value in states.items()}
        place["ref_lat"][400:] += 0.001 * moves
        origin = read_topics(parts).origin
        assert origin is not None
        assert origin.is_known == known
        assert not known or origin == FrameOrigin(47.1, 8.2, 410.0)


def test_rotors_are_in_the_order_of_their_functions() -> None:
    reports = {f"esc[{i}].esc_rpm": 1000.0 * (i + 1) for i in range(4)}
    functions = dict(zip((f"esc[{i}].actuator_function" for i in range(4)), (103, 101, 104, 102), strict=True))
    log = read_topics(hover(esc_status=reports | functions))
    np.testing.assert_allclose(log.rotor_speed[0] * 30.0 / np.pi, (2000.0, 4000.0, 1000.0, 3000.0))


def test_motor_commands_follow_the_thrust_curve_of_the_parameters() -> None:
    """0.8 u² + 0.2 u = 0.3 at u = 0.5."""
    controls = {f"control[{i}]": 0.3 if i < 4 else np.nan for i in range(12)}
    log = read_topics(hover(actuator_motors=controls), THR_MDL_FAC=0.8)
    np.testing.assert_allclose(log.rotor_command, 0.5)
    assert log.relative_commands


def test_a_parameter_that_is_no_number_counts_as_missing() -> None:
    controls = {f"control[{i}]": 0.3 if i < 4 else np.nan for i in range(12)}
    log = read_topics(hover(actuator_motors=controls), THR_MDL_FAC=np.nan, MAV_TYPE=np.inf)
    np.testing.assert_allclose(log.rotor_command, 0.3)


def test_a_motor_without_a_command_stands_still() -> None:
    """PX4 commands NaN to a motor that stops, such as the pusher of a VTOL in hover."""
    controls = {f"control[{i}]": np.where((STAMP[400] < STAMP) | (i < 4), 0.5, np.nan) for i in range(5)}
    np.testing.assert_array_equal(read_topics(hover(actuator_motors=controls)).rotor_command[[0, -1], 4], (0.0, 0.5))


def test_outputs_of_any_instance_are_taken_in_the_order_and_range_of_the_parameters() -> None:
    wave = np.sin(np.arange(STAMP.size))[:, None]
    pulses = 1500.0 + 40.0 * np.arange(4) + wave
    result = hover(**{"actuator_outputs[1]": {f"output[{i}]": 0.0 for i in range(8)}})
    result["actuator_outputs[1]"] |= {f"output[{i}]": pulses[:, i] for i in range(4)}
    parameters = {f"PWM_AUX_FUNC{i + 1}": function for i, function in enumerate((102, 101, 104, 103))}
    parameters |= {f"PWM_AUX_{end}{i}": value for end, value in (("MIN", 1100), ("MAX", 1900)) for i in range(1, 5)}
    log = read_topics(result, **parameters)
    np.testing.assert_allclose(log.rotor_command, (pulses[:, [1, 0, 3, 2]] - 1100.0) / 800.0)


WAVE = np.sin(np.arange(STAMP.size))


@pytest.mark.parametrize(("count", "known"), [(4.0, True), (8.0, False)])
def test_a_driver_with_some_of_the_rotors_gives_no_commands(count: float, known: bool) -> None:
    outputs = {f"output[{i}]": 1500.0 + 100.0 * WAVE for i in range(4)}
    parameters = {
        f"PWM_{port}_FUNC{i}": 100.0 + i + 4 * place for place, port in enumerate(("MAIN", "AUX")) for i in range(1, 5)
    }
    parameters = {name: value for name, value in parameters.items() if value <= 100.0 + count}
    esc = {"esc[0].esc_rpm": 100.0}
    log = read_topics(hover(actuator_outputs=outputs, esc_status=esc), CA_ROTOR_COUNT=count, **parameters)
    assert (log.rotor_command is not None) is known


@pytest.mark.parametrize(
    ("rest", "lowest", "full", "parameters", "rotors"),
    [
        (900.0, 1075.0, 1950.0, {"PWM_MIN": 1075.0, "PWM_MAX": 1950.0}, 4),
        (900.0, 1000.0, 2000.0, {"MAV_TYPE": 13.0}, 6),
        (900.0, 1000.0, 2000.0, {"MAV_TYPE": 19.0}, 2),  # tail-sitter with two rotors
        (0.0, 109.945, 1999.0, {"DSHOT_CONFIG": 600.0}, 4),
        (0.0, 199.9, 1999.0, {"PWM_MAIN_TIM0": -3.0, "DSHOT_MIN": 0.1}, 4),
        (900.0, 1000.0, 2000.0, {"MAV_TYPE": 1.0}, 0),  # a plane has other first outputs
        (900.0, 1000.0, 2000.0, {"DSHOT_CONFIG": 600.0}, 4),
    ],
)
def test_outputs_at_rest_for_most_of_a_log_leave_the_range_of_the_others(
    rest, lowest, full, parameters, rotors
) -> None:
    """Three quarters of the log are on the ground."""
    signal = np.where(np.arange(STAMP.size) < 600, np.nan, 0.3 + 0.1 * WAVE)[:, None] * np.ones(8)
    outputs = {
        f"output[{i}]": np.nan_to_num(lowest + (full - lowest) * column, nan=rest) for i, column in enumerate(signal.T)
    }
    log = read_topics(hover(actuator_outputs=outputs, esc_status={"esc[0].esc_rpm": 100.0}), **parameters)
    assert (0 if log.rotor_command is None else log.rotor_command.shape[1]) == rotors
    if rotors:
        np.testing.assert_allclose(log.rotor_command[-1], np.full(rotors, signal[-1, 0]), rtol=1e-12)
        np.testing.assert_array_equal(log.rotor_command[0], 0.0)


@pytest.mark.parametrize(
    "fields",
    [("x", "y", "z", "vx", "vy", "vz"), [f"{name}[{i}]" for name in ("position", "velocity") for i in range(3)]],
)
def test_odometry_stands_for_a_missing_position_and_velocity(fields) -> None:
    result = hover(
        vehicle_odometry=dict(zip(fields, (2, 3, -4, 1, 0, -0.5), strict=True)), esc_status={"esc[0].esc_rpm": 1.0}
    )
    del result["vehicle_local_position"]
    log = read_topics(result)
    np.testing.assert_allclose(log.position[0], (3.0, 2.0, 4.0))
    np.testing.assert_allclose(log.lin_vel[0], (0.0, 1.0, 0.5))


def test_controls_of_old_firmwares_go_through_the_mixer_of_an_x_frame() -> None:
    """A pure roll command raises both left rotors (2 and 3), a yaw command the two of one direction (1 and 2)."""

    def command(**values: float) -> np.ndarray:
        controls = {f"control[{i}]": values.get(name, 0.0) for i, name in enumerate(("roll", "pitch", "yaw", "thrust"))}
        return read_topics(hover(actuator_controls_0=controls)).rotor_command[0]

    np.testing.assert_allclose(command(thrust=0.5), 0.5)
    np.testing.assert_allclose(command(thrust=0.5, roll=0.1), 0.5 + 0.07071 * np.array([-1, 1, 1, -1]))
    np.testing.assert_allclose(command(thrust=0.5, pitch=0.1), 0.5 + 0.07071 * np.array([1, -1, 1, -1]))
    np.testing.assert_allclose(command(thrust=0.5, yaw=0.1), 0.5 + 0.1 * np.array([1, 1, -1, -1]))


@pytest.mark.parametrize(("volts", "known"), [(0.05, False), (15.0, True)])
def test_a_battery_that_is_not_connected_has_no_voltage(volts: float, known: bool) -> None:
    controls = {f"control[{i}]": 0.3 for i in range(4)}
    log = read_topics(hover(actuator_motors=controls, battery_status={"voltage_v": volts}))
    assert (log.battery is not None) is known


def test_a_file_is_recognised_by_its_content_and_read_with_its_parameters(tmp_path: Path) -> None:
    table = flight(5, seconds=6.0, rate=200.0)
    path = write_ulog(tmp_path / "flight.csv", topics(table), {"THR_MDL_FAC": 0.25})
    path.write_bytes(path.read_bytes() + struct.pack("<HBH", 2, ord("O"), 120))  # 120 ms lost
    opened = open_log(path)
    assert [message.level for message in opened.raw.messages] == ["warning"]
    assert isinstance(opened.raw, RawLog)
    assert (opened.raw.format, opened.raw.parameters) == ("ulog", {"THR_MDL_FAC": 0.25})
    log = read_flight_log(path)
    np.testing.assert_allclose(log.time - 5.0, table["t"][: len(log.time)], atol=1e-6)
    flown = Rotation.from_quat(table[["q_x", "q_y", "q_z", "q_w"]][: len(log.time)])
    assert (flown.inv() * Rotation.from_quat(log.attitude)).magnitude().max() < 1e-2
    for name, prefix, size in (("position", "p", 5e-3), ("lin_vel", "v", 2e-2), ("ang_vel", "omega", 1e-6)):
        columns = table[[f"{prefix}_{axis}" for axis in "xyz"]].to_numpy()[: len(log.time)]
        np.testing.assert_allclose(getattr(log, name)[5:-5], columns[5:-5], atol=size)
    speeds = table.filter(like="rotor_").to_numpy()[: len(log.time)]
    np.testing.assert_allclose(log.rotor_speed[5:-5], speeds[5:-5], rtol=1e-2)
    data = path.read_bytes()
    (tmp_path / "bytes").write_bytes(data.replace(b"float THR_MDL_FAC", b"fl\x00at THR_MDL_FAC"))
    assert isinstance(open_log(tmp_path / "bytes").raw.number("THR_MDL_FAC", 1.0), float)
    (tmp_path / "broken").write_bytes(data[:9])
    with pytest.raises(DataError):
        read_flight_log(tmp_path / "broken")


def test_without_pyulog_the_message_names_the_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "pyulog", None)
    log_readers._read_once.cache_clear()
    with pytest.raises(MissingDependencyError, match=r"aerial-gym\[logs\]"):
        read_flight_log(write_ulog(tmp_path / "flight.ulg", topics(flight(5, seconds=3.0))))


@pytest.mark.skipif(not REAL.exists(), reason="the real logs are not part of the project")
def test_real_logs_open_as_the_flights_that_they_hold() -> None:
    """Hover: motors in instance 1 of the outputs, a yaw reset of 22 deg (by ``delta_q_reset``), commands at 10 Hz."""
    path = REAL / "quad_hover_second_output_instance.ulg"
    log = read_flight_log(path)
    (reset,) = [note for note in log.notes if note.code == "reset_undone"]
    assert reset.values["angle_deg"] == pytest.approx(22.1, abs=0.3)
    assert log.streams["rotor_command"].rate == pytest.approx(10.0, abs=0.1)
    assert not log.torques
    assert len(open_log(REAL / "hitl_trajectory.ulg").spans) == 2  # its accelerometer has a gap of 0.8 s


def test_a_damaged_file_is_not_read_for_ever() -> None:
    """pyulog steps back by the length of an unknown message, beyond what it has read of a file that ends there."""
    stream = UlogStream(bytes(100))

    def read_again() -> None:
        for _ in range(10**6):
            stream.seek(0)
            stream.read(100)

    with pytest.raises(EOFError):
        read_again()
