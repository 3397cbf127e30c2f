"""Test files are imported one by one, not as a package: let them find the modules that they share."""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parent))
