"""`echelon captures`: which captures of maneuvers failed in a recording."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from echelon.cli.registering import Json

EXAMPLES = "  echelon captures troupe.recording\n  echelon captures troupe.recording --json"


def captures(
    recording: Annotated[Path, typer.Argument(metavar="RECORDING", help="Folder of a recording of gymnasts.")],
    as_json: Json = False,
) -> None:
    """Say which captures of scripts failed.

    A capture is what a row of a maneuver says should hold when it is reached.
    """
    from echelon.recording import Recording
    from echelon.simulation.captures import missed_captures

    found = missed_captures(Recording(recording))
    if as_json:
        print(json.dumps([missed.as_dict() for missed in found]))
    else:
        print("\n".join(map(str, found)) or "no capture failed")
