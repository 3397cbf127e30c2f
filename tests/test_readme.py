"""README and docs say what is so: commands parse, links lead somewhere, code runs, tables are up to date."""

from __future__ import annotations

import csv
import importlib.util
import re
import shlex
import shutil
import subprocess
import tomllib
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
import typer

import echelon
from echelon.agents.gymnasts.script import maneuver_names, parse_script
from echelon.cli.commands import app
from echelon.scenario import Scenario
from echelon.scenario.files import scenario_names
from echelon.tuning.objective import parse_objective
from echelon.warp_kernels.model import Model

ROOT = Path(__file__).parents[1]
PAGES = (ROOT / "README.md", ROOT / "CHANGELOG.md", *sorted((ROOT / "docs").rglob("*.md")))
PICTURES = tuple(sorted((ROOT / "docs" / "images").glob("*")))

RUN = (
    "python3 -m venv .venv && .venv/bin/pip install . && "
    ".venv/bin/echelon simulate border-collie --out herd.usd --film herd.mp4"
)
TEST = 'python3 -m venv .venv && .venv/bin/pip install -e ".[test]" && .venv/bin/python -m pytest'

COMMANDS: Any = typer.main.get_command(app)


def name_of(page: Path) -> str:
    return str(page.relative_to(ROOT))


def blocks(page: Path, language: str) -> list[str]:
    """The code blocks of a page in a language; those inside of lists without their indentation."""
    fences = re.findall(r"^( *)```(\w*)\n(.*?)^ *```$", page.read_text(encoding="utf-8"), flags=re.M | re.S)
    return [re.sub(f"^{indent}", "", text, flags=re.M) for indent, name, text in fences if name == language]


def command_lines(page: Path) -> list[list[str]]:
    """Every `echelon ...` in the shell blocks of a page, as words without "echelon" itself."""
    found: list[list[str]] = []
    for line in "".join(blocks(page, "sh")).replace("\\\n", " ").splitlines():
        for part in line.split("&&"):
            words = shlex.split(part.partition(" > ")[0], comments=True)
            if words and Path(words[0]).name == "echelon":
                found.append(words[1:])
    return found


def parsed(words: list[str]) -> tuple[str, dict[str, Any]]:
    """Subcommand and parameters; raises click's error where there is no such command or option."""
    name, *arguments = words
    return name, COMMANDS.commands[name].make_context(name, arguments).params


LINES = [
    pytest.param(words, id=f"{name_of(page)}: {shlex.join(words)}") for page in PAGES for words in command_lines(page)
]


# ---- the two commands ------------------------------------------------------------------------------------------------
def test_the_two_commands_of_the_first_screen() -> None:
    assert [block.strip() for block in blocks(ROOT / "README.md", "sh")[:2]] == [RUN, TEST]
    before = (ROOT / "README.md").read_text(encoding="utf-8").partition(TEST)[0]
    assert before.count("\n") < 30  # one screen
    assert "docs/images/herd.png" in before


def test_continuous_integration_runs_the_second() -> None:
    assert (ROOT / ".ci" / "run").read_text(encoding="utf-8").rstrip().splitlines()[-1] == TEST


def test_getting_started_says_the_same_as_the_first() -> None:
    text = (ROOT / "docs" / "getting-started.md").read_text(encoding="utf-8")
    install, _, run = RUN.rpartition(" && .venv/bin/")
    assert install in text
    assert run in text


@pytest.mark.parametrize("page", [ROOT / "README.md", ROOT / "docs" / "getting-started.md", ROOT / ".ci" / "run"])
def test_system_packages_are_named_as_the_error_names_them(page: Path) -> None:
    text, source = (path.read_text(encoding="utf-8") for path in (page, ROOT / "echelon" / "export" / "renderer.py"))
    for package in ("libegl1", "libgl1-mesa-dri"):
        assert package in text
        assert package in source


# ---- links and pictures ----------------------------------------------------------------------------------------------
def links(page: Path) -> list[str]:
    text = re.sub(r"^ *```\w*\n.*?^ *```$", "", page.read_text(encoding="utf-8"), flags=re.M | re.S)
    return re.findall(r"\]\(([^)\s]+)\)", text)


def anchors(page: Path) -> set[str]:
    """What headings can be linked to, as Markdown hosts spell them."""
    headings = re.findall(r"^#+ (.*)$", page.read_text(encoding="utf-8"), flags=re.M)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_links_lead_somewhere(page: Path) -> None:
    for link in links(page):
        if link.startswith("https://"):
            continue
        target, _, anchor = link.partition("#")
        place = (page.parent / target).resolve() if target else page
        assert place.exists(), f"{page.name} links to {link}"
        assert place.is_relative_to(ROOT), f"{page.name} links to {link}"
        if anchor:
            assert anchor in anchors(place), f"{page.name} links to {link}"


def test_pictures_are_small_shown_and_can_be_made_again() -> None:
    shown = {(page.parent / link).resolve() for page in PAGES for link in links(page)}
    gallery = (ROOT / "docs" / "gallery.md").read_text(encoding="utf-8")
    assert PICTURES
    for picture in PICTURES:
        assert picture.stat().st_size < 300_000, picture.name
        assert picture in shown, f"{picture.name} is on no page"
        assert f"--out docs/images/{picture.name}" in gallery, f"the gallery does not say how {picture.name} was made"
    assert sum(picture.stat().st_size for picture in PICTURES) < 5_000_000


# ---- commands --------------------------------------------------------------------------------------------------------
def test_there_are_commands_to_check() -> None:
    assert len(LINES) > 30


@pytest.mark.parametrize("words", LINES)
def test_command_lines_parse(words: list[str]) -> None:
    name, options = parsed(words)
    if name == "simulate":
        source = options["scenario"]
        if source.startswith("examples/"):
            assert (ROOT / source).is_file()
            Scenario.load(ROOT / source, options["settings"] or ())
        elif not source.endswith((".toml", ".recording")):  # what the reader has made
            assert source in scenario_names()
            Scenario.load(source, options["settings"] or ())
    elif name == "describe" and "." not in options["what"]:
        assert options["what"] in {*scenario_names(), *maneuver_names(), *echelon.body_names()}


@pytest.mark.parametrize(
    ("wrong", "word"),
    [("simulate herd --speed 3", "--speed"), ("render herd.usd", "out"), ("rendre herd.usd", "rendre")],
)
def test_a_wrong_line_would_be_noticed(wrong: str, word: str) -> None:
    with pytest.raises(Exception, match=word):
        parsed(shlex.split(wrong))


def test_every_command_is_in_the_readme() -> None:
    used = {words[0] for words in command_lines(ROOT / "README.md")}
    assert used == set(COMMANDS.commands)


def test_words_in_running_text_that_look_like_commands_are() -> None:
    for page in PAGES:
        for name in re.findall(r"`echelon ([a-z]+)", page.read_text(encoding="utf-8")):
            assert name in COMMANDS.commands, f"{page.name}: echelon {name}"


# ---- files and code --------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_toml_is_a_scenario_or_a_body(page: Path) -> None:
    for text in blocks(page, "toml"):
        data = tomllib.loads(text)
        if "links" in data:
            Model.from_dict(data)
        elif "row" in data:
            parse_script(text, page.name)
        elif "stage" in data:
            parse_objective(text, page.name)
        elif set(data) == {"tuned"}:
            assert set(data["tuned"]) >= {"for", "body", "contact", "step"}  # what the tuner adds to a script
        else:
            Scenario.from_dict({"name": "my-scene"} | data)


def test_the_example_scenario_is_shown_as_it_is() -> None:
    shown = blocks(ROOT / "docs" / "getting-started.md", "toml")
    assert shown == [(ROOT / "examples" / "turn.toml").read_text(encoding="utf-8")]


def test_sdfast_example_is_a_body(tmp_path: Path) -> None:
    (text,) = (block for block in blocks(ROOT / "docs" / "bodies.md", "") if "bodytojoint" in block)
    (tmp_path / "leg.sd").write_text(text, encoding="utf-8")
    assert echelon.load_body(tmp_path / "leg.sd").link_names == ("trunk", "thigh")


@pytest.fixture(scope="module")
def herd(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording."""
    path = tmp_path_factory.mktemp("herd") / "herd.recording"
    echelon.simulate("border-collie", agents=3, seconds=3, recording=path)
    return path


@pytest.mark.parametrize("page", [page for page in PAGES if blocks(page, "python")], ids=name_of)
def test_python_runs(page: Path, herd: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """All Python of a page, from top to bottom, in a folder where there is a recording."""
    monkeypatch.chdir(tmp_path)
    shutil.copytree(herd, "herd.recording")
    names: dict[str, Any] = {}
    for number, code in enumerate(blocks(page, "python")):
        exec(compile(code, f"{page.name}, block {number}", "exec"), names)


# ---- tables ----------------------------------------------------------------------------------------------------------
def scenario_tables() -> ModuleType:
    spec = importlib.util.spec_from_file_location("scenario_tables", ROOT / "docs" / "scenario_tables.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_tables_of_keys_are_up_to_date() -> None:
    module = scenario_tables()
    page = module.PAGE.read_text(encoding="utf-8")
    assert module.page_with_tables(page) == page, "run python docs/scenario_tables.py"


def test_tables_have_every_key_of_a_scenario() -> None:
    """Against the keys of a whole scenario, as `echelon describe` prints them."""
    module = scenario_tables()
    field = Scenario.load("border-collie").to_dict()
    road = Scenario.load("jogger", ["user.ahead=3", "peloton.tactics.attacks=1"]).to_dict()
    tables = {"scenario": field, "world.corral": field["world"]["corral"]}
    pieces = Scenario.load(
        "gap", ["world.walls=[{points = [[0, 40], [9, 40]]}]", "world.column_field={center = [60, 0]}"]
    )
    world = pieces.to_dict()["world"]
    tables |= {f"world.{name}": world[name] for name in ("gap", "column_field")} | {"world.walls": world["walls"][0]}
    tables |= {"peloton.tactics": road["peloton"]["tactics"], "obstacles": road["obstacles"][0], "user": road["user"]}
    tables |= {name: value for name, value in field.items() if isinstance(value, dict)}
    script = '{name = "mine", text = ""}'
    dive = ["performance.casts=[{}]", f"performance.scripts=[{script}]"]
    dive = Scenario.load("inward-dive-one-and-a-half-pike", dive).to_dict()
    tables |= {"performance": dive["performance"], "world.platform": dive["world"]["platform"]}
    tables |= {f"performance.{name}": dive["performance"][name][0] for name in ("casts", "scripts")}
    assert set(tables) == set(module.TABLES)
    for name, data in tables.items():
        keys = re.findall(r"^\| `(\w+)` \|", module.table(module.TABLES[name]), flags=re.M)
        inner = {key for key in data if (key if name == "scenario" else f"{name}.{key}") in module.TABLES}
        assert keys == [key for key in data if key not in inner], name


def test_figures_of_the_engine_are_those_of_the_benchmark() -> None:
    """The table in the README, to two digits, against one of the machines that were measured."""
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    shown = re.findall(r"^\| (\w+) \|.*\| ([\d.]+) µs \| ([\d.]+) µs \| (\d+) \|$", text, flags=re.M)
    assert [body for body, *_ in shown] == ["hopper", "cyclist", "gymnast", "male", "female"]
    machines = sorted((ROOT / "docs" / "benchmarks").glob("*/engine.csv"))
    measured = [same_step(machine) for machine in machines]
    assert any(
        all(found[body] == pytest.approx([float(figure) for figure in figures], rel=0.05) for body, *figures in shown)
        for found in measured
    ), f"README has {shown}, measured were {measured}"


def same_step(table: Path) -> dict[str, list[float]]:
    """Of each body under the default integrator: our time and the peer's [us], and their ratio."""
    with open(table, encoding="utf-8", newline="") as lines:
        rows = [row for row in csv.DictReader(lines) if row["measure"] == "same step"]
    columns = ("substep_us", "peer_step_us", "ratio")
    return {row["body"]: [float(row[name]) for name in columns] for row in rows if row["integrator"] == "semi-implicit"}


# ---- the changelog and the package -----------------------------------------------------------------------------------
def test_changelog_is_about_this_version() -> None:
    versions = re.findall(r"^## \[([\d.]+)\]", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), flags=re.M)
    assert versions[0] == echelon.__version__


def test_continuous_integration_is_a_script_that_a_shell_understands() -> None:
    subprocess.run(["bash", "-n", ROOT / ".ci" / "run"], check=True)
