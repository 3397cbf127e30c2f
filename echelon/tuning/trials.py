"""Trials: candidates and their perturbed copies, performed as one batch and judged.

All copies of a candidate differ from it by the same amounts as those of any other candidate, so that candidates are
compared and not their luck. Copies differ in the parameters to which the script gives a spread, evenly.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from echelon.agents.gymnasts.gymnast import Gymnast
from echelon.agents.gymnasts.script import Script
from echelon.simulation.performance import Performance
from echelon.tuning.judging import Watched, costs, successes
from echelon.tuning.objective import CONSTANTS, Objective, Stage

Values = Mapping[str, float]

PROOF = 1_000_003
"""Number of the perturbations by which the end is proved: none that a search has seen."""


@dataclass(frozen=True)
class Verdict:
    """What candidates are worth.

    Attributes:
        objective: What `Stage` says, the smaller the better,                  shape [candidates]
        success: Share of its copies that succeeded,                           shape [candidates]
        terms: Mean cost of each term of the stage,                            shape [candidates, terms]
    """

    objective: np.ndarray
    success: np.ndarray
    terms: np.ndarray


class Trials:
    """Performs candidates of one script and judges them; the engine is kept from one batch to the next.

    Args:
        character: Who.
        script: What they do.
        objective: What is wanted of them.
        seed: Of the perturbations.
        threads: At most, 0 for one a core; makes no difference to any number.
    """

    def __init__(
        self, character: Gymnast, script: Script, objective: Objective, *, seed: int = 1, threads: int = 0
    ) -> None:
        self._character, self._script, self._objective = character, script, objective
        self._seed, self._threads = seed, threads
        self._performances: dict[int, Performance] = {}
        self._constants = {
            "mass": character.body.mass,
            "gravity": character.body.gravity,
            "gain": character.gain,
        }

    def judge(
        self, stage: Stage, candidates: Sequence[Values], *, copies: int, number: int, share: float | None = None
    ) -> Verdict:
        """Perform and judge.

        Args:
            stage: Which stage of the objective.
            candidates: Parameters that differ from the script's own, by name.
            copies: Of each.
            number: Of the perturbations: the same give the same, and others others.
            share: Of the script's spreads; None for the stage's, and none for a single copy.
        """
        alone = copies == 1 and share is None
        offsets = self.perturbations(copies, number, 0.0 if alone else stage.share if share is None else share)
        individuals = [self._perturbed(values, offset) for values in candidates for offset in offsets]
        watched = self._perform(stage, individuals)
        shape = (len(candidates), copies)
        terms = costs(stage.term, watched, copies).reshape(len(stage.term), *shape)
        success = successes(self._objective.conditions(stage), watched).reshape(shape)
        each = terms.sum(axis=0) + stage.failures * ~success
        objective = each.mean(axis=1) + stage.worst * each.max(axis=1)
        return Verdict(objective, success.mean(axis=1), terms.mean(axis=2).T)

    def perturbations(self, copies: int, number: int, share: float) -> list[dict[str, float]]:
        """By how much copies differ from their candidate, by parameter.

        Each parameter's deviations fall one into each of as many equal parts of its spread as there are copies (a
        Latin hypercube), so that few copies cover it.
        """
        spreads = {name: p.spread for name, p in self._script.parameters.items() if p.spread > 0.0}
        width = max(len(spreads), 1)
        bits = np.random.Philox(key=self._seed, counter=[0, 0, number, 0]).random_raw(2 * copies * width)
        parts, within = bits.reshape(2, copies, width)
        places = parts.argsort(axis=0, kind="stable").argsort(axis=0, kind="stable")
        uniform = 2.0 * (places + (within >> np.uint64(11)).astype(np.float64) * 2.0**-53) / copies - 1.0
        return [
            {name: share * spread * float(u) for (name, spread), u in zip(spreads.items(), row, strict=False)}
            for row in uniform
        ]

    def _perturbed(self, values: Values, offset: Values) -> dict[str, float]:
        own = self._script.parameters
        return {**values, **{name: values.get(name, own[name].value) + by for name, by in offset.items()}}

    def _perform(self, stage: Stage, individuals: Sequence[Values]) -> Watched:
        tables = [self._script.table(self._character.body, values) for values in individuals]
        performance = self._performances.get(len(individuals))
        if performance is None:
            self._forget()
            performance = Performance(self._character, tables, threads=self._threads)
            self._performances[len(individuals)] = performance
        else:
            performance.restart(tables)
        parameters = {
            name: np.array([values.get(name, parameter.value) for values in individuals])
            for name, parameter in self._script.parameters.items()
        }
        asked = self._objective.names(stage)
        measures = [name for name in asked if name not in CONSTANTS and name not in parameters]
        # The height that somebody stands at is known after the first frame.
        seen = performance.run(stage.seconds, [*dict.fromkeys([*measures, "row", "com_height"])])
        standing = seen["com_height"][0].astype(np.float64)
        return Watched(
            {name: seen[name].astype(np.float64) for name in measures},
            {**self._constants, "standing": standing, **parameters},
            np.rint(seen["row"]).astype(int),
            self._script.row_names,
            performance.frame_rate,
        )

    def _forget(self) -> None:
        """Let go of the batch of another size; few sizes take turns, and a batch's state is large."""
        while len(self._performances) > 3:
            size, performance = next(iter(self._performances.items()))
            performance.close()
            del self._performances[size]

    def close(self) -> None:
        """Let the threads go."""
        for performance in self._performances.values():
            performance.close()
        self._performances.clear()
