"""The `echelon` command."""

from echelon.cli.commands import main, run

__all__ = ["main", "run"]
