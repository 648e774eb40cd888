"""ULog files for tests, written by their specification."""

import struct
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from aerial_gym.sim2real import FlightLog, LogMapping
from aerial_gym.sim2real.logs.raw_log import RawLog, Topic
from aerial_gym.sim2real.logs.readers.flight_log import open_raw_log
from aerial_gym.sim2real.logs.readers.stamps import stamp_seconds


def topics(table: pd.DataFrame) -> dict[str, dict[str, np.ndarray]]:
    """A flight as PX4 would log it: NED, FRD, w first, microseconds, every topic at its own rate."""
    stamp = np.round((table["t"].to_numpy() + 5.0) * 1e6).astype(np.uint64)
    flip = np.array([1.0, -1.0, -1.0])
    enu_to_ned = Rotation.from_matrix([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    attitude = (
        enu_to_ned * Rotation.from_quat(table[["q_x", "q_y", "q_z", "q_w"]]) * Rotation.from_matrix(np.diag(flip))
    )
    ned = {key: table[[f"{key}_x", f"{key}_y", f"{key}_z"]].to_numpy()[:, [1, 0, 2]] * (1.0, 1.0, -1.0) for key in "pv"}
    rpm = table.filter(like="rotor_").to_numpy() * 30.0 / np.pi
    quaternion = attitude.as_quat()[:, [3, 0, 1, 2]]
    omega = table[["omega_x", "omega_y", "omega_z"]].to_numpy() * flip
    force = table[["acc_x", "acc_y", "acc_z"]].to_numpy() * flip

    def topic(every: int, **fields: np.ndarray) -> dict[str, np.ndarray]:
        return {"timestamp": stamp[::every], **{key: all[::every].astype(np.float32) for key, all in fields.items()}}

    return {
        "vehicle_attitude": topic(2, **{f"q[{i}]": quaternion[:, i] for i in range(4)}),
        "vehicle_local_position": topic(
            4,
            **{k: ned["p"][:, i] for i, k in enumerate("xyz")},
            **{f"v{k}": ned["v"][:, i] for i, k in enumerate("xyz")},
        ),
        "vehicle_angular_velocity": topic(1, **{f"xyz[{i}]": omega[:, i] for i in range(3)}),
        "sensor_combined": topic(1, **{f"accelerometer_m_s2[{i}]": force[:, i] for i in range(3)}),
        "esc_status": topic(2, **{f"esc[{i}].esc_rpm": rpm[:, i] for i in range(4)}),
        "battery_status": topic(50, voltage_v=np.full(len(table), 15.0)),
    }


def read_topics(
    results: dict[str, dict[str, np.ndarray]], mapping: LogMapping | None = None, **parameters
) -> FlightLog:
    """Return the flight of ULog topics, in this order of samples, without a ULog file."""
    parts = []
    for title, fields in results.items():
        name, _, instance = title.rstrip("]").partition("[")
        columns = {key: values for key, values in fields.items() if key != "timestamp"}
        time = stamp_seconds(fields["timestamp"], 1e-6)
        parts.append(Topic(name=name, instance=int(instance or 0), time=time, columns=columns))
    raw = RawLog(path="a.ulg", format="ulog", topics=tuple(parts), parameters=parameters)
    return open_raw_log(raw, mapping).flight(1)


def write_ulog(
    path: Path, result: dict[str, dict[str, np.ndarray]], parameters: dict[str, float] | None = None
) -> Path:
    """Write a ULog file by its specification (docs.px4.io, ULog file format): header, flags, formats, subscriptions, data.

    A topic ``name[1]`` is instance 1 of ``name``.
    """

    def message(kind: str, payload: bytes) -> bytes:
        return struct.pack("<HB", len(payload), ord(kind)) + payload

    text = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0) + message("B", bytes(40))
    for key, value in (parameters or {}).items():
        text += message("P", bytes([len(f"float {key}")]) + f"float {key}".encode() + struct.pack("<f", value))
    data: list[tuple[int, bytes]] = []
    subscriptions = b""
    for number, (title, fields) in enumerate(result.items()):
        name, _, instance = title.rstrip("]").partition("[")
        stamps = [key for key in fields if key.startswith("timestamp")]
        keys = [key for key in fields if key not in stamps]
        plain = {key: key.replace("[", "_").replace("]", "").replace(".", "_") for key in keys}
        arrays = dict.fromkeys(key.split("[")[0] for key in keys if "[" in key and "." not in key)
        if name == "esc_status":
            inner = list(dict.fromkeys(key.split(".")[1] for key in keys))
            text += message("F", f"esc_report:{''.join(f'float {one};' for one in inner)}".encode())
            entries = f"esc_report[{len(keys) // len(inner)}] esc;"
        else:
            entries = "".join(f"float[{sum(k.startswith(a + '[') for k in keys)}] {a};" for a in arrays)
            entries += "".join(f"float {plain[key]};" for key in keys if "[" not in key)
            keys = [key for key in keys if "[" in key] + [key for key in keys if "[" not in key]
        entries = "".join(f"uint64_t {key};" for key in stamps) + entries
        text += message("F", f"{name}:{entries}".encode())
        rows = zip(*(fields[key] for key in stamps), np.stack([fields[k] for k in keys], axis=1), strict=True)
        for *at, row in rows:
            payload = struct.pack(f"<H{len(at)}Q", number, *map(int, at)) + struct.pack(f"<{len(keys)}f", *row)
            data.append((int(at[0]), message("D", payload)))
        subscriptions += message("A", struct.pack("<BH", int(instance or 0), number) + name.encode())
    path.write_bytes(text + subscriptions + b"".join(part for _, part in sorted(data, key=lambda entry: entry[0])))
    return path
