"""CMA-ES in a box: the evolution strategy that adapts the covariance of what it tries, from the package `cmaes`.

Each parameter goes from 0 at its least to 1 at its most, so that one spread suits all. Candidates are rounded to
digits that make no difference, so that a script's file holds exactly what was performed.
"""

from __future__ import annotations

import importlib
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from echelon.agents.gymnasts.script import Parameter
from echelon.errors import InputError

PACKAGE = "cmaes"
LEAST_POPULATION = 16
"""Candidates a generation, at least: a batch of few takes as long as one of many."""


def cma_package() -> Any:
    """The package that searches.

    Raises:
        InputError: It is not installed.
    """
    try:
        return importlib.import_module(PACKAGE)
    except ImportError:
        raise InputError(
            f"tuning needs the package {PACKAGE}, which is not installed; `pip install 'echelon[tune]'` adds it"
        ) from None


def usual_population(count: int) -> int:
    """Candidates a generation for so many parameters: as many as is usual, in eights, as vectors have lanes."""
    return max(LEAST_POPULATION, 8 * math.ceil((4.0 + 3.0 * math.log(count)) / 8.0))


def rounded(parameter: Parameter, value: float) -> float:
    """A value of a bounded parameter to a hundred-thousandth of its range or finer, within its bounds."""
    digits = 5 - math.floor(math.log10(parameter.most - parameter.least))
    return min(max(round(value, max(digits, 0)), parameter.least), parameter.most)


class BoxSearch:
    """A search between bounds.

    Args:
        parameters: What is searched for, by name, each with bounds.
        start: Where the search begins, by name.
        sigma: Standard deviation at the start as a share of each range.
        population: Candidates a generation.
        seed: Of the candidates.
    """

    def __init__(
        self,
        parameters: Mapping[str, Parameter],
        start: Mapping[str, float],
        *,
        sigma: float,
        population: int,
        seed: int,
    ) -> None:
        self._parameters = parameters
        self._least = np.array([parameter.least for parameter in parameters.values()])
        self._width = np.array([parameter.most - parameter.least for parameter in parameters.values()])
        begin = np.array([start[name] for name in parameters])
        dimensions = len(parameters)
        self._strategy = cma_package().CMA(
            mean=np.clip((begin - self._least) / self._width, 0.0, 1.0),
            sigma=sigma,
            bounds=np.tile([0.0, 1.0], (dimensions, 1)),
            seed=seed,
            population_size=population,
        )
        self._asked: list[np.ndarray] = []

    def ask(self) -> list[dict[str, float]]:
        """The next generation's candidates, by name."""
        self._asked = [self._strategy.ask() for _ in range(self._strategy.population_size)]
        return [self._values(x) for x in self._asked]

    def tell(self, objectives: Sequence[float]) -> None:
        """What they were worth, in their order, the smaller the better."""
        self._strategy.tell(list(zip(self._asked, [float(value) for value in objectives], strict=True)))

    @property
    def mean(self) -> dict[str, float]:
        """The middle of what is searched now, by name."""
        return self._values(np.clip(self._strategy.mean, 0.0, 1.0))

    @property
    def exhausted(self) -> bool:
        """Whether going on would find nothing new: all candidates are the same, or as good as each other."""
        return bool(self._strategy.should_stop())

    def _values(self, x: np.ndarray) -> dict[str, float]:
        numbers = (self._least + x * self._width).tolist()
        return {
            name: rounded(parameter, number)
            for (name, parameter), number in zip(self._parameters.items(), numbers, strict=True)
        }
