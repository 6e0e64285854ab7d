"""What the engine refuses, and how it says so."""


class EngineError(Exception):
    """Root of everything the engine raises on purpose."""


class TranscriptionError(EngineError, ValueError):
    """The declarations cannot be turned into a nonlinear program: the message names the culprit."""


class SolveError(EngineError, RuntimeError):
    """A solve that the caller asked to be complete did not end in an optimum."""


def raised(error: Exception) -> str:
    """Return the type and the message of what a user's own code raised."""
    return f"{type(error).__name__}: {error}".removesuffix(": ")
