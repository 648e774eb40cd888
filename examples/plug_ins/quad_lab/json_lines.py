"""A log reader: one JSON object in each line, of which the first names the format."""

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from aerial_gym.errors import DataError
from aerial_gym.sim2real.logs.raw_log import LogChannel, RawLog, Topic
from aerial_gym.sim2real.logs.readers.log_readers import LogReader

MARK = '{"format": "quad_lab"'
FIELDS = {"attitude": "q", "ang_vel": "gyro", "specific_force": "acc", "rotor_speed": "rotors", "position": "p"}
"""Field of a line by quantity. All are in SI units, world ENU, body FLU, quaternions xyzw."""


class JsonLinesReader(LogReader):
    """Reader of logs with one JSON object in each line."""

    name = "json_lines"
    summary = "JSON lines of quad_lab"

    def recognises(self, head: bytes) -> bool:
        """Return whether the file begins with the mark."""
        return head.startswith(MARK.encode())

    def read(self, path: Path) -> RawLog:
        """Return one topic with all fields; a field of several numbers has a column for each."""
        _, *lines = path.read_text(encoding="utf-8").splitlines()
        rows = [json.loads(line) for line in lines]
        if not rows:
            raise DataError(f"{path}: holds no sample, only the first line")
        columns = {}
        for field in rows[0].keys() - {"t"}:
            for number, column in enumerate(np.array([row[field] for row in rows], dtype=float).T):
                columns[f"{field}.{number}"] = column
        time = np.array([row["t"] for row in rows], dtype=float)
        return RawLog(path=str(path), format=self.name, topics=(Topic(name="samples", time=time, columns=columns),))

    def channels(self, log: RawLog) -> Sequence[LogChannel]:
        """Return the quantities of the vehicle."""
        (topic,) = log.topics
        fields = {quantity: sorted(c for c in topic.columns if c.startswith(f"{f}.")) for quantity, f in FIELDS.items()}
        return [topic.channel(quantity, topic.numbers(*names)) for quantity, names in fields.items() if names]
