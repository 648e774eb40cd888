"""Numbers of a vehicle with their origins, as a robot file and as a mapping of its commands. Letters: R rotors."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from aerial_gym.config.loader import dump_yaml
from aerial_gym.robots.drafts.draft import VehicleDraft
from aerial_gym.sim2real.logs.flights import POWERED
from aerial_gym.sim2real.logs.readers.log_readers import find_reader
from aerial_gym.sim2real.logs.readers.mapping import ColumnsCfg, LogMapping, find_mapping
from aerial_gym.sim2real.logs.recording import FlightLog, split_flight_number
from aerial_gym.sim2real.teststand.command_curve import CommandCurve
from aerial_gym.sim2real.teststand.effectiveness import Effectiveness

SOURCE = "aerial-gym robot from-log"


@dataclass(frozen=True, kw_only=True)
class LogDraft(VehicleDraft):
    """Numbers of a robot file from logs, and the questions that are left."""

    curve: CommandCurve | None
    effectiveness: Effectiveness | None
    questions: tuple[str, ...]
    notes: tuple[str, ...] = field(default=())
    mapping: str = ""  # Text of a mapping file that turns logged commands into those of the robot


def mean_command(logs: Sequence[FlightLog]) -> float:
    """Return the mean of the commands with which the rotors carry the vehicle."""
    commands = np.concatenate([log.rotor_command.ravel() for log in logs if log.rotor_command is not None])
    return float(commands[commands > POWERED * np.quantile(commands, 0.9)].mean())


def command_mapping_yaml(draft: LogDraft, logs: Sequence[FlightLog], mapping: LogMapping | None) -> str:
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
