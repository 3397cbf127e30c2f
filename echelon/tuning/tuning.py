"""`tune`: a script's parameters fitted to a body and an objective, from the files to the file."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from os import PathLike
from pathlib import Path
from typing import Any, get_args

from echelon.agents.characters import character_named
from echelon.agents.fingerprint import fingerprint, misfit
from echelon.agents.gymnasts.body import Sex
from echelon.agents.gymnasts.gymnast import Gymnast, gymnast
from echelon.agents.gymnasts.script import Script, parse_script, script_text
from echelon.errors import InputError
from echelon.export.picture_files import replacing
from echelon.tuning.folder import PICTURE, TuningFolder
from echelon.tuning.objective import Objective, load_objective, objective_names
from echelon.tuning.plots import plot_search
from echelon.tuning.search import cma_package
from echelon.tuning.stages import Found, Generation, Search
from echelon.tuning.trials import Trials
from echelon.tuning.tuned_script import with_values

MINUTES = 10.0


@dataclass(frozen=True)
class TuningProgress:
    """How far a tuning is.

    Attributes:
        round: Which, from 1.
        stage, stages: Which, from 1, and of how many.
        stage_name: Of the stage.
        generation, generations: Which of the stage, from 1, and of at most how many.
        best: Objective of the generation's best candidate.
        success: Share of its copies that succeeded.
        seconds_left: At most, in this round or by the time limit [s].
    """

    round: int
    stage: int
    stages: int
    stage_name: str
    generation: int
    generations: int
    best: float
    success: float
    seconds_left: float


@dataclass(frozen=True)
class TuningResult:
    """What a tuning came to.

    Attributes:
        path: The tuned script's file.
        folder: Where the search is kept, with its picture.
        script: The tuned script.
        values: What was tuned, by name.
        objective: On the final ensemble, the last stage's.
        success: Share of the final ensemble that succeeded.
        wanted: What share should.
        proof: How many performed in it.
        done: Whether it came through all stages and is as robust as wanted.
        terms: Mean cost of each of the last stage's terms in the final ensemble, by the term's name.
        history: Generations, in order.
        rounds: How often it began.
        performed: Gymnasts that performed, in this process.
        seconds: That it took, in this process.
        note: What the user should know about the script that it began with, empty if nothing.
    """

    path: Path
    folder: Path
    script: Script
    values: Mapping[str, float]
    objective: float
    success: float
    wanted: float
    proof: int
    done: bool
    terms: Mapping[str, float]
    history: tuple[Generation, ...]
    rounds: int
    performed: int
    seconds: float
    note: str

    def plain(self) -> dict[str, Any]:
        """As JSON has it."""
        return {
            "script": str(self.path),
            "folder": str(self.folder),
            "done": self.done,
            "success": self.success,
            "wanted": self.wanted,
            "proof": self.proof,
            "objective": self.objective,
            "terms": dict(self.terms),
            "values": dict(self.values),
            "tuned": dict(self.script.tuned),
            "rounds": self.rounds,
            "generations": len(self.history),
            "performed": self.performed,
            "seconds": round(self.seconds, 3),
            "note": self.note,
        }


def tune(
    script: str | PathLike[str],
    *,
    objective: str | PathLike[str] | Objective | None = None,
    body: str = "",
    height: float | None = None,
    mass: float | None = None,
    from_nothing: bool = False,
    out: str | PathLike[str] | None = None,
    minutes: float = MINUTES,
    population: int = 0,
    copies: int = 0,
    seed: int = 1,
    resume: bool = False,
    threads: int = 0,
    progress: Callable[[TuningProgress], None] | None = None,
) -> TuningResult:
    """Fit a script's parameters to a body and an objective.

    The tuned script is written to `out`, beside it a folder (`out` with the suffix .tuning) with the state of the
    search, kept after every generation, and a picture of how it went. The result depends on the seed alone, unless
    the time is up first; and then `resume` goes on as if it had not been.

    Args:
        script: Name of a maneuver that ships, or path of a .toml file.
        objective: Name of one that ships, path of a .toml file, or an `Objective`; by default the one that ships for
            this script.
        body: "male" or "female"; empty for the script's.
        height, mass: Of the body [m], [kg]; None for the thesis's.
        from_nothing: Begin in the middle of what `least` and `most` allow, whatever the script's values are.
        out: File of the tuned script; by default the script's name with "-tuned.toml", here.
        minutes: For which to search at most.
        population: Candidates a generation, 0 for what the stages say.
        copies: Perturbed copies of each candidate, 0 for what the stages say.
        seed: Of candidates and perturbations.
        resume: Go on with the search that the folder holds.
        threads: At most, 0 for one a core; makes no difference to the result.
        progress: Called after each generation.

    Raises:
        InputError: One line that says what is wrong with a file, an option, or the folder; or that the package that
            searches is not installed.
    """
    begun = time.monotonic()
    cma_package()
    _check_numbers(minutes, population, copies, seed)
    text, source = script_text(str(script))
    loaded = parse_script(text, source)
    sought = _objective(objective, loaded)
    character, whom = _character(body or loaded.body, height, mass)
    sought.check(loaded, character)
    target = Path(f"{loaded.name}-tuned.toml" if out is None else out)
    _check_target(target)
    tuned = {name: loaded.parameters[name] for stage in sought.stage for name in stage.tuned(loaded)}
    here = fingerprint(character)
    start = {
        name: 0.5 * (parameter.least + parameter.most) if from_nothing else parameter.value
        for name, parameter in tuned.items()
    }
    settings = {
        "script": _digest(text),
        "objective": _digest(repr(replace(sought, source=""))),
        "body": whom,
        **here.plain(),
        "from_nothing": from_nothing,
        "population": population,
        "copies": copies,
        "seed": seed,
    }
    trials = Trials(character, loaded, sought, seed=seed, threads=threads)
    with TuningFolder.open(target.with_suffix(".tuning"), settings, resume) as folder:
        try:
            search = Search(
                script=loaded,
                objective=sought,
                trials=trials,
                folder=folder,
                start=start,
                seed=seed,
                population=population,
                copies=copies,
                deadline=begun + 60.0 * minutes,
                watch=None if progress is None else _watch(progress, begun + 60.0 * minutes),
            )
            found = search.carry_out()
        finally:
            trials.close()
        written = _written(text, source, found, search, tuned.keys(), whom, here.plain(), sought, seed)
        with replacing(target) as beside:
            beside.write_text(written, encoding="utf-8")
        if search.history:
            title = f"{loaded.title or loaded.name}   ·   {whom}   ·   {found.success:.0%} of {sought.proof} succeed"
            plot_search(search.history, sought, tuned, folder.path / PICTURE, title)
    last = sought.stage[-1]
    names = [term.about or term.value for term in last.term]
    return TuningResult(
        path=target,
        folder=folder.path,
        script=parse_script(written, str(target)),
        values={name: found.values[name] for name in tuned},
        objective=found.objective,
        success=found.success,
        wanted=sought.success_rate,
        proof=sought.proof,
        done=search.satisfies(found),
        terms=dict(zip(names, found.terms, strict=False)),
        history=tuple(search.history),
        rounds=search.round + 1,
        performed=search.performed,
        seconds=time.monotonic() - begun,
        note="" if from_nothing else misfit(loaded, here),
    )


def _check_numbers(minutes: float, population: int, copies: int, seed: int) -> None:
    if not minutes > 0.0:
        raise InputError(f"--minutes {minutes:g}: must be above 0")
    if population < 0 or population in (1, 2, 3):
        raise InputError(f"--population {population}: must be at least 4")
    if copies < 0:
        raise InputError(f"--copies {copies}: must be at least 1")
    if not 0 <= seed < 2**31:
        raise InputError(f"--seed {seed}: must be from 0 to {2**31 - 1}")


def _objective(given: str | PathLike[str] | Objective | None, script: Script) -> Objective:
    if isinstance(given, Objective):
        return given
    if given is not None:
        return load_objective(str(given))
    if script.name not in objective_names():
        known = ", ".join(objective_names()) or "none"
        raise InputError(f"{script.name}: no objective ships for it (for {known}); give one by --objective FILE.toml")
    return load_objective(script.name)


def _character(body: str, height: float | None, mass: float | None) -> tuple[Gymnast, str]:
    """The gymnast, and whom it is in words."""
    if body not in get_args(Sex):
        raise InputError(f"--body {body}: must be one of {', '.join(get_args(Sex))}")
    if height is None and mass is None:
        character = character_named(f"gymnast-{body}")
        assert isinstance(character, Gymnast)
        return character, body
    sizes = [f"{height:g} m"] if height is not None else []
    sizes += [f"{mass:g} kg"] if mass is not None else []
    sex: Sex = "male" if body == "male" else "female"
    return gymnast(sex, height=height, mass=mass), ", ".join([body, *sizes])


def _check_target(path: Path) -> None:
    if path.suffix != ".toml":
        raise InputError(f"--out {path}: must be the name of a .toml file")
    if path.is_dir() or not path.absolute().parent.is_dir():
        raise InputError(f"--out {path}: must be the name of a file, in a folder that is there")


def _watch(progress: Callable[[TuningProgress], None], deadline: float) -> Callable[[Search], None]:
    """Tell how far a search is, after each of its generations."""
    times: list[float] = []

    def watch(search: Search) -> None:
        times.append(time.monotonic())
        stages, last = search.objective.stage, search.history[-1]
        ahead = stages[last.stage].generations - last.number - 1
        ahead += sum(stage.generations for stage in stages[last.stage + 1 :])
        recent = times[-20:]
        pace = (recent[-1] - recent[0]) / max(len(recent) - 1, 1)
        progress(
            TuningProgress(
                round=last.round + 1,
                stage=last.stage + 1,
                stages=len(stages),
                stage_name=stages[last.stage].name,
                generation=last.number + 1,
                generations=stages[last.stage].generations,
                best=last.best,
                success=last.success,
                seconds_left=max(min(pace * ahead, deadline - times[-1]), 0.0),
            )
        )

    return watch


def _written(
    text: str,
    source: str,
    found: Found,
    search: Search,
    names: Any,
    whom: str,
    here: Mapping[str, str],
    objective: Objective,
    seed: int,
) -> str:
    """The tuned script's text."""
    import echelon

    tuned = {
        "for": whom,
        **here,
        "objective": Path(objective.source).stem,
        "success": round(found.success, 6),
        "proof": objective.proof,
        "seed": seed,
        "echelon": echelon.__version__,
    }
    values = {name: found.values[name] for name in names}
    return with_values(text, values, whom.partition(",")[0], tuned, source)


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:16]
