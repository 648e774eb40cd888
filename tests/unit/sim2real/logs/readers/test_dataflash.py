"""ArduPilot logs: messages by type and instance, units, damaged bytes, channels, and a log of other people."""

from functools import partial

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from aerial_gym.errors import DataError
from aerial_gym.sim2real.logs.raw_log import RawLog, Topic
from aerial_gym.sim2real.logs.readers.dataflash import DataflashReader, _log_names
from aerial_gym.sim2real.logs.readers.dataflash_messages import read_lines
from aerial_gym.sim2real.logs.recording import FrameOrigin
from tests.unit.sim2real.logs.readers import dataflash_files as files
from tests.unit.sim2real.logs.readers.open_log_bytes import REAL_LOGS, first_channel, read_bytes

DATA = REAL_LOGS / "ardupilot" / "copter364_two_flights.bin"


read = partial(read_bytes, kind=DataflashReader)
channel = partial(first_channel, reader=DataflashReader())


def test_messages_become_topics_by_instance_with_units(tmp_path) -> None:
    data, numbers = files.log()
    log = read(tmp_path, data)
    second = next(topic for topic in log.topics if topic.source == "IMU[1]")
    np.testing.assert_array_equal(second.columns["AccZ"], numbers["imu"][:, 1, 5])
    np.testing.assert_allclose(second.time, 2.0 + 0.01 * np.arange(400), rtol=1e-15)
    assert second.units["GyrX"] == "rad/s"
    assert second.units["TimeUS"] == "1e-06 s"
    assert log.parameters["MOT_PWM_MAX"] == 1900.0
    assert log.metadata == {"firmware": "ArduCopter V4.5.1 (00000000)"}
    assert log.notes == ()


def test_channels_are_in_si_units_enu_and_flu(tmp_path) -> None:
    data, numbers = files.log()
    log = read(tmp_path, data)
    np.testing.assert_allclose(channel(log, "ang_vel").values, numbers["imu"][:, 0, :3] * (1.0, -1.0, -1.0))
    north, east, down = numbers["ekf"][::2, 3:].T
    np.testing.assert_allclose(channel(log, "position").values, np.stack((east, north, -down), axis=1))
    attitude = Rotation.from_quat(channel(log, "attitude").values[0])
    roll, pitch, _ = np.radians(0.01 * numbers["attitude"][0])
    east_and_level = Rotation.from_euler("ZYX", (0.0, -pitch, roll))  # heading 90 deg is east; nose up is -y of FLU
    assert (attitude.inv() * east_and_level).magnitude() < 1e-9
    assert channel(log, "battery").values[0, 0] == 15.5
    assert channel(log, "armed").values[:, 0].tolist() == [0.0, 1.0]


def test_rotors_follow_the_functions_of_the_outputs(tmp_path) -> None:
    """Motors 1 to 4 are on outputs 8 to 5, whose signals run from 1100 to 1900 us."""
    data, numbers = files.log()
    log = read(tmp_path, data)
    expected = np.clip((numbers["outputs"][::2, [7, 6, 5, 4]] - 1100.0) / 800.0, 0.0, 1.0)
    np.testing.assert_allclose(channel(log, "rotor_command").values, expected)
    np.testing.assert_allclose(channel(log, "rotor_speed").values, numbers["rpm"][::2, ::-1] * np.pi / 30.0, rtol=1e-6)


def test_damaged_bytes_lose_only_the_messages_that_they_touch(tmp_path) -> None:
    data, numbers = files.log()
    place = data.index(files.message("IMU", 4_000_000, 0, *numbers["imu"][200, 0].tolist()))
    log = read(tmp_path, data[: place + 10] + b"\xa3\x95\x10" * 150 + data[place + 10 :])
    assert log.notes[0].code == "bytes_left_out"
    time = channel(log, "ang_vel").time
    assert time.size == 399
    assert not np.any(np.isclose(time, 4.0))


def test_a_head_within_a_message_begins_no_message(tmp_path) -> None:
    head = int.from_bytes(b"\xa3\x95", "little", signed=True)
    raw = files.message("RAW", 2_000_000, [head, 0x87] * 16)
    log = read(tmp_path, files.log()[0] + raw * 3)
    topic = next(one for one in log.topics if one.name == "RAW")
    assert topic.columns["x[30]"].tolist() == [head] * 3
    assert log.notes == ()


@pytest.mark.parametrize(
    ("old", "new"), [(b"MultIds", b"MultIdz"), (b"Name,Value", b"Name,Valve"), (b"Id,Label", b"Ib,Label")]
)
def test_a_damaged_definition_leaves_the_sensors(tmp_path, old, new) -> None:
    data, _ = files.log()
    log = read(tmp_path, data.replace(old, new))
    assert channel(log, "ang_vel").time.size == 400


@pytest.mark.parametrize("data", [b"\xa3\x95", b"\xa3\x95\x80" + bytes(200), files.definitions()])
def test_a_log_without_sensors_is_refused(tmp_path, data) -> None:
    with pytest.raises(DataError):
        read(tmp_path, data)


def test_messages_without_times_are_named(tmp_path) -> None:
    data = files.message("FMT", 128, 89, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns")
    data += files.message("FMT", 4, 15, "IMU", "fff", "GyroX,GyroY,GyroZ") + 9 * (b"\xa3\x95\x04" + bytes(12))
    with pytest.raises(DataError, match="px4log"):
        read(tmp_path, data)


def test_a_log_as_text_gives_the_quantities_of_the_binary_log(tmp_path) -> None:
    text = (
        b"ArduCopter V3.1\n"
        + files.log(message=files.line)[0]
        + files.line("MSG", 1000, "a, b")
        + b"IMU, 1, x, "
        + 400 * b"9"
        + b"\n"
    )
    one, other = read(tmp_path, files.log()[0]), read(tmp_path, text)
    for quantity in ("ang_vel", "attitude", "position", "rotor_command", "rotor_speed", "battery", "armed"):
        first, second = channel(one, quantity), channel(other, quantity)
        np.testing.assert_allclose(second.time[:200], first.time[:200], rtol=1e-15)
        np.testing.assert_allclose(second.values[:200], first.values[:200], rtol=1e-6)
    assert other.parameters == one.parameters
    assert other.messages[-1].text == "a, b"


def test_a_type_whose_lines_are_all_short_has_missing_values() -> None:
    (table,) = read_lines("FMT, 5, 20, IMU, Qff, TimeUS,GyrX,GyrY\nIMU, 1, 2\nIMU, 3\n")[1]
    np.testing.assert_array_equal(table.numbers("GyrX"), (2.0, np.nan))
    np.testing.assert_array_equal(table.numbers("GyrY"), (np.nan, np.nan))


def bare_log(parameters: dict[str, float], *topics: Topic, firmware: str = "ArduCopter V4.5.1") -> RawLog:
    return RawLog(path="a", format="dataflash", topics=topics, parameters=parameters, metadata={"firmware": firmware})


def test_positions_have_the_origin_of_the_estimator_or_the_first_fix() -> None:
    time = np.arange(3.0)
    place = Topic(name="XKF1", time=time, columns=dict.fromkeys(("PN", "PE", "PD"), time))
    fix = {"Status": 3.0, "Lat": 47.0, "Lng": 8.0, "Alt": 400.0, "Spd": 0.0, "GCrs": 0.0, "VZ": 0.0}
    gps = Topic(name="GPS", time=time, columns={name: np.full(3, value) for name, value in fix.items()})
    states = {"Type": [0.0, 1.0], "Lat": [47.1, 47.3], "Lng": [8.2, 8.3], "Alt": [410.0, 0.0]}
    origin = Topic(name="ORGN", time=time[:2], columns={name: np.array(values) for name, values in states.items()})
    logged = DataflashReader().channels(bare_log({}, place, gps, origin))
    origins = {one.source: one.origin for one in logged if one.quantity == "position"}
    assert origins == {"XKF1[0]": FrameOrigin(47.1, 8.2, 410.0), "GPS[0]": FrameOrigin(47.0, 8.0, 400.0)}
    (bare,) = DataflashReader().channels(bare_log({}, place))
    assert bare.origin is not None
    assert not bare.origin.is_known


def outputs(prefix: str = "C") -> Topic:
    """Return outputs 1 to 14, at 1100 us and 10 us more each."""
    return Topic(
        name="RCOU", time=np.arange(3.0), columns={f"{prefix}{n}": np.full(3, 1090.0 + 10 * n) for n in range(1, 15)}
    )


@pytest.mark.parametrize(
    ("functions", "more", "expected"),
    [
        (
            (33, 34, 39, 36),
            {"FRAME_CLASS": 7.0},
            [1, 2, 4],
        ),  # motor 7 of a tricopter is a servo, motor 4 the rear rotor
        ((33, 34, 35, 36), {"FRAME_CLASS": 6.0}, []),  # servos of a helicopter's swash plate
        ((33, 34, 35, 36, 37, 38), {"FRAME_CLASS": 9.0}, [5, 6]),  # four flaps and two coaxial rotors
        ((77, 73, 74, 78), {"Q_FRAME_CLASS": 10.0, "SERVO2_MIN": 1000.0, "SERVO3_MIN": 1000.0}, [3, 2][::-1]),
        ((73, 74), {}, []),  # a rover
        ((4, 19, 70, 21), {}, []),  # a plane without rotors for hover
        ((33, 34, 35, 36), {"MOT_PWM_MIN": 1100.0, "MOT_PWM_TYPE": 6.0}, [1, 2, 3, 4]),
    ],
)
def test_only_outputs_that_drive_rotors_are_rotors(functions, more, expected) -> None:
    log = bare_log({f"SERVO{n}_FUNCTION": float(one) for n, one in enumerate(functions, start=1)} | more, outputs())
    commands = [one.values[0] for one in DataflashReader().channels(log) if one.quantity == "rotor_command"]
    assert len(commands) == bool(expected)
    for command in commands:
        np.testing.assert_allclose(command, 0.09 + 0.01 * np.array(expected))


def test_old_copters_have_other_names_of_outputs_and_planes_no_default() -> None:
    assert channel(bare_log({"RC3_MIN": 1000.0}, outputs("Ch")), "rotor_command").values.shape == (3, 4)
    assert not [*DataflashReader().channels(bare_log({}, outputs("Ch"), firmware="ArduPlane V3.8"))]


@pytest.mark.parametrize(("logged", "volts"), [(1110.0, 11.1), (50.4, 50.4)])
def test_old_copters_log_hundredths_of_a_volt(logged, volts) -> None:
    topic = Topic(name="CURR", time=np.arange(3.0), columns={"Volt": np.full(3, logged)})
    np.testing.assert_allclose(channel(bare_log({}, topic), "battery").values, volts)


def test_resets_of_the_estimator_are_at_the_first_sample_after_their_event(tmp_path) -> None:
    """ATT and XKF1 come every 20 ms from 2 s on."""
    log = read(tmp_path, files.log()[0] + files.message("EV", 3_001_000, 62) + files.message("EV", 4_000_000, 60))
    np.testing.assert_allclose(channel(log, "attitude").resets, [3.02])
    np.testing.assert_allclose(channel(log, "position").resets, [4.0])
    assert channel(log, "ang_vel").resets is None


def test_a_tail_sitter_is_in_hover_axes() -> None:
    """Nose up, belly north: the tail is down, so that the accelerometer's x is 1 g. A yaw in hover is a roll of the nose."""
    time, half = np.arange(3.0), np.sqrt(0.5)
    numbers = {"XKQ": {"Q1": half, "Q2": 0.0, "Q3": half, "Q4": 0.0}, "ATT": {"Roll": 0.0, "Pitch": 0.0, "Yaw": 0.0}}
    numbers["IMU"] = {"GyrX": -1.0, "GyrY": 0.2, "GyrZ": 0.3, "AccX": 9.81, "AccY": 0.0, "AccZ": 0.0}
    topics = [
        Topic(name=name, time=time, columns={key: np.full(3, value) for key, value in columns.items()})
        for name, columns in numbers.items()
    ]
    log = bare_log({"Q_TAILSIT_ENABLE": 1.0}, *topics, firmware="ArduPlane V4.5.7")
    np.testing.assert_allclose(channel(log, "specific_force").values[0], (0.0, 0.0, 9.81), atol=1e-12)
    np.testing.assert_allclose(channel(log, "ang_vel").values[0], (0.3, -0.2, -1.0), atol=1e-12)
    attitude = Rotation.from_quat(channel(log, "attitude").values[0])
    np.testing.assert_allclose(attitude.apply([0.0, 0.0, 1.0]), (0.0, 0.0, 1.0), atol=1e-12)
    np.testing.assert_allclose(attitude.apply([1.0, 0.0, 0.0]), (0.0, 1.0, 0.0), atol=1e-12)


@pytest.mark.skipif(not DATA.exists(), reason="needs the logs of other people")
def test_a_log_of_other_people_is_read() -> None:
    """Numbers by pymavlink 2.4.50, which decodes all values alike."""
    log = DataflashReader().read(DATA)
    assert channel(log, "ang_vel").time.size == 1820
    assert len(log.parameters) == 809


def test_the_board_is_the_text_with_its_serial_number() -> None:
    texts = [
        "ArduCopter V4.5.7 (2a3dc4b7)",
        "ChibiOS: 6a85082c",
        "CubeOrange 003C0034 34385113 30373836",
        "RCOut: PWM:1-12",
    ]
    assert _log_names(texts) == {"firmware": texts[0], "board": texts[2]}
    assert _log_names([]) == {}
