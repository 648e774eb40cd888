"""ULog files for tests, written by their specification."""

import struct
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation


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


def write_ulog(path: Path, result: dict[str, dict[str, np.ndarray]]) -> Path:
    """Write a ULog file by its specification (docs.px4.io, ULog file format): header, flags, formats, subscriptions, data."""

    def message(kind: str, payload: bytes) -> bytes:
        return struct.pack("<HB", len(payload), ord(kind)) + payload

    text = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0) + message("B", bytes(40))
    data: list[tuple[int, bytes]] = []
    for number, (name, fields) in enumerate(result.items()):
        keys = [key for key in fields if key != "timestamp"]
        plain = {key: key.replace("[", "_").replace("]", "").replace(".", "_") for key in keys}
        arrays = dict.fromkeys(key.split("[")[0] for key in keys if "[" in key and "." not in key)
        if arrays:
            entries = "".join(f"float[{sum(k.startswith(a + '[') for k in keys)}] {a};" for a in arrays)
        elif name == "esc_status":
            text += message("F", b"esc_report:float esc_rpm;")
            entries = f"esc_report[{len(keys)}] esc;"
        else:
            entries = "".join(f"float {plain[key]};" for key in keys)
        text += message("F", f"{name}:uint64_t timestamp;{entries}".encode())
        data += [
            (int(stamp), message("D", struct.pack("<HQ", number, int(stamp)) + struct.pack(f"<{len(keys)}f", *row)))
            for stamp, row in zip(fields["timestamp"], np.stack([fields[k] for k in keys], axis=1), strict=True)
        ]
    text += b"".join(message("A", struct.pack("<BH", 0, number) + name.encode()) for number, name in enumerate(result))
    path.write_bytes(text + b"".join(part for _, part in sorted(data, key=lambda entry: entry[0])))
    return path
