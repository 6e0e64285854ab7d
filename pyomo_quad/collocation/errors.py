"""Exceptions of the collocation engine, and the text of errors from user code."""


class EngineError(Exception):
    """Base class of all exceptions that the collocation engine raises deliberately."""


class TranscriptionError(EngineError, ValueError):
    """Error in the declarations of a model or in an argument; the message names the component."""


class SolveError(EngineError, RuntimeError):
    """Error raised if a numerical solve fails and its caller cannot continue without the result."""


def raised(error: Exception) -> str:
    """Return type and message of an exception raised by the user's code, as "Type: message"."""
    return f"{type(error).__name__}: {error}".removesuffix(": ")
