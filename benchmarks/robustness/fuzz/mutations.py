"""Ways to spoil an input: bytes, lines, numbers, and the tree of a YAML file. Pure functions of a generator."""

import random
import re
from collections.abc import Callable
from typing import Any

import yaml

NUMBERS = (
    *["0", "-1", "nan", "inf", "-.inf", ".nan", "1e300", "1e-300", "1e10", "10000000000"],
    *("9" * 400, "-0.0", "1e-5", "2"),
)
WORDS = (
    *("", "''", "null", "true", "[]", "{}", "2024-13-45", "12:30:99", "~", "*a", "&a [*a]", "../x", "/etc/passwd"),
    *("[1, 2", '"', "a" * 3000, "[" * 5000, "!!python/object:os.system", "\x00", "é", "package://../../x", "0x1g"),
    *("- - -", ": :", "<<"),
)
VALUES: tuple[Any, ...] = (
    *(None, True, -1, 0, 1, 10**10, 10**400, -1e308, 1e308, 1e-308, float("nan"), float("inf"), "", "x", [], {}, [1]),
    *([[1], 2], [0.0, 0.0, 0.0], [1e200] * 3, {"x": 1}, "../../x", "2024-13-45", [[1.0, 2.0], [3.0]], 0.5, 3),
)


def flip_bytes(data: bytes, draw: random.Random) -> bytes:
    """Change a few bytes."""
    spoilt = bytearray(data or b" ")
    for _ in range(draw.choice((1, 1, 2, 8))):
        spoilt[draw.randrange(len(spoilt))] = draw.randrange(256)
    return bytes(spoilt)


def change_bytes(data: bytes, draw: random.Random) -> bytes:
    """Put an extreme in place of a binary number of 1, 2, 4 or 8 bytes, such as a length."""
    size, place = draw.choice((1, 2, 4, 4, 8)), draw.randrange(len(data))
    number = draw.choice((b"\xff" * size, bytes(size), b"\xff" * (size - 1) + b"\x7f", b"\x01" + bytes(size - 1)))
    return data[:place] + number + data[place + size :]


def change_length(data: bytes, draw: random.Random) -> bytes:
    """Change a number that may be a length or a count: the data behind it hold that many bytes, and it is small."""
    for _ in range(50):
        size, place = draw.choice((1, 2, 4, 8)), draw.randrange(len(data))
        number = int.from_bytes(data[place : place + size], "little")
        if 0 < number < 5000 and place + size + number <= len(data):
            change = draw.choice((number - 1, number + 1, 0, 2 * number, number + draw.randrange(256), 256**size - 1))
            return data[:place] + (change % 256**size).to_bytes(size, "little") + data[place + size :]
    return change_bytes(data, draw)


def exchange_pieces(data: bytes, draw: random.Random) -> bytes:
    """Exchange two pieces, such as definitions that others need."""
    a, b, c, d = sorted(draw.randrange(len(data) + 1) for _ in range(4))
    return data[:a] + data[c:d] + data[b:c] + data[a:b] + data[d:]


def cut_piece(data: bytes, draw: random.Random) -> bytes:
    """Leave out a piece, often the end."""
    start = draw.randrange(len(data) + 1)
    stop = len(data) if draw.random() < 0.5 else min(len(data), start + draw.randrange(200))
    return data[:start] + data[stop:]


def repeat_piece(data: bytes, draw: random.Random) -> bytes:
    """Repeat a piece."""
    start = draw.randrange(len(data) + 1)
    piece = data[start : start + draw.randrange(1, 200)]
    return data[:start] + piece * draw.randrange(2, 5) + data[start:]


def swap_lines(data: bytes, draw: random.Random) -> bytes:
    """Drop, double or exchange lines."""
    lines = data.split(b"\n")
    i, j = draw.randrange(len(lines)), draw.randrange(len(lines))
    lines[i], lines[j] = draw.choice(((lines[j], lines[i]), (lines[j], lines[j]), (b"", lines[j])))
    return b"\n".join(lines)


def change_number(data: bytes, draw: random.Random) -> bytes:
    """Put an extreme in place of a number."""
    result = list(re.finditer(rb"-?\d+\.?\d*(e-?\d+)?", data))
    if not result:
        return flip_bytes(data, draw)
    match = draw.choice(result)
    return data[: match.start()] + draw.choice(NUMBERS).encode() + data[match.end() :]


def change_word(data: bytes, draw: random.Random) -> bytes:
    """Put something odd in place of a word or a field."""
    result = list(re.finditer(rb"[\w./]+", data))
    if not result:
        return flip_bytes(data, draw)
    match = draw.choice(result)
    return data[: match.start()] + draw.choice(WORDS).encode() + data[match.end() :]


def change_tree(data: bytes, draw: random.Random) -> bytes:
    """Change, drop or add something in a YAML tree."""
    try:
        tree = yaml.safe_load(data)
    except Exception:  # spoilt before
        return swap_lines(data, draw)
    holders = [node for node in _tree_nodes(tree) if isinstance(node, (dict, list)) and node]
    if not holders:
        return flip_bytes(data, draw)
    node, value = draw.choice(holders), draw.choice(VALUES)
    key = draw.choice(list(node)) if isinstance(node, dict) else draw.randrange(len(node))
    action = draw.random()
    if action < 0.7:
        node[key] = value
    elif action < 0.85:
        del node[key]
    elif isinstance(node, dict):
        node[draw.choice(("x", 1, "mass", "", None))] = value
    else:
        node.append(value)
    try:
        return yaml.safe_dump(tree, sort_keys=False, allow_unicode=True).encode()
    except (ValueError, RecursionError):  # an integer with too many digits to be written
        return change_word(data, draw)


def _tree_nodes(tree: Any) -> list[Any]:
    """Return a tree and all below it; one that holds itself is not followed for ever."""
    result, waiting = [], [tree]
    while waiting and len(result) < 10_000:
        node = waiting.pop()
        result.append(node)
        waiting += node.values() if isinstance(node, dict) else node if isinstance(node, list) else ()
    return result


Mutation = Callable[[bytes, random.Random], bytes]
PLAIN: tuple[Mutation, ...] = (flip_bytes, cut_piece, repeat_piece)
TEXT: tuple[Mutation, ...] = (*PLAIN, swap_lines, change_number, change_number, change_number, change_word, change_word)
BINARY: tuple[Mutation, ...] = (
    *(*PLAIN, change_bytes, change_bytes, change_number, repeat_piece),
    *(change_length, change_length, change_length, exchange_pieces, swap_lines),
)
TREE: tuple[Mutation, ...] = (*TEXT, *(change_tree,) * 10)


def mutate(data: bytes, ways: tuple[Mutation, ...], draw: random.Random) -> bytes:
    """Return the input spoilt in one to three ways."""
    for _ in range(draw.choice((1, 1, 1, 2, 3))):
        data = draw.choice(ways)(data, draw) if data else data
    return data
