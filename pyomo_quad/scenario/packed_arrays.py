"""Arrays of a scenario written as text: doubles, least byte first, by zlib and base64."""

from base64 import b64decode, b64encode
from typing import TYPE_CHECKING
from zlib import compress, decompress

if TYPE_CHECKING:
    from pyomo_quad.arrays import FloatArray


def packed(values: "FloatArray") -> str:
    """Encode an array, the last axis fastest."""
    return b64encode(compress(values.astype("<f8").tobytes(), level=1)).decode("ascii")


def unpacked(text: str) -> "FloatArray":
    """Decode an array, in one axis."""
    import numpy as np  # noqa: PLC0415  reading a scenario does without it

    return np.frombuffer(decompress(b64decode(text)), dtype="<f8")
