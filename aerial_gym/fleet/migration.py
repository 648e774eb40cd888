"""Migration of tables that an older version has written. Each step can be repeated, so a kill between steps does no harm."""

from collections.abc import Callable
from pathlib import Path

from deltalake import DeltaTable, Field
from deltalake.schema import PrimitiveType

Step = Callable[[Path], None]


def _add_firmware(out: Path) -> None:
    """Version 1 did not record the firmware, which is null for those flights."""
    for name in ("flights", "vehicles"):
        table = DeltaTable(out / name)
        if "firmware" not in {field.name for field in table.schema().fields}:
            table.alter.add_columns([Field("firmware", PrimitiveType("string"))])


STEPS: dict[int, Step] = {1: _add_firmware}  # By the version that each step starts from


def migrate(out: Path, version: int) -> None:
    """Bring tables of an older version up to date, step by step."""
    while version in STEPS:
        STEPS[version](out)
        version += 1
