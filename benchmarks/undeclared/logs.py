"""Write flight logs, the declared robot and the truth."""

from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import yaml
from scipy.spatial.transform import Rotation

from benchmarks.undeclared.sensors import LATE
from benchmarks.undeclared.simulate import CONTROL_RATE, PlantRecord
from benchmarks.undeclared.vehicle import ROTOR_RADIUS, SOURCE, Array, PlantVehicle

COLUMNS = (
    *("t", "p_x", "p_y", "p_z", "q_x", "q_y", "q_z", "q_w", "v_x", "v_y", "v_z"),
    *("omega_x", "omega_y", "omega_z", "acc_x", "acc_y", "acc_z"),
    *(f"{name}_{number}" for name in ("rotor", "cmd") for number in (1, 2, 3, 4)),
    "vbat",
)
OTHER_COLUMNS, CEILING_COLUMN = ("other_p_x", "other_p_y", "other_p_z"), "ceiling_z"
"""Further columns [m], world, of logs with another vehicle or a ceiling."""

_DIGITS = ["%.6f"] * 4 + ["%.8f"] * 4 + ["%.6f"] * 9 + ["%.4f"] * 8


def continuous_quaternions(matrix: Array) -> Array:
    """Return xyzw of each matrix (T, 3, 3), without jumps of sign from row to row; the first has w >= 0."""
    quat = Rotation.from_matrix(matrix).as_quat()
    flips = np.cumprod(np.where((quat[1:] * quat[:-1]).sum(axis=1) < 0.0, -1.0, 1.0))
    sign = np.concatenate(([1.0], flips)) * (1.0 if quat[0, 3] >= 0.0 else -1.0)
    return quat * sign[:, None]


def delay_sensors(record: PlantRecord, delay: Array) -> PlantRecord:
    """Return a record in which each of ``LATE`` comes so much later [s] than it was, between samples in a straight line."""
    measured = dict(record.measured)
    for name, seconds in zip(LATE, delay.tolist(), strict=True):
        measured[name] = delay_samples(measured[name], seconds * CONTROL_RATE)
        if name == "rotation":
            measured["position"] = delay_samples(measured["position"], seconds * CONTROL_RATE)
    return replace(record, measured=measured)


def delay_samples(values: Array, samples: float) -> Array:
    """Return values (T, ...) as they were so many samples before; those at the ends last."""
    place = np.clip(np.arange(len(values)) - samples, 0.0, len(values) - 1.0)
    before = place.astype(int)
    share = (place - before).reshape(-1, *(1,) * (values.ndim - 1))
    return (1.0 - share) * values[before] + share * values[np.minimum(before + 1, len(values) - 1)]


def write_log(path: Path, record: PlantRecord, flight: int, rows: slice) -> None:
    """Write the given samples of one flight; t starts at 0."""
    columns, digits, values = log_table(record, flight, rows)
    np.savetxt(path, values, fmt=digits, delimiter=",", header=",".join(columns), comments="")


def log_table(record: PlantRecord, flight: int, rows: slice) -> tuple[list[str], list[str], Array]:
    """Return column names, number formats and values (T, columns) of the given samples of one flight."""
    seen = {name: values[rows, flight] for name, values in record.measured.items()}
    time = np.arange(len(seen["rate"]))[:, None] * ((rows.step or 1) / CONTROL_RATE)
    parts = [time, seen["position"], continuous_quaternions(seen["rotation"])]
    parts += [seen[name] for name in ("velocity", "rate", "acc", "rotor")]
    parts += [record.command[rows, flight], record.voltage[rows, flight, None]]
    columns, digits, surroundings = list(COLUMNS), [*_DIGITS, "%.2f"], record.surroundings
    if surroundings.other is not None:
        parts, columns = [*parts, surroundings.other[rows, flight]], [*columns, *OTHER_COLUMNS]
        digits += ["%.4f"] * 3
    if surroundings.ceiling is not None:
        parts, columns = [*parts, np.full_like(time, surroundings.ceiling)], [*columns, CEILING_COLUMN]
        digits += ["%.4f"]
    return columns, digits, np.hstack(parts)


def robot_document(vehicle: PlantVehicle, *, radius: bool = False) -> dict[str, object]:
    """Return the declared robot as plain data; the centre of mass is declared at the body origin."""
    hubs = zip(vehicle.rotor_position.tolist(), vehicle.rotor_axis.tolist(), vehicle.rotor_spin, strict=True)
    drag = {key: float(d) for key, d in zip(("dx", "dy", "dz"), vehicle.linear_drag, strict=True)}
    return {
        "summary": "Quadrotor of the undeclared-effect benchmark, as its maker declares it",
        "body": {"mass": vehicle.mass, "inertia": vehicle.inertia.tolist(), "source": SOURCE},
        "rotor": {
            "thrust_map": [0.0, 0.0, float(vehicle.thrust_coeff.mean())],
            "torque_ratio": vehicle.torque_ratio,
            "time_constant_up": vehicle.tau_up,
            "time_constant_down": vehicle.tau_down,
            "thrust_range": list(vehicle.thrust_range),
            **({"radius": ROTOR_RADIUS} if radius else {}),
            "source": SOURCE,
        },
        "mounts": {"layout": [{"position": r, "axis": a, "spin": int(spin)} for r, a, spin in hubs], "source": SOURCE},
        "collision": {"spheres": [{"center": [0.0, 0.0, 0.0], "radius": 0.2}], "source": SOURCE},
        "effects": {"rotor_drag": drag} if np.any(vehicle.linear_drag) else {},
    }


def write_robot(path: Path, vehicle: PlantVehicle, *, radius: bool = False) -> None:
    """Write the declared robot as YAML, with the radius of its propellers if asked."""
    document = robot_document(vehicle, radius=radius)
    path.write_text(yaml.safe_dump(document, sort_keys=False, default_flow_style=None, width=120), encoding="utf-8")


def vehicle_document(vehicle: PlantVehicle) -> dict[str, object]:
    """Return every number of a vehicle as plain data; of ``extra`` those that are not neutral."""
    plain = {
        key: v.tolist() if isinstance(v, np.ndarray) else v for key, v in asdict(vehicle).items() if key != "extra"
    }
    return {**plain, **vehicle.extra.document()}
