"""Numbers of a vehicle with their origins, as a robot file and as a mapping of its commands. Letters: R rotors."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from aerial_gym.config.loader import dump_yaml
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.logs.flights import POWERED
from aerial_gym.sim2real.logs.readers.log_readers import find_reader
from aerial_gym.sim2real.logs.readers.mapping import ColumnsCfg, LogMapping, find_mapping
from aerial_gym.sim2real.logs.recording import FlightLog, split_flight_number
from aerial_gym.sim2real.teststand.effectiveness import CommandCurve, Effectiveness

SOURCE = "aerial-gym robot from-log"


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
    """Numbers of a robot file with their origins, and the questions that are left."""

    values: dict[str, ValueWithOrigin]
    places: Array  # Of the rotors [m], (R, 3)
    axes: Array | None = None  # Directions of thrust, (R, 3); None: all upwards
    spins: tuple[int, ...]
    layout_origin: str
    curve: CommandCurve | None
    effectiveness: Effectiveness | None
    questions: tuple[str, ...]
    notes: tuple[str, ...] = field(default=())
    force_mode: bool  # Whether commands are thrusts, since the log has no speeds
    mapping: str = ""  # Text of a mapping file that turns logged commands into those of the robot


def mean_command(logs: Sequence[FlightLog]) -> float:
    """Return the mean of the commands with which the rotors carry the vehicle."""
    commands = np.concatenate([log.rotor_command.ravel() for log in logs if log.rotor_command is not None])
    return float(commands[commands > POWERED * np.quantile(commands, 0.9)].mean())


def command_mapping_yaml(draft: VehicleDraft, logs: Sequence[FlightLog], mapping: LogMapping | None) -> str:
    """Return a mapping that turns logged commands into speeds [rad/s], or into thrusts [N] without measured speeds.

    A thrust curve becomes the power law with the same thrust and slope at the mean command. Text files keep the rest of their
    mapping. Empty without commands, or if a mapping converts them already.
    """
    curve, has_commands = draft.curve, all(log.rotor_command is not None for log in logs)
    is_text = find_reader(Path(split_flight_number(logs[0].path)[0])) is None
    base = (mapping or find_mapping("aerial_gym")) if is_text else mapping
    own = ColumnsCfg(columns=("rotor_command",)) if base is None else base.rotor_command
    if own is None or not has_commands or own != ColumnsCfg(columns=own.columns, fill_gap_s=own.fill_gap_s):
        return ""
    if curve is not None:
        power, offset = curve.power.value, curve.offset.value
        law = replace(own, gain=curve.gain.value / curve.full**power, power=power, offset=offset)
    elif draft.force_mode:
        u, power = mean_command(logs), draft.values["thrust_exponent"].value
        law = replace(own, gain=draft.values["hover_thrust"].value / u**power, power=power)
    else:
        return ""
    if base is not None:
        return dump_yaml(replace(base, rotor_command=law, source=SOURCE))
    name, origin = (
        ("thrust", draft.values["thrust_exponent"]) if curve is None else ("speed", draft.values["speed_power"])
    )
    numbers = f"gain: {law.gain:.7g}, power: {law.power:.7g}, offset: {law.offset:.7g}"
    return "\n".join((
        f"summary: {name} of the commands of this vehicle", "time: {columns: [t]}",
        f"rotor_command: {{columns: [rotor_command], {numbers}}}  # power {origin.origin}", f"source: {SOURCE}", "",
    ))  # fmt: skip


def robot_yaml_with_origins(draft: VehicleDraft, *, name: str) -> str:
    """Return the robot file, with the origin of each number beside it."""
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
    source = json.dumps(f"{SOURCE} {name}")
    return "\n".join((
        f"summary: {json.dumps(f'vehicle of {name}')}", "body:",
        line("mass", f"{v['mass'].value:g}", v["mass"]), "  inertia:", *inertia,
        f"  source: {source}", "rotor:", *rotor, line("torque_ratio", f"{v['torque_ratio'].value:.4g}", v["torque_ratio"]),
        *(line(f"time_constant_{way}", f"{v['lag'].value:.4g}", v["lag"]) for way in ("up", "down")),
        line("thrust_range", f"[0.0, {v['largest_thrust'].value:.5g}]", v["largest_thrust"]), f"  source: {source}",
        f"mounts:  # {draft.layout_origin}{arm}", "  layout:", *mounts, f"  source: {source}",
        "collision:", f"  spheres: [{{center: [0.0, 0.0, 0.0], radius: {1.2 * reach:.4g}}}]  # assumed: 1.2 times the arm",
        f"  source: {source}", "",
    ))  # fmt: skip
