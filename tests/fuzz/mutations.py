"""Damage a file the way a stranger, an editor or a bad disk would."""

import random

TOKENS = (
    b"nan", b"inf", b"-inf", b"1e999", b"-0.0", b"9" * 400, b"0x1F", b"true", b"1979-05-27",
    b"[", b"]", b"[[", b"]]", b"{", b"}", b"=", b".", b",", b'"', b"'", b'"""', b"#", b"\n",
    b"\r", b"\x00", b"\xff\xfe", b"\xe2\x80\xa8", b"\\u0000", b"\\", b"../", b"=cmd|' /C calc'!A1",
    b"vehicle", b"mission", b"wind", b"use", b"series", b"forecast", b"model", b"limits",
)  # fmt: skip
MOST_DAMAGES = 6


def damaged(content: bytes, chance: random.Random) -> bytes:
    """Return the content with one to six damages."""
    for _ in range(chance.randint(1, MOST_DAMAGES)):
        content = chance.choice(DAMAGES)(content, chance)
    return content


def _place(content: bytes, chance: random.Random) -> tuple[int, int]:
    start = chance.randint(0, len(content))
    return start, min(len(content), start + chance.randint(0, 12))


def _flip(content, chance):
    start, _ = _place(content, chance)
    return content[:start] + bytes([chance.randint(0, 255)]) + content[start + 1 :]


def _cut(content, chance):
    start, end = _place(content, chance)
    return content[:start] + content[end:]


def _repeat(content, chance):
    start, end = _place(content, chance)
    return content[:end] + content[start:end] * chance.choice((1, 2, 100)) + content[end:]


def _insert(content, chance):
    start, _ = _place(content, chance)
    return content[:start] + chance.choice(TOKENS) + content[start:]


def _replace_value(content, chance):
    lines = content.split(b"\n")
    index = chance.randrange(len(lines))
    key, equals, _ = lines[index].partition(b"=")
    lines[index] = key + equals + chance.choice(TOKENS)
    return b"\n".join(lines)


def _swap_lines(content, chance):
    lines = content.split(b"\n")
    one, other = chance.randrange(len(lines)), chance.randrange(len(lines))
    lines[one], lines[other] = lines[other], lines[one]
    return b"\n".join(lines)


DAMAGES = (_flip, _cut, _repeat, _insert, _replace_value, _swap_lines)
