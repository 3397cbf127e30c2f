"""What became of those who perform: a table of maneuvers, and which captures failed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from echelon.recording import Recording

SHOWN = 5
"""So many captures that failed are told after a run."""


def performers_report(recording: Recording) -> dict[str, Any]:
    """What a report of a run says of captures, beyond the recording's summary."""
    from echelon.simulation.captures import missed_captures

    return {"missed_captures": [missed.as_dict() for missed in missed_captures(recording)]}


def performers_text(report: Mapping[str, Any], recording: Recording) -> list[str]:
    """A table of what became of each maneuver, and the first captures that failed."""
    width = max(len("maneuver"), *(len(name) for name in report["maneuvers"]))
    lines = ["", f"  {'maneuver':<{width}}  performers  balanced  fallen  mean rise  mean peak force"]
    for name, found in report["maneuvers"].items():
        lines.append(
            f"  {name:<{width}}  {found['performers']:10d}  {found['balanced']:8d}  {found['fallen']:6d}"
            f"  {found['mean_rise']:7.3f} m  {found['mean_peak_force']:13.0f} N"
        )
    return lines + _first_missed(report["missed_captures"], recording)


def _first_missed(missed: Sequence[Mapping[str, Any]], recording: Recording) -> list[str]:
    if not missed:
        return []
    from echelon.simulation.captures import missed_captures

    lines = ["", f"  {len(missed)} captures failed:" if len(missed) > 1 else "  a capture failed:"]
    lines += [f"    {entry}" for entry in missed_captures(recording)[:SHOWN]]
    if len(missed) > SHOWN:
        lines.append(f"    and {len(missed) - SHOWN} more; all with: echelon captures {recording.path}")
    return lines
