"""Exceptions of the engine, and the text of errors from user code."""


class EngineError(Exception):
    """Base class of all exceptions that the engine raises deliberately."""


class TranscriptionError(EngineError, ValueError):
    """The declarations cannot be transcribed; the message names the component."""


class SolveError(EngineError, RuntimeError):
    """A solve that the caller required to succeed did not converge."""


def raised(error: Exception) -> str:
    """Return type and message of an error raised by the user's code."""
    return f"{type(error).__name__}: {error}".removesuffix(": ")
