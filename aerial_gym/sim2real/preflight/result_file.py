"""The written result of a preflight check, and its hash."""

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from aerial_gym.errors import ConfigError


def digest(content: Mapping[str, object]) -> str:
    """Return the SHA-256 of a result without its own hash."""
    plain = {key: value for key, value in content.items() if key != "sha256"}
    return hashlib.sha256(json.dumps(plain, sort_keys=True, ensure_ascii=False).encode()).hexdigest()


def read_result(path: Path) -> dict[str, Any]:
    """Return a written result; raise ``ConfigError`` for a file that is none or was changed."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        if content["sha256"] == digest(content) and content["verdict"] in ("ready", "contradicted"):
            return content
    except (KeyError, TypeError, ValueError):
        pass
    raise ConfigError(f"{path}: is no unchanged result of aerial-gym preflight; write it again with --out")
