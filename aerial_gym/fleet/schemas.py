"""Columns of the fleet's tables. The only column that may differ between two runs of the same logs is ``written_at``."""

import pyarrow as pa

SCHEMA_VERSION = 2
"""Raised with each change of a column; ``migration.py`` has one step for each version."""

TEXT, NUMBER, COUNT, NUMBERS = pa.string(), pa.float64(), pa.int64(), pa.list_(pa.float64())

KEY = ("log_hash", "robot_hash", "model_version")  # Key of a flight in every table of flights
WRITTEN = {"written_at": pa.timestamp("us", tz="UTC")}
_KEY_COLUMNS = dict.fromkeys(KEY, TEXT)
_VEHICLE_KEY = dict.fromkeys(("vehicle", "robot_hash", "model_version"), TEXT)

SCHEMAS = {
    name: pa.schema(columns | WRITTEN)
    for name, columns in {
        "flights": _KEY_COLUMNS
        | dict.fromkeys(("path", "vehicle", "firmware"), TEXT)
        | {
            "start_time": NUMBER,  # Unix time [s]; NaN if the log does not state it
            "order": NUMBER,  # The start time, else the rank of the log by its path
            "duration_s": NUMBER,
            "status": TEXT,  # ``ok`` or ``refused``
            "reason": TEXT,  # Of a refusal
            "checks": TEXT,  # JSON
            "events": TEXT,  # JSON
            "rows": COUNT,
            "square": NUMBER,
            "columns": TEXT,  # Digest of the columns, in columns.json
            "moments": pa.binary(),
            "airframe": TEXT,
            "size": COUNT,  # Of the file [bytes]
            "modified": TEXT,  # State of the file, as its store reports it
        },
        "evidence": _KEY_COLUMNS
        | {"vehicle": TEXT, "effect": TEXT, "rotor": COUNT, "start": COUNT}
        | {"params": NUMBERS, "cov": NUMBERS, "score": NUMBER},
        "vehicles": _VEHICLE_KEY
        | {"effect": TEXT, "rotor": COUNT, "parameter": TEXT, "value": NUMBER, "std": NUMBER}
        | {"flights": COUNT, "firmware": TEXT, "last_time": NUMBER},
        "verdicts": _VEHICLE_KEY
        | {
            "verdict": TEXT,  # ``no_change``, ``changed``, ``ambiguous``, ``shared``, ``campaign``, or why there is none
            "causes": TEXT,  # JSON, ranked
            "log_e": NUMBER,
            "p_value": NUMBER,
            "rejected": pa.bool_(),  # By Benjamini-Hochberg over the fleet
            "onset_flight": COUNT,  # Numbers of flights of this vehicle, from 1
            "onset_low": COUNT,
            "onset_high": COUNT,
            "onset_time": NUMBER,
            "kind": TEXT,  # ``step`` or ``drift``
            "text": TEXT,
            "crosses_limit_at": NUMBER,
        },
        "alerts": {"id": TEXT, "vehicle": TEXT, "verdict": TEXT, "text": TEXT, "first_seen": TEXT},
    }.items()
}
