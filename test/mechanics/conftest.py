"""Lets the tests of this folder import `mechanisms`, which stands beside them; and one profile for Hypothesis."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
