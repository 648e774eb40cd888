"""How loggers record the flights of the plant: rate of each channel, lost rows, late and noisy streams, CSV and PX4 ULog.

Letters: F flights, T samples.
"""

import struct
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from benchmarks.undeclared.logs import delay_samples, log_table
from benchmarks.undeclared.simulate import CONTROL_RATE, PlantRecord
from benchmarks.undeclared.vehicle import Array

NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])  # From ENU
FRD = np.diag([1.0, -1.0, -1.0])  # From FLU
START_US = 5_000_000  # Time since boot of the first sample [us]
LONGEST_BURST = 24  # Rows that get lost at once: 60 ms
HIGH_RATE = {"imu": 200.0, "attitude": 200.0, "command": 200.0, "rotor": 200.0}


@dataclass(frozen=True, kw_only=True)
class PlantLogger:
    """One way to record flights."""

    file: Literal["csv", "ulg"] = "csv"
    rates: Mapping[str, float] = field(default_factory=dict)  # Of channels [Hz]; those of rows have ``row_rate``
    row_rate: float = 400.0  # Rows of a CSV file [Hz]
    rotor_speeds: bool = True  # Whether rotor speeds are logged
    late: tuple[float, float] = (0.0, 0.0)  # Range of the delay of position and velocity [s], one for a case
    vibration: float = 0.0  # Of the accelerometer, standard deviation of a sample [m/s²]
    wander: tuple[float, float] = (0.0, 1.0)  # Of the position: standard deviation [m], time constant [s]
    velocity_noise: float = 0.0  # Beside that of the sensors, standard deviation of a sample [m/s]
    lost: float = 0.0  # Share of rows that get lost, in bursts
    jitter: float = 0.0  # Of the stamps of rows, standard deviation [s]

    def rate(self, channel: str) -> float:
        """Return the rate of ``imu``, ``attitude``, ``position``, ``command``, ``rotor`` or ``battery`` [Hz]."""
        return self.rates.get(channel, self.row_rate)


LOGGERS: dict[str, PlantLogger] = {
    "rows": PlantLogger(),
    "px4": PlantLogger(
        file="ulg",
        rates={"imu": 200.0, "attitude": 20.0, "position": 10.0, "command": 10.0, "battery": 5.0},
        rotor_speeds=False,
    ),
    "slow": PlantLogger(row_rate=100.0, rotor_speeds=False, vibration=1.0, wander=(0.05, 10.0)),
    "gaps": PlantLogger(lost=0.03, jitter=0.00015),
    "late": PlantLogger(late=(0.08, 0.15)),
    "gps": PlantLogger(
        file="ulg",
        rates=HIGH_RATE | {"position": 5.0, "battery": 5.0},
        late=(0.15, 0.15),
        wander=(1.0, 20.0),
        velocity_noise=0.05,
    ),
}
"""README.md has the sources of the numbers."""


def disturb_record(record: PlantRecord, logger: PlantLogger, seed: int) -> PlantRecord:
    """Return a record with the vibration, delay and noise of a logger."""
    rng, measured = np.random.default_rng([seed, 60]), dict(record.measured)
    shape, (std, time) = measured["position"].shape, logger.wander
    measured["acc"] = measured["acc"] + logger.vibration * rng.standard_normal(shape)
    late = rng.uniform(*logger.late) * CONTROL_RATE
    for name in ("position", "velocity") if late else ():
        measured[name] = delay_samples(measured[name], late)
    if std:
        measured["position"] = measured["position"] + std * smooth_noise(rng, shape, time)
    measured["velocity"] = measured["velocity"] + logger.velocity_noise * rng.standard_normal(shape)
    return replace(record, measured=measured)


def smooth_noise(rng: np.random.Generator, shape: tuple[int, ...], time: float) -> Array:
    """Return noise of variance 1 behind ``1 / (1 + T s)²``: its derivative has the standard deviation ``1 / T``."""
    keep, start = np.exp(-1.0 / (CONTROL_RATE * time)), round(8.0 * time * CONTROL_RATE)
    below = [1.0, -2.0 * keep, keep**2]
    answer = np.asarray(lfilter([1.0], below, np.eye(1, start)[0]))
    draws = rng.standard_normal((start + shape[0], *shape[1:]))
    return np.asarray(lfilter([1.0], below, draws, axis=0))[start:] / np.sqrt(answer @ answer)


def write_rows(path: Path, record: PlantRecord, flight: int, rows: slice, logger: PlantLogger, seed: int) -> None:
    """Write one flight as CSV, without the rows and columns that a logger loses."""
    rng = np.random.default_rng([seed, 61, flight])
    columns, digits, values = log_table(record, flight, rows)
    values[:, 0] += logger.jitter * rng.standard_normal(len(values))
    kept = [i for i, name in enumerate(columns) if logger.rotor_speeds or not name.startswith("rotor_")]
    values = values[~burst_rows(len(values), logger.lost, rng)][:, kept]
    header = ",".join(columns[i] for i in kept)
    np.savetxt(path, values, fmt=[digits[i] for i in kept], delimiter=",", header=header, comments="")


def burst_rows(count: int, share: float, rng: np.random.Generator) -> NDArray[np.bool_]:
    """Return the flags of lost rows, (T,): bursts of up to ``LONGEST_BURST`` rows at random places."""
    lost = np.zeros(count, dtype=bool)
    while lost.sum() < share * count:
        start = rng.integers(1, count - LONGEST_BURST - 1)
        lost[start : start + rng.integers(1, LONGEST_BURST + 1)] = True
    return lost


def write_ulog(path: Path, record: PlantRecord, flight: int, rows: slice, logger: PlantLogger, full: float) -> None:
    """Write one flight as PX4 logs it, each topic at its own rate; ``full`` is the rotor speed of full thrust [rad/s].

    Source: PX4 User Guide, ULog file format; messages of PX4 1.14.
    """
    seen = {name: values[rows, flight] for name, values in record.measured.items()}
    quaternion = Rotation.from_matrix(NED @ seen["rotation"] @ FRD).as_quat()[:, [3, 0, 1, 2]]
    ned = {name: seen[name] @ NED.T for name in ("position", "velocity")}
    topics = {
        ("sensor_combined", "imu", "float[3] gyro_rad;float[3] accelerometer_m_s2;"): (
            seen["rate"] @ FRD,
            seen["acc"] @ FRD,
        ),
        ("vehicle_attitude", "attitude", "float[4] q;"): (quaternion,),
        (
            "vehicle_local_position",
            "position",
            "".join(f"float {n};" for n in ("x", "y", "z", "vx", "vy", "vz")),
        ): tuple(ned.values()),
        ("actuator_motors", "command", "float[4] control;"): ((record.command[rows, flight] / full) ** 2,),
        ("battery_status", "battery", "float voltage_v;"): (record.voltage[rows, flight, None],),
    }
    if logger.rotor_speeds:
        topics["esc_status", "rotor", "esc_report[4] esc;"] = (seen["rotor"] * 30.0 / np.pi,)
    text = [b"ULog\x01\x12\x35\x01", struct.pack("<Q", START_US), _message("B", bytes(40))]
    text += [_message("F", b"esc_report:float esc_rpm;")]
    text += [_message("F", f"{name}:uint64_t timestamp;{fields}".encode()) for name, _, fields in topics]
    text += [_message("P", bytes([17]) + b"float THR_MDL_FAC" + struct.pack("<f", 1.0))]
    text += [_message("A", struct.pack("<BH", 0, k) + name.encode()) for k, (name, _, _) in enumerate(topics)]
    for k, ((_, channel, _), parts) in enumerate(topics.items()):
        every = round(CONTROL_RATE / logger.rate(channel))
        text.append(_data_messages(k, np.hstack(parts)[k % every :: every], k % every, every))
    path.write_bytes(b"".join(text))


def _message(kind: str, payload: bytes) -> bytes:
    return struct.pack("<HB", len(payload), ord(kind)) + payload


def _data_messages(number: int, values: Array, first: int, every: int) -> bytes:
    """Return the data messages of a topic, from values (T, fields) of each ``every``-th sample from ``first`` on."""
    width = values.shape[1]
    layout = np.dtype([("size", "<u2"), ("kind", "u1"), ("topic", "<u2"), ("time", "<u8"), ("values", "<f4", (width,))])
    messages = np.zeros(len(values), layout)
    messages["size"], messages["kind"], messages["topic"] = layout.itemsize - 3, ord("D"), number
    messages["time"] = START_US + np.rint((first + every * np.arange(len(values))) * 1e6 / CONTROL_RATE)
    messages["values"] = values
    return messages.tobytes()
