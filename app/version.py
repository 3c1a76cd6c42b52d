"""The release of Lineside: from its git tag, when it was built (hatch_version.py)."""

from importlib.metadata import version

VERSION = version("lineside")
