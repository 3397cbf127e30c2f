"""How a search goes on: stage by stage, anew where it came to nothing, until the end is proved or the time is up.

A flat objective finds a plain jump, and no somersault; so a search has *stages* (see `objective`), each of which
begins where the one before ended. A stage ends when its best candidate is good enough. If copies are perturbed, the
best of a generation is partly a lucky one, so it must first prove itself on a larger ensemble, with the middle of the
search as its rival, which is often the better.

A stage that does not get there within its generations has led nowhere; so has a search whose result is not robust in
the final *proof*, an ensemble with perturbations that no stage has seen. Everything then begins anew with other
candidates, for another *round*; the best of all rounds is kept.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from echelon.agents.gymnasts.script import Script
from echelon.tuning.folder import Batch, TuningFolder
from echelon.tuning.objective import Objective, Stage
from echelon.tuning.search import BoxSearch, usual_population
from echelon.tuning.trials import PROOF, Trials, Values

ROUNDS = 100
CHECK_EVERY = 4
"""Generations between two attempts to end a stage."""
CHECK_COPIES = 4
"""How many times more copies there are when a stage's end is checked."""
CHECKS = 500_000
"""Numbers of the perturbations of such checks, from here on: none that the search sees."""
SAME_COPIES = 10
"""Generations for which copies differ from their candidates by the same amounts: fewer unsettle the search, and more
let it fit the few copies that it sees."""
_ROUND_SEEDS, _STAGE_SEEDS = 7919, 104_729  # primes: no two stages of any rounds search with the same seed


@dataclass(frozen=True)
class Generation:
    """One generation of a search.

    Attributes:
        round, stage: Of which round and stage, from 0.
        number: Within the stage, from 0.
        best, median: Objective of the best and of the middle candidate.
        success: Share of the best candidate's copies that succeeded.
        values: The best candidate.
        middle: Where the search stands after it.
    """

    round: int
    stage: int
    number: int
    best: float
    median: float
    success: float
    values: Values
    middle: Values


@dataclass(frozen=True)
class Found:
    """Parameters and what they are worth.

    Attributes:
        values: All that were tuned.
        objective: Mean over an ensemble.
        success: Share of it that succeeded.
        terms: Mean cost of each term.
        stages: How many stages it has come through.
    """

    values: Values
    objective: float
    success: float
    terms: tuple[float, ...] = ()
    stages: int = 0

    @property
    def rank(self) -> tuple[float, ...]:
        """The greater the better."""
        return (self.stages, self.success, -self.objective)


Watch = Callable[["Search"], None]


class OutOfTime(Exception):
    """There is no time for another batch."""


@dataclass
class Search:
    """A whole search, under way.

    Attributes:
        script, objective, trials, folder: What is tuned, to what end, how it is tried, where it is kept.
        start: Where it begins, by name; parameters without one begin with the script's value.
        seed: Of the candidates.
        population, copies: Instead of those of the stages; 0 for theirs.
        deadline: When to stop, by `time.monotonic`.
        watch: Called after each batch.
        history: Generations so far.
        proofs: What each round came to.
        performed: Gymnasts that performed in this process.
    """

    script: Script
    objective: Objective
    trials: Trials
    folder: TuningFolder
    start: Mapping[str, float]
    seed: int = 1
    population: int = 0
    copies: int = 0
    deadline: float = math.inf
    watch: Watch | None = None
    history: list[Generation] = field(default_factory=list)
    proofs: list[Found] = field(default_factory=list)
    performed: int = 0
    round: int = 0
    stage: int = 0
    _batches: int = 0

    def carry_out(self) -> Found:
        """Until it is proved, or the time is up; returns the best there is."""
        best: Found | None = None
        for self.round in range(ROUNDS):
            values: Values = dict(self.start)
            passed, current, in_time = 0, None, True
            for number, stage in enumerate(self.objective.stage):
                self.stage = number
                try:
                    current, enough = self._carry_out_stage(stage, values)
                except OutOfTime:
                    in_time = False
                    current = self._best_of_stage(values) or current
                    break
                values = current.values
                # Whether the last stage has led anywhere is for the proof to say.
                if not enough and number < len(self.objective.stage) - 1:
                    break
                passed += 1
            if current is None:
                break
            proof, in_time = self._proved(current, passed, in_time)
            best = proof if best is None or proof.rank > best.rank else best
            if not in_time or self.satisfies(proof):
                break
        # Time for not a single generation: where the search began.
        return best or self._proved(Found(dict(self.start), math.inf, 0.0), 0, False)[0]

    def satisfies(self, found: Found) -> bool:
        """Whether it came through all stages and is as robust as it should be."""
        return found.stages == len(self.objective.stage) and found.success >= self.objective.success_rate

    # ---- a stage -----------------------------------------------------------------------------------------------------
    def copies_of(self, stage: Stage) -> int:
        """How many copies of a candidate are performed: a stage of one keeps to that."""
        return self.copies if self.copies and stage.copies > 1 else stage.copies

    def _carry_out_stage(self, stage: Stage, before: Values) -> tuple[Found, bool]:
        """The stage's best, with what was found before, and whether it is good enough."""
        parameters = {name: self.script.parameters[name] for name in stage.tuned(self.script)}
        usual = {name: parameter.value for name, parameter in parameters.items()}
        copies = self.copies_of(stage)
        search = BoxSearch(
            parameters,
            {**usual, **before},
            sigma=stage.sigma,
            population=self.population or stage.population or usual_population(len(parameters)),
            seed=(self.seed + _ROUND_SEEDS * self.round + _STAGE_SEEDS * self.stage) % 2**32,
        )
        best: Found | None = None
        checked, first = -CHECK_EVERY, self._batches
        for number in range(stage.generations):
            candidates: list[Values] = [{**before, **values} for values in search.ask()]
            batch = self._judge(stage, candidates, copies, first + number // SAME_COPIES)
            search.tell(batch.objective)
            found = Found(
                candidates[batch.best], batch.objective[batch.best], batch.success[batch.best], batch.best_terms
            )
            middle: Values = {**before, **search.mean}
            self._remember(number, found, sorted(batch.objective)[len(candidates) // 2], middle)
            if copies == 1:
                best = found if best is None or found.objective < best.objective else best
                if self._enough(stage, best):
                    return best, True
            elif self._enough(stage, found) and number >= checked + CHECK_EVERY:
                checked = number
                best = self._check(stage, [found.values, middle])
                if self._enough(stage, best):
                    return best, True
            if search.exhausted:
                break
        if best is None or copies > 1:
            recent = self._generations_here()[-2 * CHECK_EVERY :]
            best = self._check(stage, [*(one.values for one in recent), recent[-1].middle])
        aimed = stage.enough is not None or stage.success_rate is not None
        return best, not aimed or self._meets(stage, best)

    def _enough(self, stage: Stage, found: Found) -> bool:
        """Whether a stage may end early."""
        return (stage.enough is not None or stage.success_rate is not None) and self._meets(stage, found)

    @staticmethod
    def _meets(stage: Stage, found: Found) -> bool:
        small = stage.enough is None or found.objective <= stage.enough
        return small and (stage.success_rate is None or found.success >= stage.success_rate)

    def _check(self, stage: Stage, candidates: list[Values]) -> Found:
        """The best of some by an ensemble that is larger than a generation's."""
        candidates = list({tuple(one.items()): one for one in candidates}.values())
        batch = self._judge(stage, candidates, CHECK_COPIES * self.copies_of(stage), CHECKS + self._batches)
        at = batch.best
        return Found(candidates[at], batch.objective[at], batch.success[at], batch.best_terms)

    def _proved(self, found: Found, passed: int, in_time: bool) -> tuple[Found, bool]:
        """What is found on the last stage's terms and the final ensemble, and whether there was time to keep it."""
        stage, count = self.objective.stage[-1], self.objective.proof
        candidates: list[Values] = [found.values]
        try:
            batch = self._judge(stage, candidates, count, PROOF) if in_time else None
        except OutOfTime:
            batch = None
        # Once the time is up nothing more is kept: one who goes on later has not been there.
        kept = batch is not None
        batch = batch or self._perform(stage, candidates, count, PROOF)
        proof = Found(found.values, batch.objective[0], batch.success[0], batch.best_terms, passed)
        self.proofs.append(proof)
        return proof, kept

    # ---- batches -----------------------------------------------------------------------------------------------------
    def _judge(self, stage: Stage, candidates: list[Values], copies: int, number: int) -> Batch:
        """What candidates are worth, as it is kept or as it comes out now; see `Trials.judge` for the number."""
        batch = self.folder.known(self._batches, candidates)
        if batch is None:
            if time.monotonic() >= self.deadline:
                raise OutOfTime
            batch = self._perform(stage, candidates, copies, number)
            self.folder.keep(candidates, batch)
        self._batches += 1
        return batch

    def _perform(self, stage: Stage, candidates: list[Values], copies: int, number: int) -> Batch:
        share = 1.0 if number == PROOF else None
        verdict = self.trials.judge(stage, candidates, copies=copies, number=number, share=share)
        self.performed += copies * len(candidates)
        best = int(verdict.objective.argmin())
        return Batch(
            tuple(verdict.objective.tolist()), tuple(verdict.success.tolist()), tuple(verdict.terms[best].tolist())
        )

    def _remember(self, number: int, found: Found, median: float, middle: Values) -> None:
        self.history.append(
            Generation(self.round, self.stage, number, found.objective, median, found.success, found.values, middle)
        )
        if self.watch is not None:
            self.watch(self)

    def _generations_here(self) -> list[Generation]:
        return [one for one in self.history if (one.round, one.stage) == (self.round, self.stage)]

    def _best_of_stage(self, before: Values) -> Found | None:
        """Of a stage that was cut short; None if it had not begun."""
        here = self._generations_here()
        if not here:
            return None
        best = min(here, key=lambda one: one.best)
        return Found({**before, **best.values}, best.best, best.success)
