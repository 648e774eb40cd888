"""Numbers of a vehicle with their origins, as a robot file. Letters: R rotors."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class ValueWithOrigin:
    """A number of the robot file with its origin: ``logged``, ``measured here`` or ``assumed``."""

    value: float
    origin: str

    @property
    def kind(self) -> str:
        """First word of the origin: assumed, given, logged or measured."""
        return self.origin.replace(":", " ").split()[0]

    @property
    def is_assumed(self) -> bool:
        """Whether neither log nor flight shows it."""
        return self.kind == "assumed"

    def weaken(self, values: Mapping[str, "ValueWithOrigin"], *names: str) -> "ValueWithOrigin":
        """Return the value as assumed if one of the named values is."""
        assumed = [name for name in names if name in values and values[name].is_assumed]
        if self.is_assumed or not assumed:
            return self
        return replace(self, origin=f"assumed: scales with the assumed {' and '.join(assumed).replace('_', ' ')}")


LABELS = {
    "mass": "mass [kg]",
    "arm": "arm [m]",
    "thrust": "thrust per squared speed [N s²/rad²]",
    "hover_thrust": "rotor thrust at the mean command [N]",
    "thrust_exponent": "exponent of the command's thrust",
    "inertia_x": "inertia about x [kg m²]",
    "inertia_y": "inertia about y [kg m²]",
    "inertia_z": "inertia about z [kg m²]",
    "torque_ratio": "torque ratio [m]",
    "lag": "rotor lag [s]",
    "largest_thrust": "rotor thrust at full command [N]",
    "radius": "propeller radius [m]",
    "pitch_ratio": "propeller pitch per diameter",
    "blades": "blades of a propeller",
    "voltage": "nominal battery voltage [V]",
    "capacity": "battery capacity [A s]",
    "resistance": "battery resistance [Ohm]",
    "roll": "roll acceleration {} [rad/s²]",
    "pitch": "pitch acceleration {} [rad/s²]",
    "yaw": "yaw acceleration {} [rad/s²]",
    "speed_offset": "speed at command 0 [rad/s]",
    "speed_gain": "further speed at command 1 [rad/s]",
    "speed_power": "exponent of the command's speed",
}
"""Names and units of the numbers for people; the accelerations are those of a rotor."""


@dataclass(frozen=True, kw_only=True)
class VehicleDraft:
    """Numbers of a robot file with their origins."""

    values: dict[str, ValueWithOrigin]
    places: Array  # Of the rotors [m], (R, 3)
    axes: Array | None = None  # Directions of thrust, (R, 3); None: all upwards
    spins: tuple[int, ...]
    layout_origin: str
    force_mode: bool = False  # Whether commands are thrusts, since the log has no speeds


def arm_by_mass(mass: float) -> ValueWithOrigin:
    """Return the distance of the rotors from the centre [m] of a vehicle of a mass [kg]."""
    return ValueWithOrigin(value=0.12 * mass ** (1.0 / 3.0) + 0.05, origin="assumed: from the mass, +- 40 %")


def inertia_by_reach(mass: float, reach: float) -> ValueWithOrigin:
    """Return the inertia [kg m²] about an axis from which the rotors have a distance [m]."""
    return ValueWithOrigin(value=0.4 * mass * reach**2, origin="assumed: 0.4 m arm², +- 50 %")


def robot_yaml_with_origins(draft: VehicleDraft, *, name: str, command: str = "aerial-gym robot from-log") -> str:
    """Return the robot file, with the origin of each number beside it; the ``command`` that writes it is its source."""
    v = draft.values

    def line(key: str, number: str, source: ValueWithOrigin) -> str:
        return f"  {key}: {number}  # {source.origin}"

    moments = [v[f"inertia_{axis}"] for axis in "xyz"]
    rows = np.diag([moment.value for moment in moments])
    inertia = [
        f"  - [{', '.join(f'{number:.12g}' for number in row)}]  # {moment.origin}"
        for row, moment in zip(rows, moments, strict=True)
    ]
    reach = float(np.linalg.norm(draft.places, axis=1).max())
    rotor = (
        ["  mode: force"]
        if draft.force_mode
        else [line("thrust_map", f"[0.0, 0.0, {v['thrust'].value:.6g}]", v["thrust"])]
    )
    axes = np.tile((0.0, 0.0, 1.0), (len(draft.spins), 1)) if draft.axes is None else draft.axes

    def vector(numbers: Array) -> str:
        return f"[{', '.join(f'{x:.5g}' for x in numbers)}]"

    mounts = [
        f"  - {{position: {vector(place)}, {'' if axis[2] > 0.9999 else f'axis: {vector(axis)}, '}spin: {spin}}}"
        for place, axis, spin in zip(draft.places, axes, draft.spins, strict=True)
    ]
    arm = f"; arm {v['arm'].origin}" if "arm" in v else ""
    size, origin = (
        (reach + v["radius"].value, "tips of the propellers") if "radius" in v else (1.2 * reach, "1.2 times the arm")
    )
    source = json.dumps(f"{command} {name}")
    return "\n".join((
        f"summary: {json.dumps(f'vehicle of {name}')}", "body:",
        line("mass", f"{v['mass'].value:g}", v["mass"]), "  inertia:", *inertia,
        f"  source: {source}", "rotor:", *rotor, line("torque_ratio", f"{v['torque_ratio'].value:.4g}", v["torque_ratio"]),
        *(line(f"time_constant_{way}", f"{v['lag'].value:.4g}", v["lag"]) for way in ("up", "down")),
        line("thrust_range", f"[0.0, {v['largest_thrust'].value:.5g}]", v["largest_thrust"]),
        *([line("radius", f"{v['radius'].value:.4g}", v["radius"])] if "radius" in v else []), f"  source: {source}",
        f"mounts:  # {draft.layout_origin}{arm}", "  layout:", *mounts, f"  source: {source}",
        "collision:", f"  spheres: [{{center: [0.0, 0.0, 0.0], radius: {size:.4g}}}]  # assumed: {origin}",
        f"  source: {source}", *(_battery_lines(v, source) if "voltage" in v else []), "",
    ))  # fmt: skip


def _battery_lines(v: Mapping[str, ValueWithOrigin], source: str) -> list[str]:
    cells = round(v["voltage"].value / 3.7)
    return [
        "battery:  # for the effect battery_sag alone", f"  nominal_voltage: {v['voltage'].value:.4g}  # {v['voltage'].origin}",
        f"  full_voltage: {4.2 * cells:.4g}  # assumed: 4.2 V per cell", f"  empty_voltage: {3.5 * cells:.4g}  # assumed",
        f"  internal_resistance: {v['resistance'].value:.3g}  # {v['resistance'].origin}",
        f"  capacity: {v['capacity'].value:.5g}  # {v['capacity'].origin}", f"  source: {source}",
    ]  # fmt: skip
