"""The house stands: a room imports only from the floors beneath it, and rooms side by side leave one another alone."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

import echelon

PACKAGE = Path(echelon.__file__).parent

GROUND = {"errors", "settings", "launcher", "ranks", "warp_kernels", "terrain", "scenario", "recording"}
MIDDLE = {"agents", "flocking", "export"}
ALLOWED: dict[str, set[str]] = {
    "errors": set(),
    "settings": {"errors"},
    "launcher": set(),
    "ranks": {"errors", "launcher"},
    "warp_kernels": {"errors"},
    "scenario": {"errors", "settings"},
    "terrain": {"errors", "settings", "scenario", "warp_kernels"},
    "recording": {"errors", "settings", "ranks", "warp_kernels"},
    "agents": GROUND,
    "flocking": GROUND,
    "export": GROUND,
    "simulation": GROUND | MIDDLE,
    "runs": GROUND | MIDDLE | {"simulation"},
    "sweeping": GROUND | MIDDLE | {"simulation"},
    "tuning": GROUND | MIDDLE | {"simulation"},
    "benchmarks": GROUND | MIDDLE | {"simulation"},
    "play": GROUND | MIDDLE | {"simulation"},
    "__main__": {"cli"},
    "cli": GROUND | MIDDLE | {"simulation", "runs", "sweeping", "tuning", "benchmarks", "play"},
}


def imported_rooms(path: Path) -> set[str]:
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        names: list[str] = []
        if isinstance(node, ast.ImportFrom) and node.module:
            names = [node.module] if node.module != "echelon" else [f"echelon.{alias.name}" for alias in node.names]
        elif isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        found |= {name.split(".")[1] for name in names if name.startswith("echelon.")}
    return found


def room_of(path: Path) -> str:
    return path.relative_to(PACKAGE).parts[0].removesuffix(".py")


FILES = [path for path in sorted(PACKAGE.rglob("*.py")) if path != PACKAGE / "__init__.py"]


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_imports_only_from_beneath(path: Path) -> None:
    room = room_of(path)
    assert imported_rooms(path) - {room} <= ALLOWED[room]


def test_every_room_has_its_place() -> None:
    assert {room_of(path) for path in FILES} <= set(ALLOWED)


def test_the_public_face_is_there() -> None:
    for name in echelon.__all__:
        assert getattr(echelon, name) is not None
    with pytest.raises(AttributeError, match="nonsense"):
        echelon.nonsense  # noqa: B018
