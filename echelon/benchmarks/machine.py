"""Where and with what something was measured."""

from __future__ import annotations

import os
import platform
from importlib.metadata import version


def machine_name() -> str:
    """Processor and number of cores."""
    model = platform.processor() or platform.machine()
    try:
        with open("/proc/cpuinfo", encoding="utf-8", errors="replace") as lines:
            model = next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), model)
    except OSError:
        # Not Linux: what the platform module knows must do.
        pass
    return f"{model}, {os.cpu_count()} cores"


def package_versions() -> str:
    """Versions of Python and of what the arithmetic depends on."""
    packages = [("Warp", "warp-lang"), ("NumPy", "numpy")]
    return ", ".join([f"Python {platform.python_version()}", *(f"{name} {version(key)}" for name, key in packages)])
