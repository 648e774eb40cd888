"""Places and spins of rotors that a log states: by PX4's parameters, or by the frame of Betaflight and ArduPilot.

Sources: PX4 parameter reference, CA_ROTOR*; Betaflight documentation, Mixer (QUADX); ArduPilot documentation, Connect ESCs and
Motors (quadrotor frames). Body axes are forward, left, up; a spin of 1 turns positively about the thrust.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from aerial_gym.errors import DataError
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.logs.readers.log_readers import read_raw_log
from aerial_gym.sim2real.logs.recording import split_flight_number

DEFAULT_RATIO = 0.05  # PX4's default of CA_ROTOR*_KM, which says nothing of a vehicle
PLACEHOLDER = 0.99  # Arms of 1 m or more in PX4's parameters are placeholders
FRONT, REAR, LEFT, RIGHT = 1.0, -1.0, 1.0, -1.0
BETAFLIGHT_X = (((REAR, RIGHT), (FRONT, RIGHT), (REAR, LEFT), (FRONT, LEFT)), (-1, 1, 1, -1))
ARDUPILOT_FRAMES = {
    (1, 0): (((0.0, RIGHT), (0.0, LEFT), (FRONT, 0.0), (REAR, 0.0)), (1, 1, -1, -1)),
    (1, 1): (((FRONT, RIGHT), (REAR, LEFT), (FRONT, LEFT), (REAR, RIGHT)), (1, 1, -1, -1)),
}
"""Places and spins by FRAME_CLASS and FRAME_TYPE."""


@dataclass(frozen=True, kw_only=True)
class RotorLayout:
    """Rotors as the log states them."""

    count: int
    places: Array | None = None  # [m], or of arbitrary length, (R, 3)
    spins: tuple[int, ...] | None = None
    has_lengths: bool = False
    torque_ratio: float | None = None  # Drag torque per thrust [m]
    thrust_curve: float = 0.0  # Share of u² in the thrust of a command u; the rest is u
    source: str = "the log"

    @property
    def signs(self) -> Array | None:
        """Signs of the rotors about roll, pitch and yaw, (3, R)."""
        if self.places is None or self.spins is None:
            return None
        return np.sign(np.stack((self.places[:, 1], -self.places[:, 0], -np.array(self.spins, dtype=np.float64))))

    def may_equal(self, other: "RotorLayout") -> bool:
        """Return whether both can be of one vehicle; a log that states no places agrees with any of as many rotors."""
        if self.count != other.count or self.places is None or other.places is None:
            return self.count == other.count
        return self.spins == other.spins and np.allclose(self.places, other.places, atol=0.01)


def layout_in_log(path: str, count: int) -> RotorLayout:
    """Return the rotors that a log states."""
    raw = read_raw_log(Path(split_flight_number(path)[0]))
    if raw is None:
        return RotorLayout(count=count)
    parameters = raw.parameters
    if "CA_ROTOR_COUNT" in parameters or "CA_ROTOR0_PX" in parameters:
        return _px4_layout(parameters, count)
    if "FRAME_CLASS" in parameters:
        frame = int(_number(parameters, "FRAME_CLASS")), int(_number(parameters, "FRAME_TYPE"))
        curve = _number(parameters, "MOT_THST_EXPO")
        if frame in ARDUPILOT_FRAMES and count == 4:
            return _unit_layout(ARDUPILOT_FRAMES[frame], f"FRAME_CLASS {frame[0]}, FRAME_TYPE {frame[1]}", curve)
        return RotorLayout(count=count, thrust_curve=curve)
    if raw.format == "blackbox" and count == 4:
        reverse = _number(parameters, "yaw_motors_reversed") > 0.0
        places, spins = BETAFLIGHT_X
        return _unit_layout((places, tuple(-s for s in spins) if reverse else spins), "Betaflight's QUADX", 1.0)
    return RotorLayout(count=count)


def _number(parameters: Mapping[str, float | str], name: str) -> float:
    value = parameters.get(name, 0.0)
    return float(value) if isinstance(value, (int, float)) else 0.0


def _unit_layout(
    frame: tuple[tuple[tuple[float, float], ...], tuple[int, ...]], source: str, curve: float
) -> RotorLayout:
    places = np.array([(x, y, 0.0) for x, y in frame[0]])
    return RotorLayout(count=len(places), places=places, spins=frame[1], thrust_curve=curve, source=source)


def _px4_layout(parameters: Mapping[str, float | str], count: int) -> RotorLayout:
    """Return the rotors of PX4's control allocation; arms of 1 m are placeholders, of which only the pattern counts."""
    listed = int(_number(parameters, "CA_ROTOR_COUNT")) or count
    if listed != count:
        raise DataError(f"CA_ROTOR_COUNT = {listed}, but the log has {count} rotors; give a log of one vehicle")
    places = np.array([
        [sign * _number(parameters, f"CA_ROTOR{k}_P{axis}") for sign, axis in ((1.0, "X"), (-1.0, "Y"), (-1.0, "Z"))]
        for k in range(count)
    ])  # fmt: skip
    moments = np.array([_number(parameters, f"CA_ROTOR{k}_KM") for k in range(count)])
    curve = _number(parameters, "THR_MDL_FAC")
    if not np.abs(places[:, :2]).any() or not moments.all():
        return RotorLayout(count=count, thrust_curve=curve)
    ratio = float(np.abs(moments).mean())
    real = float(np.abs(places[:, :2]).max()) < PLACEHOLDER
    return RotorLayout(
        count=count, places=places, spins=tuple(int(s) for s in np.sign(moments)), has_lengths=real,
        torque_ratio=None if abs(ratio - DEFAULT_RATIO) < 1e-4 else ratio, thrust_curve=curve,
        source="CA_ROTOR*" if real else "CA_ROTOR*, whose arms of 1 m are placeholders",
    )  # fmt: skip
