"""What a solved case leaves for its children: where their solves begin.

Plain arrays in NumPy's own format, so that nothing in a store or on the wire is executable.
"""

from io import BytesIO
from zipfile import BadZipFile

import numpy as np

from pyomo_quad.collocation import TranscriptionError, WarmStart

__all__ = ["pack", "unpack"]


def pack(start: WarmStart) -> bytes:
    """Write down where another solve can start.

    Parameters
    ----------
    start : WarmStart
        Of a solve that converged.

    Returns
    -------
    bytes
        For `unpack`.
    """
    target = BytesIO()
    np.savez(target, allow_pickle=False, **start.arrays())
    return target.getvalue()


def unpack(packed: bytes) -> WarmStart | None:
    """Read where a solve can start.

    Parameters
    ----------
    packed : bytes
        Written by `pack`.

    Returns
    -------
    WarmStart or None
        For `Planner.solve`; None when the bytes are damaged.
    """
    try:
        with np.load(BytesIO(packed), allow_pickle=False) as file:
            return WarmStart.from_arrays({name: file[name] for name in file.files})
    except (BadZipFile, EOFError, OSError, TranscriptionError, ValueError):
        return None
