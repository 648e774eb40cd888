"""Identity of a log: vehicle, firmware and start time, from its metadata and the time of its satellite receiver."""

from collections.abc import Iterator
from datetime import UTC, datetime

import numpy as np

from aerial_gym.sim2real.logs.raw_log import RawLog
from aerial_gym.sim2real.logs.recording import LogIdentity

AIRFRAMES = ("sys_uuid", "ver_uid", "board", "Craft name")
"""Metadata that identify a vehicle: PX4, older PX4, ArduPilot, Betaflight; the first one that a log states counts."""

FIRMWARES = ("firmware", "Firmware revision", "ver_sw_release", "ver_sw")  # ArduPilot, Betaflight, PX4
GPS_EPOCH, LEAP_S = 315964800.0, 18.0  # Unix time of the GPS epoch [s], and GPS time less UTC since 2017 [s]
FIRST_PLAUSIBLE = 946684800.0  # Unix time of the year 2000 [s]: a clock that was never set states an earlier one


def log_identity(raw: RawLog, time: float) -> LogIdentity:
    """Return the identity of a log; ``time``: first row of the flight on the log's clock [s]."""
    stated = {name: raw.metadata.get(name, "").strip() for name in (*AIRFRAMES, *FIRMWARES)}
    if stated["ver_sw_release"].isdecimal():
        number = int(stated["ver_sw_release"])
        stated["ver_sw_release"] = f"{raw.metadata.get('sys_name', '')} " + ".".join(
            str(number >> shift & 255) for shift in (24, 16, 8)
        )
    airframe, firmware = (
        next((stated[name] for name in names if stated[name]), "") for names in (AIRFRAMES, FIRMWARES)
    )
    starts = (start for start in _possible_starts(raw, time) if start > FIRST_PLAUSIBLE)
    return LogIdentity(airframe=airframe, firmware=firmware.strip(), start_time=next(starts, None))


def _possible_starts(raw: RawLog, time: float) -> Iterator[float]:
    """Yield the Unix time of the first row [s] by each clock that the log states."""
    for topic in raw.topics:
        columns = topic.columns
        if "time_utc_usec" in columns:
            utc = 1e-6 * np.asarray(columns["time_utc_usec"], dtype=np.float64)
        elif {"GWk", "GMS"} <= columns.keys():
            utc = GPS_EPOCH - LEAP_S + 604800.0 * columns["GWk"] + 1e-3 * np.asarray(columns["GMS"], dtype=np.float64)
        else:
            continue
        known = utc > FIRST_PLAUSIBLE
        if known.any():
            yield float(np.median(utc[known] - topic.time[known])) + time
    try:
        stated = datetime.fromisoformat(raw.metadata.get("Log start datetime", ""))
        yield (stated if stated.tzinfo else stated.replace(tzinfo=UTC)).timestamp()
    except ValueError:
        pass
