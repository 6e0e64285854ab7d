"""One line that shows how a solve goes: iteration, objective, infeasibility, elapsed time."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from time import perf_counter
from typing import TYPE_CHECKING

from rich.live import Live
from rich.text import Text

from pyomo_quad.cli.consoles import error_console

if TYPE_CHECKING:
    from pyomo_quad.collocation import Iteration

__all__ = ["live_line"]

_REFRESHES_PER_SECOND = 8


@contextmanager
def live_line(*, is_quiet: bool) -> Iterator[Callable[["Iteration"], None] | None]:
    """Show a line on the terminal that follows the solver.

    Parameters
    ----------
    is_quiet : bool
        Show nothing.

    Yields
    ------
    callable or None
        To call at each iteration; None when quiet or when standard error is no terminal.
    """
    console = error_console()
    if is_quiet or not console.is_terminal:
        yield None
        return
    started = perf_counter()
    with Live(console=console, refresh_per_second=_REFRESHES_PER_SECOND, transient=True) as live:

        def follow(now: "Iteration") -> None:
            live.update(
                Text(
                    f"iteration {now.iteration:4d}   energy {now.objective:10.3f} J   "
                    f"infeasibility {now.infeasibility:8.1e}   {now.mesh_points} points   "
                    f"{perf_counter() - started:5.1f} s"
                )
            )

        yield follow
