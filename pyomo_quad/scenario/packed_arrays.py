"""Arrays stored as text in a scenario: little-endian doubles, zlib-compressed, in base64."""

from base64 import b64decode, b64encode
from typing import TYPE_CHECKING
from zlib import compress, decompress

if TYPE_CHECKING:
    from pyomo_quad.arrays import FloatArray


def packed(values: "FloatArray") -> str:
    """Encode an array of numbers as text, in C order (the last axis varies fastest)."""
    return b64encode(compress(values.astype("<f8").tobytes(), level=1)).decode("ascii")


def unpacked(text: str) -> "FloatArray":
    """Decode a text that `packed` made, to a read-only one-dimensional array in C order."""
    import numpy as np  # noqa: PLC0415  reading a scenario does without it

    return np.frombuffer(decompress(b64decode(text)), dtype="<f8")
