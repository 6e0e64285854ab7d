"""Random draws for all random axes of a study together, reproducible from a seed."""

from enum import StrEnum

import numpy as np

from pyomo_quad.scenario.fields import Part, WholeNumber, quantity

__all__ = ["Sampling", "SamplingMethod"]

_MOST_SAMPLES = 100_000


class SamplingMethod(StrEnum):
    """How the unit cube is filled."""

    RANDOM = "random"
    LATIN_HYPERCUBE = "latin_hypercube"


class Sampling(Part):
    """How many samples are drawn, and how."""

    count: WholeNumber = quantity("1", "number of samples", ge=1, le=_MOST_SAMPLES)
    seed: WholeNumber = quantity("1", "seed of the generator", ge=0)
    method: SamplingMethod = quantity(
        "", "random or latin_hypercube", SamplingMethod.LATIN_HYPERCUBE
    )

    def draw(self, axis_count: int) -> np.ndarray:
        """Draw points of the open unit cube.

        Parameters
        ----------
        axis_count : int
            Number of random axes.

        Returns
        -------
        ndarray, shape (count, axis_count)
            Strictly between 0 and 1.  A larger `count` keeps the first points of the method
            ``random``, so that a study can be extended; a Latin hypercube is drawn anew.
        """
        generator = np.random.default_rng(self.seed)
        if self.method is SamplingMethod.RANDOM:
            draws = 1.0 - generator.random((self.count, axis_count))
        else:
            from scipy.stats import qmc  # noqa: PLC0415  takes half a second

            draws = qmc.LatinHypercube(axis_count, seed=generator).random(self.count)
        # At 0 and 1 a normal distribution has no finite value.
        return np.clip(draws, np.nextafter(0.0, 1.0), np.nextafter(1.0, 0.0))
