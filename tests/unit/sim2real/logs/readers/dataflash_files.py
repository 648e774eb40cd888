"""Write ArduPilot DataFlash logs, with units, by the description of their format."""

import struct
from collections.abc import Callable
from typing import Any

import numpy as np

CODES = {
    "n": "4s", "N": "16s", "Z": "64s", "c": "h", "C": "H", "e": "i", "E": "I", "L": "i", "M": "B", "a": "32h",
    "g": "e",
}  # fmt: skip
TYPES: dict[str, tuple[int, str, str, str]] = {
    "FMT": (128, "BBnNZ", "Type,Length,Name,Format,Columns", "-----"),
    "UNIT": (130, "QbZ", "TimeUS,Id,Label", "s--"),
    "MULT": (131, "Qbd", "TimeUS,Id,Mult", "s--"),
    "FMTU": (132, "QBNN", "TimeUS,FmtType,UnitIds,MultIds", "s---"),
    "PARM": (133, "QNf", "TimeUS,Name,Value", "s--"),
    "MSG": (134, "QZ", "TimeUS,Message", "s-"),
    "IMU": (135, "QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ", "s#EEEooo"),
    "ATT": (136, "QccC", "TimeUS,Roll,Pitch,Yaw", "sddh"),
    "XKF1": (137, "QBffffff", "TimeUS,C,VN,VE,VD,PN,PE,PD", "s#nnnmmm"),
    "RCOU": (138, "QHHHHHHHH", "TimeUS,C1,C2,C3,C4,C5,C6,C7,C8", "sYYYYYYYY"),
    "ESC": (139, "QBf", "TimeUS,Instance,RPM", "s#q"),
    "BAT": (140, "QBf", "TimeUS,Inst,Volt", "s#v"),
    "EV": (141, "QB", "TimeUS,Id", "s-"),
    "RAW": (142, "Qa", "TimeUS,x", "s-"),
}
UNITS = {
    "-": "",
    "s": "s",
    "#": "instance",
    "E": "rad/s",
    "o": "m/s/s",
    "d": "deg",
    "h": "degheading",
    "Y": "us",
    "m": "m",
}


def message(name: str, *values: Any) -> bytes:
    number, codes, _, _ = TYPES[name]
    body = "<" + "".join(CODES.get(code, code) for code in codes)
    flat = [x for value in values for x in (value if isinstance(value, list) else [value])]
    return b"\xa3\x95" + bytes([number]) + struct.pack(body, *(x.encode() if isinstance(x, str) else x for x in flat))


def line(name: str, *values: Any) -> bytes:
    """Return a message as text, with numbers in their units."""
    codes = TYPES[name][1]
    texts = (str(0.01 * value if code in "cC" else value) for code, value in zip(codes, values, strict=True))
    return (", ".join((name, *texts)) + "\n").encode()


def definitions(message: Callable[..., bytes] = message) -> bytes:
    out = b""
    for name, (number, codes, fields, _) in TYPES.items():
        length = 3 + struct.calcsize("<" + "".join(CODES.get(code, code) for code in codes))
        out += message("FMT", number, length, name, codes, fields)
    out += b"".join(message("UNIT", 0, ord(key), label) for key, label in UNITS.items())
    out += message("MULT", 0, ord("F"), 1e-6) + message("MULT", 0, ord("-"), 0.0)
    for number, codes, _, units in TYPES.values():
        out += message("FMTU", 0, number, units, "F" + "-" * (len(codes) - 1))
    return out


def log(
    seed: int = 0, count: int = 400, message: Callable[..., bytes] = message
) -> tuple[bytes, dict[str, np.ndarray]]:
    """Return a flight with two IMUs at 100 Hz and all else at 50 Hz, and the numbers in it."""
    draw = np.random.default_rng(seed)
    numbers = {
        "imu": draw.normal(size=(count, 2, 6)).astype(np.float32),
        "attitude": draw.integers(-3000, 3000, (count, 3)) * (1, 1, 0) + (0, 0, 9000),
        "ekf": draw.normal(size=(count, 6)).astype(np.float32),
        "outputs": draw.integers(1000, 2000, (count, 8)),
        "rpm": draw.uniform(1000.0, 9000.0, (count, 4)).astype(np.float32),
    }
    data = definitions(message) + message("MSG", 1000, "ArduCopter V4.5.1 (00000000)")
    for name, value in {"FRAME_CLASS": 1.0, "MOT_PWM_MIN": 1100.0, "MOT_PWM_MAX": 1900.0}.items():
        data += message("PARM", 1000, name, value)
    for n in range(4):
        data += message("PARM", 1000, f"SERVO{8 - n}_FUNCTION", 33.0 + n)  # motors 1 to 4 on outputs 8 to 5
    for i in range(count):
        time = 2_000_000 + 10_000 * i
        data += message("EV", time, 10) if i == 20 else b""
        data += b"".join(message("IMU", time, k, *numbers["imu"][i, k].tolist()) for k in range(2))
        if i % 2 == 0:
            data += message("ATT", time, *numbers["attitude"][i].tolist())
            data += message("XKF1", time, 0, *numbers["ekf"][i].tolist())
            data += message("RCOU", time, *numbers["outputs"][i].tolist())
            data += b"".join(message("ESC", time, 4 + k, float(numbers["rpm"][i, k])) for k in range(4))
            data += message("BAT", time, 0, 15.5)
    return data, numbers
