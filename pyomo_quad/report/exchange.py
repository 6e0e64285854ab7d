"""Exchange two folders in one step, where the operating system can."""

import ctypes
import os
import sys
from pathlib import Path

__all__ = ["exchange_folders"]

_AT_FDCWD = -100
_RENAME_EXCHANGE = 2


def exchange_folders(one: Path, other: Path) -> bool:
    """Let two folders of one file system swap their names atomically.

    Parameters
    ----------
    one, other : Path
        Existing folders.

    Returns
    -------
    bool
        False, with nothing changed, where the system or the file system cannot do it.

    Notes
    -----
    Linux offers it as renameat2 with RENAME_EXCHANGE, which Python does not wrap.
    """
    if not sys.platform.startswith("linux"):
        return False
    try:
        renameat2 = ctypes.CDLL(None, use_errno=True).renameat2
    except AttributeError:
        return False
    result = renameat2(
        _AT_FDCWD, os.fsencode(one), _AT_FDCWD, os.fsencode(other), ctypes.c_uint(_RENAME_EXCHANGE)
    )
    return int(result) == 0
