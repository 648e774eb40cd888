"""Golden vectors of the Crazyflie firmware's controllers: 10,000 random states each of Lee, Mellinger, the PID cascade and
Brescianini, and 10,000 counts through its power distribution.

    python -m tests.cross.firmware.crazyflie_vectors --library libcrazyflie.so

asks a library of the host into which ``controller_lee.c``, ``controller_mellinger.c``, ``controller_pid.c``,
``controller_brescianini.c``, ``power_distribution_quadrotor.c`` and what they include were compiled (``UNIT_TEST_MODE``,
``-include crazyflie_host.h``; GPL-3, none of it is kept here) and writes what they answer. It is asked through its public
structures and parameters alone. States are not written: they follow from the seed, and a checksum says whether they still do.
Units are the firmware's: degrees, PWM counts; its pitch is positive with the nose up, its quaternions are xyzw.
"""

import ctypes
from collections.abc import Mapping
from ctypes import (
    Structure,
    Union,
    byref,
    c_char_p,
    c_float,
    c_int,
    c_int16,
    c_int32,
    c_uint8,
    c_uint16,
    c_uint32,
    c_uint64,
    c_void_p,
)  # fmt: skip
from pathlib import Path

import numpy as np

from tests.cross.firmware.draws import Array, Draws, checksum, write_vectors

VECTORS = Path(__file__).with_name("crazyflie_vectors.npz")
SEED = 40
STEPS = 10
"""Successive runs at 500 Hz, so that integrals are not empty."""

RUNS = 1000

LEE_ROWS = 12_000
"""A fifth more, as not all of them can be compared (``crazyflie_pairs.lee_pair``)."""

POWER_ROWS = 10_000

Vector = c_float * 3
MELLINGER = (
    *("mass", "massThrust", "kp_xy", "kd_xy", "ki_xy", "i_range_xy", "kp_z", "kd_z", "ki_z", "i_range_z", "kR_xy", "kw_xy"),
    *("ki_m_xy", "i_range_m_xy", "kR_z", "kw_z", "ki_m_z", "i_range_m_z", "kd_omega_rp"),
)  # fmt: skip
"""Gains of the Mellinger controller, in the order of its structure."""

MELLINGER_ENDS = (
    *((0.025, 0.04), (1.0e5, 1.5e5), (0.1, 0.5), (0.05, 0.3), (0.0, 0.1), (0.001, 0.01), (0.2, 1.3), (0.1, 0.6), (0.0, 0.1)),
    *((0.001, 0.01), (5e3, 2e4), (1e3, 5e3), (0.0, 500.0), (5e-4, 0.01), (5e3, 3e4), (500.0, 6e3), (0.0, 500.0), (5e-4, 0.01)),
    (0.0, 20.0),
)  # fmt: skip

BRESCIANINI = {
    "tau_xy": (0.3, 0.8), "zeta_xy": (0.5, 1.2), "tau_z": (0.5, 0.9), "zeta_z": (0.5, 1.2), "tau_rp": (0.25, 0.5),
}  # fmt: skip
"""Parameters of the group ``ctrlAtt``, and from where to where they are drawn, so that no limit acts but that of the
thrust. ``mixing_factor`` is 0 or 1, ``coll_fairness`` as it comes."""


class TimeVector(Structure):
    """Three numbers with a time."""

    _fields_ = (("time", c_uint32), ("v", Vector))


class Setpoint(Structure):
    """``setpoint_t``."""

    _fields_ = (
        ("time", c_uint32), ("attitude", TimeVector), ("rates", TimeVector), ("quaternion", c_float * 4), ("thrust", c_float),
        ("position", TimeVector), ("velocity", TimeVector), ("acceleration", TimeVector), ("jerk", TimeVector),
        ("in_body", ctypes.c_bool), ("mode", c_int * 7),
    )  # fmt: skip


class State(Structure):
    """``state_t``."""

    _fields_ = (
        ("attitude", TimeVector), ("quaternion", c_float * 4), ("position", TimeVector), ("velocity", TimeVector),
        ("acc", TimeVector),
    )  # fmt: skip


class SensorData(Structure):
    """``sensorData_t``."""

    _fields_ = (("acc", Vector), ("gyro", Vector), ("mag", Vector), ("baro", Vector), ("time", c_uint64))


class Counts(Structure):
    """The answer in counts."""

    _fields_ = (("roll", c_int16), ("pitch", c_int16), ("yaw", c_int16), ("thrust", c_float))


class ControlOutput(Union):
    """In counts, or thrust [N] and torque [N m]."""

    _fields_ = (("counts", Counts), ("wrench", c_float * 4))


class Control(Structure):
    """``control_t``."""

    _fields_ = (("answer", ControlOutput), ("mode", c_int))


class RawThrust(Structure):
    """``motors_thrust_uncapped_t``."""

    _fields_ = (("motors", c_int32 * 4),)


class Pwm(Structure):
    """``motors_thrust_pwm_t``."""

    _fields_ = (("motors", c_uint16 * 4),)


class Lee(Structure):
    """``controllerLee_t``, up to its gains; the rest is room for what it keeps."""

    _fields_ = (
        ("mass", c_float), ("thrust", c_float), ("inertia", Vector), ("position", Vector), ("position_limit", c_float),
        ("velocity", Vector), ("velocity_limit", c_float), ("integral", Vector), ("integral_limit", c_float),
        ("kept", c_float * 9), ("attitude", Vector), ("rate", Vector), ("turned", Vector), ("rest", c_float * 64),
    )  # fmt: skip


class Mellinger(Structure):
    """``controllerMellinger_t``, up to its gains; the rest is room for what it keeps."""

    _fields_ = (*((name, c_float) for name in MELLINGER), ("rest", c_float * 64))


class ParamStruct(Structure):
    """``struct param_s``."""

    _fields_ = (
        ("type", c_uint8), ("extended", c_uint8), ("name", c_char_p), ("address", c_void_p), ("callback", c_void_p),
        ("getter", c_void_p),
    )  # fmt: skip


def lee_states() -> tuple[Array, Array]:
    """Return gains (LEE_ROWS, 16), mass, inertia, position, velocity, attitude, rate, and states (LEE_ROWS, 20)."""
    draw, rows = Draws(SEED), LEE_ROWS
    ends = (
        (0.02, 0.05), *[(1e-5, 4e-5)] * 3, *[(3.0, 9.0)] * 3, *[(2.0, 5.0)] * 3, *[(3e-3, 1e-2)] * 3,
        *[(5e-4, 3e-3)] * 3,
    )  # fmt: skip
    gains = np.concatenate([draw(rows, 1, low=low, high=high) for low, high in ends], axis=-1)
    return gains, _states(draw, rows, upright=1.4, rate=300.0)


def lee_integral_states() -> tuple[Array, Array]:
    """Return gains (RUNS, 22), those of ``lee_states`` and of both integrals, and states (RUNS, STEPS, 20). Position and
    velocity are asked for so gently that what is wanted stays upwards."""
    draw = Draws(SEED + 5)
    ends = (
        (0.02, 0.05), *[(1e-5, 4e-5)] * 3, *[(1.0, 4.0)] * 3, *[(0.5, 2.0)] * 3, *[(3e-3, 1e-2)] * 3, *[(5e-4, 3e-3)] * 3,
        *[(0.0, 50.0)] * 3, *[(0.0, 0.5)] * 3,
    )  # fmt: skip
    gains = np.concatenate([draw(RUNS, 1, low=low, high=high) for low, high in ends], axis=-1)
    return gains, _states(draw, RUNS, STEPS, upright=2.5, rate=100.0)


def mellinger_states() -> tuple[Array, Array]:
    """Return gains (RUNS, 19) in the order of ``MELLINGER``, and states (RUNS, STEPS, 20)."""
    draw = Draws(SEED + 1)
    gains = np.concatenate([draw(RUNS, 1, low=low, high=high) for low, high in MELLINGER_ENDS], axis=-1)
    return gains, _states(draw, RUNS, STEPS, upright=1.2, rate=100.0)


def _states(draw: Draws, *shape: int, upright: float, rate: float) -> Array:
    """Return quaternion (4), position, velocity, gyro [deg/s], wanted position, velocity, yaw [deg] (1), (..., 20)."""
    half = np.float32(0.5)
    parts = (
        draw.unit_quaternions(*shape, upright=upright), half * draw(*shape, 3), half * draw(*shape, 3),
        np.float32(rate) * draw(*shape, 3), half * draw(*shape, 3), half * draw(*shape, 3), np.float32(180.0) * draw(*shape, 1),
    )  # fmt: skip
    return np.concatenate(parts, axis=-1)


def pid_states() -> Array:
    """Return angles [deg], nose down positive, position, velocity, gyro [deg/s], wanted position, yaw, (RUNS, STEPS, 16)."""
    draw = Draws(SEED + 2)
    ends = np.array((30.0, 30.0, 180.0), np.float32)
    angles = ends * draw(RUNS, 1, 3) + np.float32(0.5) * draw(RUNS, STEPS, 3)
    gyro = np.float32(40.0) * draw(RUNS, 1, 3) + np.float32(3.0) * draw(RUNS, STEPS, 3)
    gyro[:, 0] *= np.float32(0.2)
    places = [np.float32(size) * draw(RUNS, STEPS, 3) for size in (0.4, 0.6)]
    yaw = np.repeat(angles[:, :1, 2:] + np.float32(25.0) * draw(RUNS, 1, 1), STEPS, axis=1)
    angles[..., 2:], yaw = (x - np.float32(360.0) * np.round(x / np.float32(360.0)) for x in (angles[..., 2:], yaw))
    return np.concatenate((angles, *places, gyro, np.float32(0.4) * draw(RUNS, STEPS, 3), yaw), axis=-1)


def brescianini_states() -> tuple[Array, Array]:
    """Return gains (RUNS, 5) in the order of ``BRESCIANINI``, and states (RUNS, STEPS, 24). Behind the 20 numbers of the
    others stand a wanted acceleration (3) and yaw rate [deg/s]."""
    draw = Draws(SEED + 4)
    gains = np.concatenate([draw(RUNS, 1, low=low, high=high) for low, high in BRESCIANINI.values()], axis=-1)
    states = _states(draw, RUNS, STEPS, upright=2.5, rate=250.0)
    more = draw(RUNS, STEPS, 3), np.float32(60.0) * draw(RUNS, STEPS, 1)
    return gains, np.concatenate((states, *more), axis=-1)


def power_states() -> Array:
    """Return thrust, roll, pitch, yaw [whole counts], (POWER_ROWS, 4): a third of each size, of which the last is cut off."""
    draw = Draws(SEED + 3)
    size = np.repeat(np.array((2000.0, 8000.0, 30000.0), np.float32), (POWER_ROWS + 2) // 3)[:POWER_ROWS, None]
    thrust = draw(POWER_ROWS, 1, low=0.0, high=65535.0)
    return np.trunc(np.concatenate((thrust, size * draw(POWER_ROWS, 3)), axis=-1))


def states_checksum() -> int:
    states = (
        *lee_states(), *mellinger_states(), pid_states(), power_states(), *brescianini_states(),
        *lee_integral_states(),
    )  # fmt: skip
    return checksum(*states)


def _fill(row: Array) -> tuple[State, SensorData, Setpoint]:
    state, sensors, wanted = State(), SensorData(), Setpoint()
    state.quaternion, state.position.v, state.velocity.v = (
        _float_array(row[:4]), _float_array(row[4:7]), _float_array(row[7:10]),
    )  # fmt: skip
    sensors.gyro, wanted.position.v, wanted.velocity.v = (
        _float_array(row[10:13]), _float_array(row[13:16]), _float_array(row[16:19]),
    )  # fmt: skip
    wanted.attitude.v = _float_array((0.0, 0.0, row[19]))
    wanted.mode = (c_int * 7)(1, 1, 1, 0, 0, 1, 0)  # position and yaw
    return state, sensors, wanted


def _float_array(numbers: "Array | tuple[float, ...]") -> ctypes.Array[c_float]:
    return (c_float * len(numbers))(*(float(x) for x in numbers))


def _counts(control: Control) -> tuple[float, int, int, int]:
    counts = control.answer.counts
    return counts.thrust, counts.roll, counts.pitch, counts.yaw


def answers(library: ctypes.CDLL) -> dict[str, Array]:
    """Return the outputs of the controllers by name: Lee and Brescianini in SI units, the others in counts."""
    return {
        "lee": _ask_lee(library), "lee_integrals": _ask_lee_integrals(library), "mellinger": _ask_mellinger(library),
        "pid": _ask_pid(library), "brescianini": _ask_brescianini(library, steps=STEPS, mixing_factor=1.0),
        "brescianini_reduced": _ask_brescianini(library, steps=1, mixing_factor=0.0)[:, 0],
        "power": _ask_power(library),
    }  # fmt: skip


def _ask_lee(library: ctypes.CDLL) -> Array:
    result = []
    for gains, row in zip(*lee_states(), strict=True):
        own, control = Lee(), Control()
        library.controllerLeeInit(byref(own))
        own.mass, own.inertia, own.position, own.velocity = (
            float(gains[0]),
            *(_float_array(gains[i : i + 3]) for i in (1, 4, 7)),
        )
        own.attitude, own.rate, own.turned = (
            _float_array(gains[10:13]), _float_array(gains[13:16]), _float_array((0.0, 0.0, 0.0)),
        )  # fmt: skip
        state, sensors, wanted = _fill(row)
        library.controllerLee(byref(own), byref(control), byref(wanted), byref(sensors), byref(state), c_uint32(0))
        result.append(list(control.answer.wrench))
    return np.array(result, np.float32)


def _ask_lee_integrals(library: ctypes.CDLL) -> Array:
    result = []
    for gains, rows in zip(*lee_integral_states(), strict=True):
        own = Lee()
        library.controllerLeeInit(byref(own))
        own.mass, own.inertia, own.position, own.velocity = (
            float(gains[0]),
            *(_float_array(gains[i : i + 3]) for i in (1, 4, 7)),
        )
        own.attitude, own.rate, own.integral, own.turned = (_float_array(gains[i : i + 3]) for i in (10, 13, 16, 19))
        for k, row in enumerate(rows):
            control, (state, sensors, wanted) = Control(), _fill(row)
            library.controllerLee(*map(byref, (own, control, wanted, sensors, state)), c_uint32(2 * k))
            result.append(list(control.answer.wrench))
    return np.array(result, np.float32).reshape(RUNS, STEPS, 4)


def _ask_mellinger(library: ctypes.CDLL) -> Array:
    result = []
    for gains, rows in zip(*mellinger_states(), strict=True):
        own = Mellinger()
        library.controllerMellingerInit(byref(own))
        for name, gain in zip(MELLINGER, gains, strict=True):
            setattr(own, name, float(gain))
        library.controllerMellingerReset(byref(own))
        own.rest = (c_float * 64)()
        for k, row in enumerate(rows):
            control, (state, sensors, wanted) = Control(), _fill(row)
            arguments = map(byref, (own, control, wanted, sensors, state))
            library.controllerMellinger(*arguments, c_uint32(2 * k))
            result.append(_counts(control))
    return np.array(result, np.float32).reshape(RUNS, STEPS, 4)


def _ask_pid(library: ctypes.CDLL) -> Array:
    library.controllerPidInit()
    result = []
    for rows in pid_states():
        library.attitudeControllerResetAllPID(*map(c_float, _nose_up(rows[0, :3])))
        library.positionControllerResetAllPID(c_float(0.0), c_float(0.0), c_float(0.0))
        library.positionControllerResetAllfilters()
        for k, row in enumerate(rows):
            control, state, sensors, wanted = Control(), State(), SensorData(), Setpoint()
            state.attitude.v, state.position.v, state.velocity.v = (
                _float_array(_nose_up(row[:3])), _float_array(row[3:6]), _float_array(row[6:9]),
            )  # fmt: skip
            sensors.gyro, wanted.position.v, wanted.attitude.v = (
                _float_array(row[9:12]), _float_array(row[12:15]), _float_array((0.0, 0.0, row[15])),
            )  # fmt: skip
            wanted.mode = (c_int * 7)(1, 1, 1, 0, 0, 1, 0)
            library.controllerPid(*map(byref, (control, wanted, sensors, state)), c_uint32(2 * k))
            result.append(_counts(control))
    return np.array(result, np.float32).reshape(RUNS, STEPS, 4)


def _ask_brescianini(library: ctypes.CDLL, *, steps: int, mixing_factor: float) -> Array:
    parameters = _parameters(library, "ctrlAtt")
    library.controllerBrescianiniInit()
    parameters["mixing_factor"].value = mixing_factor
    result = []
    for gains, rows in zip(*brescianini_states(), strict=True):
        for name, gain in zip(BRESCIANINI, gains, strict=True):
            parameters[name].value = float(gain)
        for k, row in enumerate(rows[:steps]):
            control, (state, sensors, wanted) = Control(), _fill(row)
            wanted.acceleration.v, wanted.rates.v = _float_array(row[20:23]), _float_array((0.0, 0.0, row[23]))
            library.controllerBrescianini(*map(byref, (control, wanted, sensors, state)), c_uint32(2 * k))
            result.append(list(control.answer.wrench))
    return np.array(result, np.float32).reshape(RUNS, steps, 4)


def _parameters(library: ctypes.CDLL, group: str) -> Mapping[str, c_float]:
    """Return the parameters of a group, to be read and set."""
    result = {}
    for row in (ParamStruct * 64).in_dll(library, f"parameters_{group}"):
        if row.name == f"stop_{group}".encode():
            break
        result[row.name.decode()] = c_float.from_address(row.address)
    return result


def _ask_power(library: ctypes.CDLL) -> Array:
    result = []
    for thrust, roll, pitch, yaw in power_states():
        control, uncapped, capped = Control(), RawThrust(), Pwm()
        control.answer.counts = Counts(int(roll), int(pitch), int(yaw), float(thrust))
        library.powerDistribution(byref(control), byref(uncapped))
        library.powerDistributionCap(byref(uncapped), byref(capped))
        result.append(list(capped.motors))
    return np.array(result, np.float32)


def _nose_up(angles: Array) -> tuple[float, float, float]:
    return float(angles[0]), -float(angles[1]), float(angles[2])


if __name__ == "__main__":
    write_vectors(
        __doc__ or "", "library", VECTORS, lambda path: answers(ctypes.CDLL(str(path.resolve()))), states_checksum()
    )
