"""Lock of a folder of tables: one program writes at a time. The system releases it when that program ends, however it ends."""

import fcntl
import json
import os
import socket
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from datetime import UTC, datetime
from pathlib import Path

from aerial_gym.errors import ConfigError
from aerial_gym.fleet.tables import table_errors


@contextmanager
def writer_lock(out: Path) -> Iterator[None]:
    """Hold the lock of a folder; raise ``ConfigError`` that names the program which holds it.

    Failures of the disk and of the tables become ``StorageError``.
    """
    with table_errors(out), ExitStack() as files:
        out.mkdir(parents=True, exist_ok=True)
        file = files.enter_context((out / "writer.lock").open("a+", encoding="utf-8"))
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise ConfigError(f"{out}: {_holder(file.name)} writes these tables. Wait for it, or stop it") from None
        file.truncate(0)
        since = datetime.now(UTC).isoformat("T", "seconds")
        file.write(json.dumps({"pid": os.getpid(), "host": socket.gethostname(), "since": since}))
        file.flush()
        yield


def _holder(file: str) -> str:
    try:
        holder = json.loads(Path(file).read_text(encoding="utf-8"))
        return f"process {holder['pid']} on {holder['host']} (since {holder['since']})"
    except (OSError, ValueError, KeyError):
        return "another process"
