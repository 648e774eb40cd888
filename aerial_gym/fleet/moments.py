"""Storage of a flight's information matrix and gradient. Letters: K columns."""

import hashlib
import json
from collections.abc import Iterable
from dataclasses import asdict
from math import inf
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa

if TYPE_CHECKING:
    from aerial_gym.sim2real.arrays import Array

_CODEC = pa.Codec("zstd", compression_level=3)


def pack_moments(product: "Array", gradient: "Array") -> bytes | None:
    """Return the upper triangle of a matrix (K, K), then a vector (K,), as compressed float32; None if one is not finite."""
    with np.errstate(over="ignore"):
        values = np.concatenate((product[np.triu_indices(gradient.size)], gradient)).astype("<f4")
    return _CODEC.compress(values.tobytes(), asbytes=True) if np.isfinite(values).all() else None


def unpack_moments(data: bytes, product: "Array", gradient: "Array") -> bool:
    """Write the moments of ``pack_moments`` into a matrix (K, K) and a vector (K,); return whether they are intact."""
    count, upper = gradient.size * (gradient.size + 1) // 2, np.triu_indices(gradient.size)
    try:
        raw = _CODEC.decompress(data, decompressed_size=4 * (count + gradient.size), asbytes=True)
    except OSError:  # of a damaged stream
        return False
    values = np.frombuffer(raw, "<f4")
    product[upper] = product.T[upper] = values[:count]
    gradient[:] = values[count:]
    return bool(np.isfinite(values).all())


def columns_text(columns: Iterable[Any]) -> str:
    """Return columns of the evidence as JSON; infinite bounds become null."""
    rows = [asdict(column) for column in columns]
    return json.dumps([{name: None if value in (inf, -inf) else value for name, value in row.items()} for row in rows])


def columns_digest(text: str) -> str:
    """Return the digest of ``columns_text``."""
    return hashlib.sha256(text.encode()).hexdigest()[:16]
