"""Draft of a mapping for a CSV file: quantities by the names of columns, units and frames by the motion itself.

The frames are those of 32 combinations whose motion is consistent: the gyro with the turns of the attitude, and the
acceleration with the accelerometer, or with the direction of thrust. Letters: T rows, R rotors.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.ndimage import uniform_filter1d
from scipy.spatial.transform import Rotation

from aerial_gym.errors import DataError
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.logs.column_names import column_families, count_foreign_words
from aerial_gym.sim2real.logs.readers.csv_lines import find_header, read_lines
from aerial_gym.sim2real.logs.readers.csv_table import read_csv_rows
from aerial_gym.sim2real.logs.readers.log_readers import find_reader
from aerial_gym.sim2real.logs.readers.mapping import (
    BODY_FRAMES,
    DIRECTIONS,
    UNIT_G,
    UNITS,
    WORLD_FRAMES,
    ColumnsCfg,
    LogMapping,
    to_package_frames,
)
from aerial_gym.sim2real.logs.signals import turns_over_rows

TIME_UNITS = ("si", "ms", "us", "ns")
USUAL_RATE = 200.0  # Of several units of time, the one counts whose rate is nearest by ratio [Hz]
MEAN_S = 0.25  # Window of means before motions are compared [s]
CLEAR = 2.0  # Ratio of the residuals of the second-best and the best frames from which the frames count as certain


@dataclass(frozen=True, kw_only=True)
class MappingDraft:
    """Mapping of a file, and the reason for each of its lines."""

    mapping: LogMapping
    reasons: dict[str, str] = field(default_factory=dict)  # By field of the mapping
    open_questions: tuple[str, ...] = ()

    def as_yaml(self) -> str:
        """Return the mapping as YAML, each line with its reason."""
        lines = [f"summary: {json.dumps(self.mapping.summary)}", *(f"# Open: {text}" for text in self.open_questions)]
        for name, quantity in self.mapping.quantities().items():
            lines.append(f"{name}: {_flow_mapping(quantity)}{self._comment(name)}")
        for name in FRAMES:
            if (value := getattr(self.mapping, name)) is not None:
                lines.append(f"{name}: {value}{self._comment(name)}")
        return "\n".join([*lines, f"source: {json.dumps(self.mapping.source)}", ""])

    def _comment(self, name: str) -> str:
        return f"  # {self.reasons[name]}" if name in self.reasons else ""


def _flow_mapping(quantity: ColumnsCfg) -> str:
    """Return the settings of a quantity that differ from the defaults, in one line of YAML."""
    default = ColumnsCfg(columns=("a",))
    entries = {"columns": list(quantity.columns)} | {
        key: value for key, value in vars(quantity).items() if key != "columns" and value != getattr(default, key)
    }
    return "{" + ", ".join(f"{key}: {json.dumps(value)}" for key, value in entries.items()) + "}"


def draft_mapping(path: str | Path) -> MappingDraft:
    """Return a mapping of a CSV file with unknown columns; raise ``DataError`` without a column of times."""
    if (reader := find_reader(Path(path))) is not None:
        raise DataError(f"{path}: is a log of the format {reader.name}, whose quantities are known; it needs no draft")
    header = find_header(iter(read_lines(Path(path))), "")
    if header is None:
        raise DataError(f"{path}: holds no rows; a flight log has one header line and one line per sample")
    families = column_families(header.names)
    table, time, layout = _read_by_any_time(Path(path), families)
    numbers = pd.DataFrame({name: pd.to_numeric(table[name], errors="coerce") for name in table.columns})
    moving = {str(name) for name, count in numbers.nunique().items() if count > 2}
    draft = MappingDraft(mapping=layout)
    for quantity, count in (("position", 3), ("lin_vel", 3), ("attitude", 4), ("ang_vel", 3), ("specific_force", 3)):
        if columns := _components(quantity, count, families, moving):
            draft = _with_quantity(draft, quantity, ColumnsCfg(columns=columns, fill_gap_s=0.05), "by its name")
    draft = _with_rotors(draft, families, moving, numbers)
    for quantity in ("battery", "armed", "landed"):
        draft = _with_scalar(draft, quantity, families, numbers)
    return _with_motion(draft, numbers, time)


def _read_by_any_time(
    path: Path, families: dict[tuple[str, ...], dict[str, str]]
) -> tuple[pd.DataFrame, Array, LogMapping]:
    """Return the rows, their times and a mapping with the time alone, from the first column that can be the time."""
    columns = [
        members[""]
        for family, members in families.items()
        if family[:-1] and "" in members and count_foreign_words("time", family) == 0
    ]
    for column in columns:
        for unit in TIME_UNITS:
            time = ColumnsCfg(columns=(column,), unit=unit)
            layout = LogMapping(
                summary=f"draft for {path.name}",
                time=time,
                source=f"drafted from the columns and the motion of {path.name}",
            )
            try:
                table, seconds, _ = read_csv_rows(path, layout, [])
            except DataError:
                continue
            rate = (seconds.size - 1) / max(float(seconds[-1] - seconds[0]), 1e-12)
            if seconds.size > 20 and USUAL_RATE / 31.6 <= rate < USUAL_RATE * 31.6:
                return table, seconds, layout
    raise DataError(
        f"{path}: no column of times with 6 to 6000 rows a second was found among {', '.join(columns) or 'its columns'}; "
        "write the mapping by hand (docs/guides/open_a_log.md)"
    )


def _components(
    quantity: str, count: int, families: dict[tuple[str, ...], dict[str, str]], moving: set[str]
) -> tuple[str, ...]:
    """Return the columns of the family that fits a quantity best, in the order x, y, z (and w); empty if there is none."""
    orders = [("x", "y", "z", "w")[:count], *(tuple(str(start + i) for i in range(count)) for start in (0, 1))]
    if count == 3:
        orders += [("roll", "pitch", "yaw"), ("n", "e", "d")]
    best: tuple[float, tuple[str, ...]] = (np.inf, ())
    for family, members in families.items():
        score = count_foreign_words(quantity, family)
        for order in orders if score is not None else ():
            columns = tuple(members.get(one, "") for one in order)
            if all(columns) and moving & set(columns) and score is not None and score < best[0]:
                best = (score, columns)
    return best[1]


def _with_quantity(draft: MappingDraft, name: str, quantity: ColumnsCfg, reason: str) -> MappingDraft:
    return replace(draft, mapping=replace(draft.mapping, **{name: quantity}), reasons=draft.reasons | {name: reason})


def _with_question(draft: MappingDraft, question: str) -> MappingDraft:
    return replace(draft, open_questions=(*draft.open_questions, question))


def _with_rotors(
    draft: MappingDraft, families: dict[tuple[str, ...], dict[str, str]], moving: set[str], numbers: pd.DataFrame
) -> MappingDraft:
    """Return the draft with rotor speeds and commands; the range of the values tells their kind."""
    for family, members in families.items():
        columns = tuple(members[key] for key in sorted((key for key in members if key.isdecimal()), key=int))
        if count_foreign_words("rotor", family) is None or not 3 <= len(columns) <= 12 or not set(columns) <= moving:
            continue
        values = numbers[list(columns)].to_numpy()
        kind, quantity, reason = _rotor_quantity(family, columns, np.nan_to_num(values))
        if kind and getattr(draft.mapping, kind) is None:
            draft = _with_quantity(draft, kind, quantity, reason)
    return draft


def _rotor_quantity(family: Sequence[str], columns: tuple[str, ...], values: Array) -> tuple[str, ColumnsCfg, str]:
    """Return the kind of a family of columns, one for each rotor, its conversion, and the reason."""
    words, unit, top = set(family[:-1]), family[-1].lower(), float(values.max())
    plain = ColumnsCfg(columns=columns, fill_gap_s=0.05)
    if values.min() < 0.0 or top <= 0.0:
        return "", plain, ""
    if unit == "rpm" or words & {"rpm", "erpm"}:
        return "rotor_speed", replace(plain, unit="rpm"), "rpm by its name"
    power = 0.5 if "thrust" in words or unit == "n" else 1.0
    if top <= 1.2 and unit != "n":
        return (
            "rotor_share",
            replace(plain, power=power),
            "shares of the largest " + ("thrust" if power < 1.0 else "speed"),
        )
    if unit == "n" or "thrust" in words:
        return "rotor_share", replace(plain, power=0.5, gain=top**-0.5), f"thrusts; {top:g} is the largest one logged"
    if (
        np.percentile(values[values > 0.0], 1) >= 900.0
        and top <= 2200.0
        and words & {"u", "pwm", "out", "output", "outputs", "motor", "esc"}
    ):
        return "rotor_share", replace(plain, gain=1e-3, offset=-1.0), "pulses of 1000 to 2000 us"
    if unit == "rad/s" or words & {"om", "omega", "speed"}:
        return "rotor_speed", plain, "rad/s by its name"
    return "", plain, ""


def _with_scalar(
    draft: MappingDraft, quantity: str, families: dict[tuple[str, ...], dict[str, str]], numbers: pd.DataFrame
) -> MappingDraft:
    for family, members in families.items():
        fits = (
            count_foreign_words("battery", family) is not None if quantity == "battery" else family[:-1] == (quantity,)
        )
        if fits and "" in members and numbers[members[""]].notna().mean() > 0.5:
            return _with_quantity(draft, quantity, ColumnsCfg(columns=(members[""],), fill_gap_s=1.0), "by its name")
    return draft


@dataclass(frozen=True)
class FrameChoice:
    """One combination of the order of the quaternion and of frames."""

    order: str
    world: str
    body: str
    attitude_body: str
    direction: str

    def change_frames(self, mapping: LogMapping) -> LogMapping:
        """Return a mapping with these frames."""
        return replace(
            mapping,
            world_frame=self.world,
            body_frame=self.body,
            attitude_body_frame=None if self.attitude_body == self.body else self.attitude_body,
            attitude_direction=self.direction,
        )


ORDERS = {"w last": [0, 1, 2, 3], "w first": [1, 2, 3, 0]}
FRAMES = ("world_frame", "body_frame", "attitude_body_frame", "attitude_direction")


def _with_motion(draft: MappingDraft, numbers: pd.DataFrame, time: Array) -> MappingDraft:
    """Return the draft with the units and frames for which the motion is consistent."""
    values = {
        name: numbers[list(quantity.columns)].interpolate(limit_direction="both").to_numpy()
        for name, quantity in draft.mapping.quantities().items()
        if name in ("position", "lin_vel", "attitude", "ang_vel", "specific_force")
    }
    attitude = draft.mapping.attitude
    if attitude is not None:
        norms = np.linalg.norm(values["attitude"], axis=1)
        if abs(np.median(norms) - 1.0) > 0.05:
            raise DataError(
                f"columns {', '.join(attitude.columns)}: are no unit quaternion, their usual norm is {np.median(norms):.3g}; "
                "rename them, or write the mapping by hand"
            )
        usable = np.abs(norms - 1.0) < 0.5
        values["attitude"] = np.where(usable[:, None], values["attitude"] / np.where(usable, norms, 1.0)[:, None], 0.5)
    width = max(1, round(MEAN_S * (time.size - 1) / float(time[-1] - time[0])))
    draft = _with_units(draft, values, time, width)
    if attitude is None:
        force = values.get("specific_force")
        body = "flu" if force is None or np.median(force[:, 2]) > 0.0 else "frd"
        reason = "assumed" if force is None else "by the sign of the accelerometer"
        return replace(
            draft, mapping=replace(draft.mapping, body_frame=body), reasons=draft.reasons | {"body_frame": reason}
        )
    orders = ("w last",) if attitude.columns[3].rstrip(")]").lower().endswith("w") else tuple(ORDERS)
    choices = product(orders, WORLD_FRAMES, BODY_FRAMES, BODY_FRAMES, DIRECTIONS)
    scored = [
        (_motion_residual(values, choice, time, width), choice) for choice in (FrameChoice(*one) for one in choices)
    ]
    (best, choice), (second, _) = sorted(scored, key=lambda entry: entry[0])[:2]
    columns = tuple(attitude.columns[i] for i in ORDERS[choice.order])
    draft = _with_quantity(draft, "attitude", replace(attitude, columns=columns), choice.order)
    reason = f"residual of the motion {best:.2g}, of the next choice {second:.2g}"
    if second < CLEAR * best:
        reason = "assumed: " + reason
        draft = _with_question(draft, "the motion does not tell the frames for certain; check them")
    return replace(
        draft, mapping=choice.change_frames(draft.mapping), reasons=draft.reasons | dict.fromkeys(FRAMES, reason)
    )


def _turn_rates(attitude: Array, time: Array, width: int) -> Array:
    """Return the mean angular velocity over ``width`` rows, body axes of the quaternion, (T - width, 3)."""
    return turns_over_rows(attitude, width) / (time[width:] - time[:-width])[:, None]


def _means(values: Array, width: int) -> Array:
    """Return the means between rows k and k + width, (T - width, 3)."""
    sums = np.concatenate((np.zeros((1, values.shape[1])), np.cumsum(0.5 * (values[1:] + values[:-1]), axis=0)))
    return (sums[width:] - sums[:-width]) / width


def _slopes(values: Array, time: Array, width: int) -> Array:
    return (values[width:] - values[:-width]) / (time[width:] - time[:-width])[:, None]


def _ratio(measured: Array, expected: Array) -> float:
    """Return the factor of ``measured`` by root mean squares about the means; NaN without motion."""
    spread = float(np.std(expected - expected.mean(axis=0)))
    return float(np.std(measured - measured.mean(axis=0))) / spread if spread > 1e-3 else float("nan")


def _nearest_unit(ratio: float, units: Sequence[str]) -> tuple[str, float]:
    """Return the unit whose factor is nearest to 1 / ratio, and how far it is off by ratio."""
    distances = {unit: abs(np.log(ratio * UNITS[unit])) for unit in units}
    unit = min(distances, key=lambda one: distances[one])
    return unit, float(np.exp(distances[unit]))


def _with_units(draft: MappingDraft, values: dict[str, Array], time: Array, width: int) -> MappingDraft:
    """Return the draft with the units that rates of change tell, and convert ``values`` to SI units in place."""
    comparisons = []
    if {"attitude", "ang_vel"} <= values.keys():
        turn = np.linalg.norm(_turn_rates(values["attitude"], time, width), axis=1, keepdims=True)
        comparisons.append(
            ("ang_vel", np.linalg.norm(_means(values["ang_vel"], width), axis=1, keepdims=True), turn, ("si", "deg/s"))
        )
    if "specific_force" in values:
        size = float(np.median(np.linalg.norm(values["specific_force"], axis=1)))
        unit, off = _nearest_unit(size / UNIT_G, ("si", "g"))
        if off < 1.6:
            draft = _with_unit(draft, values, "specific_force", unit, f"its usual size is {size:.3g}")
        else:
            del values["specific_force"]
            draft = _with_question(
                draft, f"the accelerometer is left out: its size of {size:.3g} is neither m/s² nor g"
            )
            draft = replace(draft, mapping=replace(draft.mapping, specific_force=None))
    if {"position", "lin_vel"} <= values.keys():
        comparisons.append(
            ("position", _slopes(values["position"], time, width), _means(values["lin_vel"], width), ("si", "mm", "cm"))
        )
    for name, measured, expected, units in comparisons:
        ratio = _ratio(measured, expected)
        if not np.isfinite(ratio):
            continue
        unit, off = _nearest_unit(ratio, units)
        draft = _with_unit(
            draft, values, name, unit, f"its rate agrees with the motion within {100.0 * (off - 1.0):.0f} %"
        )
    return draft


def _with_unit(draft: MappingDraft, values: dict[str, Array], name: str, unit: str, reason: str) -> MappingDraft:
    values[name] = values[name] * UNITS[unit]
    return _with_quantity(draft, name, replace(getattr(draft.mapping, name), unit=unit), f"{unit}: {reason}")


def _motion_residual(values: dict[str, Array], choice: FrameChoice, time: Array, width: int) -> float:
    """Return the rms of rates and accelerations that do not agree, relative to those of the motion."""
    layout = choice.change_frames(LogMapping(summary="", time=ColumnsCfg(columns=("t",)), source=""))
    turned = to_package_frames({**values, "attitude": values["attitude"][:, ORDERS[choice.order]]}, layout)
    attitude, parts = turned["attitude"], []
    if "ang_vel" in turned:
        expected = _turn_rates(attitude, time, width)
        parts.append((_means(turned["ang_vel"], width) - expected, expected))
    if "specific_force" in turned:  # thrust is along the body's z axis
        force = turned["specific_force"].mean(axis=0)
        parts.append((force / np.linalg.norm(force) - (0.0, 0.0, 1.0), np.ones(1)))
    acceleration = None
    if "lin_vel" in turned:
        acceleration = _slopes(turned["lin_vel"], time, width)
    elif "position" in turned:
        acceleration = _slopes(_slopes(turned["position"], time, width), time[width // 2 :][: time.size - width], width)
    rotation = Rotation.from_quat(attitude)
    up = np.array([0.0, 0.0, UNIT_G])
    if acceleration is not None:
        felt, middle = acceleration + up, (time.size - len(acceleration)) // 2
        inner = rotation[middle : middle + len(acceleration)]
        if "specific_force" in turned:
            force = uniform_filter1d(rotation.apply(turned["specific_force"]), width, axis=0)
            parts.append((force[middle : middle + len(acceleration)] - felt, acceleration))
        else:
            axis = inner.apply([0.0, 0.0, 1.0])
            share = np.clip((felt * axis).sum(axis=1, keepdims=True), 0.0, None)
            parts.append((felt - share * axis, acceleration))
    elif "specific_force" in turned:
        force = rotation.apply(turned["specific_force"]).mean(axis=0)
        parts.append((force - up, up))
    return float(np.sqrt(sum(np.sum(off**2) / max(np.sum(motion**2), 1e-12) for off, motion in parts)))
