"""Raises the limit of files and sockets that this process may have open."""

from __future__ import annotations

import resource

ENOUGH = 4096
"""More than all connections, their files and the stores together."""
RESERVED = 256
"""For stores, logs and threads."""


def raise_file_limit() -> int:
    """Raise the soft limit as far as the system allows and is of use; how many may be sockets."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    allowed = ENOUGH if hard == resource.RLIM_INFINITY else min(ENOUGH, hard)
    if soft != resource.RLIM_INFINITY and soft < allowed:
        resource.setrlimit(resource.RLIMIT_NOFILE, (allowed, hard))
        soft = allowed
    return max(RESERVED, (ENOUGH if soft == resource.RLIM_INFINITY else soft) - RESERVED)
