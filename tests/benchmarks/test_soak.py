"""The soak, short: memory is sampled, what was written is given back to the disk, and what grows is found out."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from echelon.benchmarks import soak as bench
from echelon.recording import Recording


def test_a_short_soak_is_flat_and_leaves_little_on_the_disk(tmp_path: Path) -> None:
    found = bench.soak(64, 4.0, folder=tmp_path)
    assert found.flat, bench.soak_text(found)
    assert found.nonfinite == 0
    assert found.seconds == 240.0
    assert len(found.samples) >= bench.SAMPLES
    assert found.first_mb > 20.0
    assert found.largest_mb >= found.last_mb
    # The recording is there in full length, and mostly holes.
    recording = Recording(tmp_path / "soak.recording")
    assert recording.frame_count == 7201
    files = [file.stat() for file in recording.path.rglob("c.*")]
    assert sum(file.st_size for file in files) == pytest.approx(1e9 * found.written_gb, rel=0.01)
    assert sum(512 * file.st_blocks for file in files) < 0.6 * sum(file.st_size for file in files)


def test_memory_that_grows_is_not_called_flat() -> None:
    summary = {"seconds": 600.0, "falls": 0, "nonfinite": 0}
    steady = [(float(t), 500.0 + (t % 7)) for t in range(600)]
    leaking = [(float(t), 500.0 + 0.05 * t) for t in range(600)]
    assert bench._judged(10, 1.0, summary, 0, steady).flat
    found = bench._judged(10, 1.0, summary, 0, leaking)
    assert not found.flat
    assert found.slope_mb_per_minute == pytest.approx(3.0)
    assert "NOT FLAT" in bench.soak_text(found)


def test_as_a_program(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert bench.main(["--agents", "3", "--minutes", "0.02", "--json", "--record", "keep"]) in (0, 1)
    report = json.loads(capsys.readouterr().out)
    assert report["agents"] == 3
    assert len(report["samples"]) == 37
    (tmp_path / "soak.recording").write_text("not a folder")
    assert bench.main(["--agents", "3", "--minutes", "0.02", "--folder", str(tmp_path)]) == 2
    assert "soak.recording" in capsys.readouterr().err
