"""Which release of Lineside this is: from its git tag, when it was built (hatch_version.py)."""

from importlib.metadata import version

VERSION = version("lineside")
