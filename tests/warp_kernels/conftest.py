"""Test files are imported one by one, not as a package: let them find the modules that they share."""

import sys
from pathlib import Path

import warp as wp

sys.path.append(str(Path(__file__).parent))
wp.config.quiet = True
