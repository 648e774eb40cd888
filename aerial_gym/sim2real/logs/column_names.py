"""Names of columns in foreign CSV files: the quantity, the component and the unit that they state."""

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

COMPONENTS = {letter: i for i, letter in enumerate("xyzw")} | {"roll": 0, "pitch": 1, "yaw": 2, "n": 0, "e": 1, "d": 2}
WORDS = {
    "time": "t time timestamp stamp sec secs seconds elapsed clock us ms ns s current micros millis",
    "position": "p pos position loc location translation odom odometry mocap vicon local",
    "lin_vel": "v vel velocity lin linear speed odom odometry mocap vicon local",
    "attitude": "q quat quaternion orientation att attitude odom odometry mocap vicon",
    "ang_vel": "w om omega gyr gyro gyroscope rate rates ang angular vel velocity body imu b",
    "specific_force": "a f acc accel acceleration accelerometer specific force imu body b linear",
    "rotor": "u m om omega rotor motor motors esc rpm erpm speed cmd command pwm throttle thrust actuator output outputs out "
    "normalized",
    "battery": "vbat bat battery voltage volt volts v",
}
NO_MEASUREMENT = """
    ref reference desired des sp setpoint target error err user defined std cov var bias integral proportional old aux dot
"""
"""Words of columns that are no measurements."""

KEY_WORDS = {
    "ang_vel": "w om omega gyr gyro gyroscope rate rates ang angular",
    "specific_force": "a f acc accel acceleration accelerometer force",
    "lin_vel": "v vel velocity speed",
    "attitude": "q quat quaternion orientation",
    "rotor": "u m om omega rotor motor motors esc rpm erpm pwm throttle thrust actuator",
    "battery": "vbat bat battery voltage",
}
"""Words of which a name has at least one."""

FRAME_WORDS = "b body w world i"  # Axes after the component, as in ``ax_b``
UNIT_WORDS = "rpm deg rad s ms mps m mm cm g us dps"  # Units after the component, as in ``motor1_rpm``


@dataclass(frozen=True, kw_only=True)
class ColumnName:
    """Parts of a column's name."""

    column: str
    words: tuple[str, ...]  # In lower case, without the component
    component: str  # x, y, z, w, a number or nothing
    unit: str  # Text in brackets

    @property
    def family(self) -> tuple[str, ...]:
        """The words and the unit, which columns of one quantity share."""
        return (*self.words, self.unit)


def parse_column_name(column: str) -> ColumnName:
    """Return the parts of a name such as ``Velocity x [m/s]``, ``ang_vel_x``, ``gyroADC[0]`` or ``vx``."""
    text, unit = re.sub(r"\[(\d+)\]", r" \1 ", column), ""
    if bracket := re.search(r"[\[(]([^\])]*)[\])]\s*$", text):
        text, unit = text[: bracket.start()], bracket[1].strip()
    text = re.sub(r"([a-z])([A-Z])", r"\1 \2", text)
    words = [word.lower() for word in re.findall(r"[A-Za-z]+|\d+", text)]
    component, rest = "", list[str]()
    while len(words) > 1 and (
        words[-1] in UNIT_WORDS.split() or (words[-1] in FRAME_WORDS.split() and words[-2][-1] in COMPONENTS)
    ):
        rest.insert(0, words.pop())
    if words and (words[-1] in COMPONENTS or words[-1].isdecimal()):
        component = words.pop()
    elif words and len(words[-1]) > 1 and words[-1][-1] in "xyzw" and _is_known_word(words[-1][:-1]):
        words[-1], component = words[-1][:-1], words[-1][-1]
    if not words and component in {"t", "w"}:
        words, component = [component], ""
    return ColumnName(column=column, words=(*words, *rest), component=component, unit=unit)


def _is_known_word(word: str) -> bool:
    return any(word in words.split() for words in WORDS.values())


def column_families(names: Iterable[str]) -> dict[tuple[str, ...], dict[str, str]]:
    """Return the columns by component of each family of names, in the order of the file."""
    result: dict[tuple[str, ...], dict[str, str]] = {}
    for part in map(parse_column_name, names):
        if not set(NO_MEASUREMENT.split()) & set(part.words):
            result.setdefault(part.family, {}).setdefault(part.component, part.column)
    return result


def count_foreign_words(quantity: str, family: Sequence[str]) -> int | None:
    """Return the number of words in a family that are foreign to a quantity; None if the family is of another quantity."""
    words = set(family[:-1])
    foreign = words - {*WORDS[quantity].split(), *UNIT_WORDS.split()}
    keys = set(KEY_WORDS.get(quantity, "").split())
    if (keys and not keys & words) or (quantity in ("position", "time", "battery") and foreign):
        return None
    if quantity == "specific_force" and {"w", "world", "i"} & words:
        return None  # an acceleration in world axes lacks gravity
    turns = {"ang", "angular", "omega", "gyro", "rate", "rates"} & words
    accelerates = {"acc", "accel", "acceleration", "force"} & words
    if (quantity in ("lin_vel", "specific_force") and turns) or (quantity in ("ang_vel", "lin_vel") and accelerates):
        return None
    return len(foreign)
