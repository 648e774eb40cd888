"""Folders of the reports of vehicles."""

from pathlib import Path
from urllib.parse import quote


def report_folder(out: Path, vehicle: str) -> Path:
    """Return the folder of a vehicle's report below ``reports``: its name, quoted as in an address."""
    name = quote(vehicle, safe=" ")
    return out / "reports" / (name if name.strip(". ") else f"%{name}")
