"""Places and spins of rotors, and the thrust of their commands, as a log states them.

Sources: PX4 parameter reference (CA_AIRFRAME, CA_ROTOR*, THR_MDL_FAC) and airframe reference (SYS_AUTOSTART); ArduPilot,
``AP_MotorsMulticopter.cpp`` (MOT_SPIN_MIN, MOT_SPIN_MAX, MOT_THST_EXPO). Body axes are forward, left, up; a spin of 1 turns
positively about the thrust. Letters: R rotors.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from aerial_gym.config.robot import RobotCfg
from aerial_gym.errors import ConfigError
from aerial_gym.robots.catalog import robot_by_name
from aerial_gym.robots.drafts.frames import FRAMES, frame_rotors
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.logs.raw_log import RawLog
from aerial_gym.sim2real.logs.readers.csv_log import read_facts
from aerial_gym.sim2real.logs.readers.log_readers import read_raw_log
from aerial_gym.sim2real.logs.recording import split_flight_number

DEFAULT_RATIO = 0.05  # PX4's default of CA_ROTOR*_KM, which says nothing of a vehicle
PLACEHOLDER = 0.99  # Arms of 1 m or more in PX4's parameters are placeholders
DSHOT = (48.0, 2047.0)  # Motor values of DShot without and with full throttle; those of PWM are 1000 and 2000

ARDUPILOT_CLASSES = {
    1: ("quad", {0: "plus", 1: "x", 2: "x", 3: "h", 6: "plus_reversed", 12: "x_betaflight", 13: "x_dji", 14: "x_clockwise",
                 18: "x_betaflight_reversed"}),
    2: ("hexa", {0: "plus", 1: "x", 13: "x_dji", 14: "x_clockwise"}),
    3: ("octo", {0: "plus", 1: "x", 13: "x_dji", 14: "x_clockwise"}),
    4: ("coax_quad", {0: "plus", 1: "x", 2: "x", 3: "h"}),
    12: ("coax_hexa", {0: "plus", 1: "x"}),
}  # fmt: skip
"""Frames by FRAME_CLASS and FRAME_TYPE; a V frame (2) has the places of an X."""

PX4_SERIES = {
    4: "quad_x", 5: "quad_plus", 6: "hexa_x", 7: "hexa_plus", 8: "octo_x", 9: "octo_plus", 10: "quad_x", 12: "coax_quad_x",
}  # fmt: skip
"""Frames by the thousands of SYS_AUTOSTART, for PX4 before CA_ROTOR*."""

DEFAULTS = {4: "quad_x", 6: "hexa_x", 8: "octo_x"}  # Frames by number of rotors for logs that state none
BETAFLIGHT_DEFAULTS = {4: "quad_x_betaflight", 6: "hexa_x_betaflight", 8: "coax_quad_x_betaflight"}

BEYOND_ROTORS = {
    "FRAME_CLASS": {6: "helicopter", 7: "tricopter", 8: "single", 9: "coaxial", 10: "tail-sitter", 11: "helicopter"},
    "Q_ENABLE": {1: "QuadPlane"},
    "CA_AIRFRAME": {1: "fixed wing", 2: "VTOL", 3: "tilt-rotor", 4: "tail-sitter", 8: "tilting", 10: "helicopter"},
    "MAV_TYPE": {1: "fixed wing", 4: "helicopter", 15: "tricopter"}
    | {19: "tail-sitter", 20: "tail-sitter", 21: "tilt-rotor"},
}
"""Vehicles with more than fixed rotors, by the parameters that say so."""


@dataclass(frozen=True, kw_only=True)
class ThrustLaw:
    """Thrust of a command u as a share of full thrust: ``f a² + (1 - f) a`` with ``a = ((u - low) / (high - low))^power``."""

    square: float = 0.0  # f
    low: float = 0.0
    high: float = 1.0
    power: float = 1.0
    origin: str = "assumed: proportional to the command; the log states no curve"

    def share(self, command: Array) -> Array:
        """Return the thrust of commands as a share, in their shape."""
        a = np.clip((command - self.low) / (self.high - self.low), 0.0, None) ** self.power
        return self.square * a**2 + (1.0 - self.square) * a

    def slope(self, command: float) -> float:
        """Return the exponent of the power law with the same slope at a command."""
        low, high = self.share(np.array((0.999, 1.001)) * command)
        return float(np.log(high / low) / np.log(1.001 / 0.999)) if low > 0.0 else 1.0


@dataclass(frozen=True, kw_only=True)
class RotorLayout:
    """Rotors as the log or a person states them."""

    count: int
    places: Array | None = None  # [m], or of arbitrary length, (R, 3)
    axes: Array | None = None  # Directions of thrust, (R, 3); None: all upwards
    spins: tuple[int, ...] | None = None
    has_lengths: bool = False
    torque_ratio: float | None = None  # Drag torque per thrust [m]
    law: ThrustLaw = ThrustLaw()
    source: str = "the log"
    origin: str = "logged"  # Or ``assumed`` or ``given``
    notes: tuple[str, ...] = ()

    @property
    def weights(self) -> Array | None:
        """Torque of each rotor about roll, pitch and yaw, relative to the largest of each axis, (3, R)."""
        if self.places is None or self.spins is None:
            return None
        axes = np.tile((0.0, 0.0, 1.0), (self.count, 1)) if self.axes is None else self.axes
        torques = np.stack((*np.cross(self.places, axes).T[:2], -np.array(self.spins, dtype=np.float64)))
        torques = torques / np.maximum(np.abs(torques).max(axis=1, keepdims=True), 1e-12)
        return np.where(np.abs(torques) < 0.05, 0.0, torques)

    def may_be_of_same_vehicle(self, other: "RotorLayout") -> bool:
        """Return whether both can be of one vehicle; a log that states no places agrees with any of as many rotors."""
        if self.count != other.count or self.places is None or other.places is None:
            return self.count == other.count
        return self.spins == other.spins and np.allclose(self.places, other.places, atol=0.01)


def layout_in_log(path: str, count: int, frame: str | None = None) -> RotorLayout:
    """Return the rotors that a log states, or those of a frame: a name of ``FRAMES`` or a robot file."""
    file = Path(split_flight_number(path)[0])
    raw = read_raw_log(file)
    if raw is None:
        law = (
            ThrustLaw() if read_facts(file) else ThrustLaw(square=1.0, origin="assumed: the square of the rotor speed")
        )
        layout = RotorLayout(count=count, law=law)
    else:
        layout = _layout_of_parameters(raw, count)
    if frame is not None:
        given = frame_layout(frame, count)
        return replace(given, law=layout.law, notes=layout.notes, origin="given", source="--frame")
    if layout.places is None and count in DEFAULTS:
        assumed = replace(frame_layout(DEFAULTS[count], count), law=layout.law, notes=layout.notes)
        return replace(assumed, origin="assumed", source=f"{DEFAULTS[count]}, as the log states no frame")
    return layout


def frame_layout(name: str, count: int) -> RotorLayout:
    """Return the rotors of a frame by its name or of a robot file; raise ``ConfigError`` for another number of rotors."""
    if name.endswith((".yaml", ".yml")):
        layout = layout_of_robot(robot_by_name(name))
    else:
        places, spins = frame_rotors(name, more="; or give a robot file that ends in .yaml")
        layout = RotorLayout(count=len(places), places=places, spins=spins)
    if layout.count != count:
        raise ConfigError(
            f"--frame {name}: has {layout.count} rotors, and the log has {count}; give the frame of this vehicle"
        )
    return replace(layout, source=name)


def layout_of_robot(robot: RobotCfg) -> RotorLayout:
    """Return the rotors of a robot."""
    mounts = robot.mounts.layout
    places, spins = np.array([mount.position for mount in mounts]), tuple(mount.spin for mount in mounts)
    axes = np.array([mount.axis for mount in mounts])
    return RotorLayout(count=len(mounts), places=places, axes=axes, spins=spins, has_lengths=True)


def _layout_of_parameters(raw: RawLog, count: int) -> RotorLayout:
    """Return the rotors that parameters or headers state."""
    kinds = [known.get(int(raw.number(key, 0.0))) for key, known in BEYOND_ROTORS.items() if key in raw.parameters]
    notes = tuple(
        f"The log is of a vehicle of type {kind}: only fixed rotors are modelled, no wings, control surfaces or tilting rotors."
        for kind in dict.fromkeys(kinds) if kind
    )  # fmt: skip
    if {"CA_ROTOR_COUNT", "CA_ROTOR0_PX"} & raw.parameters.keys():
        layout = _px4_layout(raw, count)
        return replace(layout, notes=(*notes, *layout.notes))
    if "FRAME_CLASS" in raw.parameters:
        kind, number = (int(raw.number(name, 0.0)) for name in ("FRAME_CLASS", "FRAME_TYPE"))
        y6 = {10: "y6b", 11: "y6f"}.get(number, "y6")
        family, types = ARDUPILOT_CLASSES.get(kind, ("", {}))
        name = y6 if kind == 5 else "y4" if (kind, number) == (1, 19) else f"{family}_{types.get(number)}"
        return _layout_of_known_frame(
            name, count, f"FRAME_CLASS {kind}, FRAME_TYPE {number}", _ardupilot_thrust_law(raw), notes
        )
    if "SYS_AUTOSTART" in raw.parameters:
        series = int(raw.number("SYS_AUTOSTART", 0.0))
        name = PX4_SERIES.get(series // 1000, "")
        return _layout_of_known_frame(name, count, f"SYS_AUTOSTART {series}", _px4_thrust_law(raw), notes)
    if raw.format == "blackbox":
        name = BETAFLIGHT_DEFAULTS.get(count, "")
        layout = _layout_of_known_frame(
            name, count, f"{name}, Betaflight's default", _betaflight_thrust_law(raw), notes
        )
        return replace(layout, origin="assumed")
    return RotorLayout(count=count, notes=notes)


def _layout_of_known_frame(name: str, count: int, source: str, law: ThrustLaw, notes: tuple[str, ...]) -> RotorLayout:
    if name not in FRAMES or len(FRAMES[name].split()) != count:
        return RotorLayout(count=count, law=law, notes=notes)
    return replace(frame_layout(name, count), law=law, source=source, notes=notes)


def _ardupilot_thrust_law(raw: RawLog) -> ThrustLaw:
    """Return the curve between the signals of least and largest thrust."""
    low, high = raw.number("MOT_SPIN_MIN", 0.0), raw.number("MOT_SPIN_MAX", 1.0)
    curve = raw.number("MOT_THST_EXPO", 0.0)
    low, high = (low, high) if low < high else (0.0, 1.0)
    return ThrustLaw(square=curve, low=low, high=high, origin="logged: MOT_THST_EXPO, MOT_SPIN_MIN and MOT_SPIN_MAX")


def _px4_thrust_law(raw: RawLog) -> ThrustLaw:
    curve = raw.number("THR_MDL_FAC", 0.0)
    if curve <= 0.0:
        return ThrustLaw(origin="assumed: proportional to the command, PX4's default (THR_MDL_FAC = 0)")
    return ThrustLaw(square=curve, origin="logged: THR_MDL_FAC")


def _betaflight_thrust_law(raw: RawLog) -> ThrustLaw:
    """Return the square of the duty cycle, which commands count from idle to the motor output limit."""
    parts = str(raw.parameters.get("motorOutput", "")).split(",")
    low, high = map(float, parts) if len(parts) == 2 and all(part.isdigit() for part in parts) else DSHOT
    off, full = DSHOT if low < 1000.0 else (1000.0, 2000.0)
    idle, most = (low - off) / (full - off), (high - off) / (full - off)
    zero = -idle / (most - idle) if most > idle else 0.0
    return ThrustLaw(square=1.0, low=zero, origin="assumed: the square of the duty cycle; motorOutput states its range")


def _px4_layout(raw: RawLog, count: int) -> RotorLayout:
    """Return the rotors of PX4's control allocation; arms of 1 m are placeholders, of which only the pattern counts."""
    listed = int(raw.number("CA_ROTOR_COUNT", 0.0)) or count
    if listed != count:
        note = f"CA_ROTOR_COUNT = {listed} does not fit the {count} rotors in the log: the parameters of rotors are not used."
        return RotorLayout(count=count, law=_px4_thrust_law(raw), notes=(note,))

    def vectors(kind: str, last: float = 0.0) -> Array:
        names = ((1.0, "X", 0.0), (-1.0, "Y", 0.0), (-1.0, "Z", last))
        return np.array([[s * raw.number(f"CA_ROTOR{k}_{kind}{n}", d) for s, n, d in names] for k in range(count)])

    places, axes = vectors("P"), vectors("A", -1.0)
    moments = np.array([raw.number(f"CA_ROTOR{k}_KM", 0.0) for k in range(count)])
    law = _px4_thrust_law(raw)
    if not np.abs(places[:, :2]).any() or not moments.all():
        return RotorLayout(count=count, law=law)
    ratio = float(np.abs(moments).mean())
    real = float(np.abs(places[:, :2]).max()) < PLACEHOLDER
    return RotorLayout(
        count=count, places=places, axes=axes, spins=tuple(int(s) for s in np.sign(moments)), has_lengths=real,
        torque_ratio=None if abs(ratio - DEFAULT_RATIO) < 1e-4 else ratio, law=law,
        source="CA_ROTOR*" if real else "CA_ROTOR*, whose arms of 1 m are placeholders",
    )  # fmt: skip
