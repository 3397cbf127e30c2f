"""The test problems of groups with significant dynamics, as scenarios: which group, which problem, by which law.

The problems are those of Brogan and Hodgins (1997); the scenarios ship with Echelon (`echelon list`) and are run as
they ship, but for the number of agents, the law, and the seeds: of where everybody starts, how individuals differ, and
where the columns stand.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

from echelon.errors import InputError
from echelon.scenario import Scenario
from echelon.settings import suggestion

PROBLEMS: Mapping[str, str] = {
    "steady": "a group set off at a common velocity holds it",
    "turning": "the velocity that is asked for turns by 90 degrees",
    "gap": "an opening in a wall, for all to pass",
    "columns": "a field of columns to pass through",
}
"""The problems, and a line about each; the last two are those with obstacles."""

PAPER, ORCA = "brogan-hodgins", "orca"


@dataclass(frozen=True)
class Group:
    """Who is tested.

    Attributes:
        character: Name of the character.
        count: How many.
        prefix: Of the names of the scenarios.
        law: Our own law for this character, beside the paper's and the planner's.
    """

    character: str
    count: int
    prefix: str = ""
    law: str = "approach"

    @property
    def name(self) -> str:
        """As `--only` names it: "hopper-105"."""
        return f"{self.character}-{self.count}"


GROUPS: tuple[Group, ...] = (
    Group("point-mass", 105),
    Group("hopper", 16),
    Group("hopper", 50),
    Group("hopper", 105),
    Group("cyclist", 18, "riders-", "foresight"),
)


@dataclass(frozen=True)
class GroupTest:
    """A group, a problem, and a law: one row of the table."""

    group: Group
    problem: str
    law: str

    @property
    def name(self) -> str:
        """ "hopper-105/turning/approach"."""
        return f"{self.group.name}/{self.problem}/{self.law}"

    def scenario(self, seed: int) -> Scenario:
        """The scenario with a seed; where a planner says the velocities, its law is "alone"."""
        base = Scenario.load(f"{self.group.prefix}{self.problem}")
        field = base.world.column_field
        return replace(
            base,
            seed=seed,
            population_seed=seed,
            crowd=replace(base.crowd, character=self.group.character, count=self.group.count),
            herd=replace(base.herd, law="alone" if self.law == ORCA else self.law),
            world=replace(base.world, column_field=None if field is None else replace(field, seed=seed)),
        )


def chosen_tests(only: Iterable[str] = (), groups: Iterable[Group] = GROUPS) -> list[GroupTest]:
    """All rows of the table, or those that every one of some words is part of.

    Args:
        only: Words like "hopper", "hopper-105", "turning", "orca"; of several that name the same kind of thing one must
            fit.
        groups: To choose from.

    Raises:
        InputError: A word names nothing.
    """
    rows = [(group, problem) for group in groups for problem in PROBLEMS]
    every = [GroupTest(group, problem, law) for group, problem in rows for law in (PAPER, group.law, ORCA)]
    kinds: list[set[str]] = [set(), set(), set()]
    names = [
        {name for test in every for name in (test.group.name, test.group.character)},
        set(PROBLEMS),
        {test.law for test in every},
    ]
    for word in only:
        fitting = [kind for kind, known in zip(kinds, names, strict=True) if word in known]
        if not fitting:
            raise InputError(f"--only {word}: no such group, problem or law{suggestion(word, set().union(*names))}")
        fitting[0].add(word)
    return [
        test
        for test in every
        if (not kinds[0] or kinds[0] & {test.group.name, test.group.character})
        and (not kinds[1] or test.problem in kinds[1])
        and (not kinds[2] or test.law in kinds[2])
    ]
