"""Write blackbox logs: every encoding and predictor of Betaflight, by encoders of our own.

Each frame field is (name, signed, I predictor, I encoding, P predictor, P encoding).
"""

import numpy as np

FIELDS = [
    ("loopIteration", 0, 0, 1, 6, 9),
    ("time", 0, 0, 1, 2, 0),
    *((f"axisI[{i}]", 1, 0, 0, 1, 7) for i in range(3)),
    *((f"axisD[{i}]", 1, 0, 0, 1, 10) for i in range(3)),
    *((f"rcCommand[{i}]", 1, 8 if i == 3 else 0, 0, 1, 8) for i in range(4)),
    ("vbatLatest", 0, 9, 3, 1, 6),
    *((f"baroAlt[{i}]", 1, 4, 0, 1, 6) for i in range(8)),
    *((f"gyroADC[{i}]", 1, 0, 0, 3, 0) for i in range(3)),
    *((f"accSmooth[{i}]", 1, 0, 0, 3, 0) for i in range(3)),
    *((f"motor[{i}]", 0, 5 if i else 11, 0 if i else 1, 3, 0) for i in range(4)),
    *((f"eRPM[{i}]", 0, 0, 1, 1, 0) for i in range(4)),
]
NAMES = [field[0] for field in FIELDS]
HEADER = {
    "Firmware revision": "Betaflight 4.5.1 (0000000) TEST", "I interval": "32", "P interval": "2",
    "minthrottle": "1070", "gyro_scale": "0x3f800000", "motorOutput": "48,2047", "acc_1G": "2048",
    "vbatref": "1600", "motor_poles": "12", "blackbox_high_resolution": "1",
}  # fmt: skip
CONSTANTS = {0: 0, 4: 1070, 8: 1500, 9: 1600, 11: 48}  # Predictions that do not depend on other frames, by predictor


def encode_unsigned(value: int) -> bytes:
    value &= 0xFFFFFFFF
    out = bytearray()
    while value > 127:
        out.append(value & 127 | 128)
        value >>= 7
    return bytes([*out, value])


def encode_signed(value: int) -> bytes:
    return encode_unsigned(2 * value if value >= 0 else -2 * value - 1)


def encode_three(values: list[int], uneven: bool) -> bytes:
    """Encode three numbers in the shortest of the four forms."""
    fits = [all(-(1 << b - 1) <= v < 1 << b - 1 for v, b in zip(values, bits, strict=True)) for bits in widths(uneven)]
    if True not in fits:
        sizes = [next(n for n in range(1, 5) if -(1 << 8 * n - 1) <= v < 1 << 8 * n - 1) for v in values]
        lead = 0xC0 | sum(size - 1 << 2 * i for i, size in enumerate(sizes))
        return bytes([lead]) + b"".join(
            v.to_bytes(n, "little", signed=True) for v, n in zip(values, sizes, strict=True)
        )
    form = fits.index(True)
    total = (8, 16, 24)[form]
    fields = (
        (2, 2, 2) if form == 0 else ((5, 5, 4), (8, 7, 7))[form - 1] if uneven else ((4, 4, 4), (8, 8, 8))[form - 1]
    )
    number = 0
    for value, bits, room in zip(values, widths(uneven)[form], fields, strict=True):
        number = number << room | value & (1 << bits) - 1
    return (form << total - 2 | number).to_bytes(total // 8, "big")


def widths(uneven: bool) -> tuple[tuple[int, ...], ...]:
    return ((2, 2, 2), (5, 5, 4), (8, 7, 7)) if uneven else ((2, 2, 2), (4, 4, 4), (6, 6, 6))


def encode_four(values: list[int]) -> bytes:
    forms = [
        0 if v == 0 else next(k for k in (1, 2, 3) if -(1 << (2 << k) - 1) <= v < 1 << (2 << k) - 1) for v in values
    ]
    nibbles = [
        v >> 4 * i & 15 for v, k in zip(values, forms, strict=True) for i in reversed(range((2 << k) // 4 if k else 0))
    ]
    nibbles += [0] * (len(nibbles) % 2)
    packed = bytes(16 * a + b for a, b in zip(nibbles[::2], nibbles[1::2], strict=True))
    return bytes([sum(k << 2 * i for i, k in enumerate(forms))]) + packed


def encode(codes: list[int], values: list[int]) -> bytes:
    out, i = b"", 0
    while i < len(codes):
        code, size = codes[i], {7: 3, 10: 3, 8: 4}.get(codes[i], 1)
        while code == 6 and size < 8 and i + size < len(codes) and codes[i + size] == 6:
            size += 1
        group = values[i : i + size]
        if code in (0, 1):
            out += (encode_signed, encode_unsigned)[code](group[0])
        elif code == 3:
            out += encode_unsigned(-group[0] & 0x3FFF)
        elif code == 6 and size > 1:
            out += bytes([sum(1 << k for k, v in enumerate(group) if v)]) + b"".join(
                encode_signed(v) for v in group if v
            )
        elif code == 6:
            out += encode_signed(group[0])
        elif code in (7, 10):
            out += encode_three(group, code == 10)
        elif code == 8:
            out += encode_four(group)
        i += size
    return out


def header(entries: dict[str, str] = HEADER, fields: list[tuple] = FIELDS) -> bytes:
    columns = list(zip(*fields, strict=True))
    lines = ["Product:Blackbox flight data recorder by Nicholas Sherlock", "Data version:2"]
    titles = ("I name", "I signed", "I predictor", "I encoding", "P predictor", "P encoding")
    lines += [f"Field {title}:{','.join(map(str, column))}" for title, column in zip(titles, columns, strict=True)]
    lines += ["Field S name:flightModeFlags,stateFlags,failsafePhase,rxSignalReceived,rxFlightChannelsValid"]
    lines += ["Field S signed:0,0,0,0,0", "Field S predictor:0,0,0,0,0", "Field S encoding:1,1,7,7,7"]
    lines += [
        "Field H name:GPS_home[0],GPS_home[1]",
        "Field H signed:1,1",
        "Field H predictor:0,0",
        "Field H encoding:0,0",
    ]
    lines += ["Field G name:time,GPS_coord[0],GPS_coord[1]", "Field G signed:0,1,1", "Field G predictor:10,7,7"]
    lines += ["Field G encoding:1,0,0", *(f"{key}:{value}" for key, value in entries.items())]
    return "".join(f"H {line}\n" for line in lines).encode()


def half(total: int) -> int:
    """Return the half, rounded to zero as C does."""
    return abs(total) // 2 * (1 if total >= 0 else -1)


def frames(rows: np.ndarray) -> list[bytes]:
    """Return the frames of main rows, (T, fields); iterations count in steps of 2, each 16th row is an I frame."""
    out, last, last_but_one = [], [0] * len(FIELDS), [0] * len(FIELDS)
    for number, row in enumerate(rows.tolist()):
        intra = number % 16 == 0
        values = []
        for i, (_, _, *codes) in enumerate(FIELDS):
            code = codes[0 if intra else 2]
            guess = {1: last[i], 2: 2 * last[i] - last_but_one[i], 3: half(last[i] + last_but_one[i])}
            guess |= {5: row[NAMES.index("motor[0]")], 6: last[i] + 2, **CONSTANTS}
            values.append(row[i] - guess[code])
        out.append((b"I" if intra else b"P") + encode([field[3 if intra else 5] for field in FIELDS], values))
        last, last_but_one = row, row if intra else last
    return out


def random_rows(seed: int, count: int, start_us: int = 5_000_000) -> np.ndarray:
    """Return main rows of noise whose steps reach every form of the encodings, (T, fields)."""
    draw = np.random.default_rng(seed)
    scale = 4.0 ** draw.integers(0, 7, (count, len(FIELDS)))
    rows = np.cumsum(np.round(draw.normal(size=scale.shape) * scale), axis=0).astype(np.int64)
    for i, (name, sign, *_) in enumerate(FIELDS):
        rows[:, i] = np.clip(rows[:, i], -30_000 if sign else 48, 30_000)
        if name == "vbatLatest":
            rows[:, i] = 1600 - np.abs(rows[:, i]) % 900
    rows[:, 0], rows[:, 1] = 2 * np.arange(count), start_us + 500 * np.arange(count) + draw.integers(0, 9, count)
    return rows


SLOW_FRAME = b"S" + encode_unsigned(1) + encode_unsigned(3) + encode_three([0, 1, 1], False)
END = b"E\xffEnd of log\x00"


def flight(rows: np.ndarray, entries: dict[str, str] = HEADER) -> bytes:
    return header(entries) + SLOW_FRAME + b"".join(frames(rows)) + END
